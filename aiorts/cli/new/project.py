"""The files of a plugin with one component, as text; this module writes nothing."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, Final

from aiorts.cli.new.design import Design, Port, Service
from aiorts.types import TimedDouble, has_tm
from aiorts.wire import split_sample

_RATE: Final = 10.0
"""The highest rate in Hz at which the system file feeds the component."""
_WIDTH: Final = 120
"""Characters of the longest line."""


def files_of(design: Design) -> dict[str, str]:
    """The text of each file, by its path below the folder."""
    package = design.package
    return {
        "pyproject.toml": _pyproject(design),
        "README.md": _readme(design),
        "system.toml": _system(design),
        f"{package}/__init__.py": _face(design),
        f"{package}/component.py": "\n".join(_component(design)),
        f"{package}/py.typed": "",
        f"tests/test_{package.removeprefix('aiorts_')}.py": "\n".join(_tests(design)),
    }


def _pyproject(design: Design) -> str:
    return f"""\
# A plugin of aiorts: an ordinary Python project that says in entry points what it offers.
[build-system]
requires = ["hatchling>=1.24"]
build-backend = "hatchling.build"

[project]
name = "{design.package.replace("_", "-")}"
version = "0.1.0"
description = "The component {design.cls} for aiorts"
requires-python = ">=3.11"
dependencies = ["aiorts"]

# Each line: NAME = "MODULE:OBJECT". Nothing is imported before the name is used.
[project.entry-points."aiorts.components"]
{design.type} = "{design.package}.component:{design.cls}"

[tool.hatch.build.targets.wheel]
packages = ["{design.package}"]

[tool.ruff]
line-length = 120
src = ["."]

[tool.pytest.ini_options]
testpaths = ["tests"]
pythonpath = ["."]
"""


def _face(design: Design) -> str:
    return f'''\
"""The component {design.cls}. Nothing is imported here: its name loads its module when it is used."""

from __future__ import annotations

AIORTS_API = 1
"""The version of aiorts' plugin interface that this was written for."""
'''


def _readme(design: Design) -> str:
    return f"""\
# {design.cls}

A component for aiorts. It runs as it lies here, from the folder that holds `{design.name}`:

```sh
aiorts run {design.name}/system.toml --for 2
aiorts --plugins {design.name} inspect {design.type}
python -m pytest {design.name}
```

After `pip install ./{design.name}` it needs no `--plugins`, and is a filter: `aiorts {design.type.lower()} --help`.

- `{design.package}/component.py`: the component; begin at `on_execute`.
- `system.toml`: a system that it runs in.
- `tests/`: its test, in virtual time.
"""


# -- the component -----------------------------------------------------------------------------------------------------


def _component(design: Design) -> Iterator[str]:
    roles = {one.role for one in design.services}
    used = {
        "InPort": bool(design.ins) or design.flexi,
        "OutPort": bool(design.outs) or design.flexi,
        "Param": bool(design.params) or design.flexi,
        "Provided": "provided" in roles,
        "Required": "required" in roles,
    }
    yield f'"""{design.cls}: say here what it is for."""'
    yield ""
    yield "from __future__ import annotations"
    yield ""
    if design.flexi:
        yield "from collections.abc import Mapping"
    typing = [*(["Any"] if design.flexi else []), *(["Protocol"] if design.services else [])]
    if typing:
        yield f"from typing import {', '.join(typing)}"
    if design.flexi or typing:
        yield ""
    yield f"from aiorts import {', '.join(['Component', *(name for name, is_used in used.items() if is_used)])}"
    yield from ["from aiorts.types import find_type"] if design.flexi else _imports((*design.ins, *design.outs))
    yield ""
    names = sorted((design.cls, *(one.interface for one in design.services)))
    line = f"__all__ = ({', '.join(map(json.dumps, names))}{',' * (len(names) == 1)})"
    yield from [line] if len(line) <= _WIDTH else ["__all__ = (", *(f"    {json.dumps(one)}," for one in names), ")"]
    for service in design.services:
        yield from _interface(design, service)
    yield ""
    yield ""
    yield f"class {design.cls}(Component):"
    yield f'    """{design.doc or "Says in one line what it does."}"""'
    yield ""
    yield from _declarations(design)
    if design.flexi:
        yield _FLEXI
    yield "    async def on_execute(self) -> None:"
    yield '        """One cycle: take what has come, and write what follows from it."""'
    yield from _cycle(design)
    for service in design.services:
        if service.role == "provided":
            yield ""
            yield "    async def ask(self, question: str) -> str:"
            yield f'        """See `{service.interface}`."""'
            yield '        return f"{self.name}: {question}"'
            break
    yield ""


_FLEXI: Final = '''\
    types: tuple[str, ...] = Param(("TimedDouble",), type=tuple[str, ...], doc="of each pair of ports")

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        """An in-port and an out-port for each type; they change with the parameter."""
        ports: dict[str, InPort[Any] | OutPort[Any]] = {}
        for number, name in enumerate(values["types"]):
            cls = find_type(name)
            ports[f"input{number}"], ports[f"output{number}"] = InPort(cls), OutPort(cls)
        return ports
'''


def _imports(ports: Iterable[Port]) -> Iterator[str]:
    """The lines that import the types of ports, in the order of ruff."""
    found: dict[str, set[str]] = {}
    for port in ports:
        found.setdefault(port.module, set()).add(port.type)
    for module, names in sorted(found.items()):
        line = f"from {module} import {', '.join(sorted(names))}"
        if len(line) <= _WIDTH:
            yield line
        else:
            yield f"from {module} import ("
            yield from (f"    {one}," for one in sorted(names))
            yield ")"


def _interface(design: Design, service: Service) -> Iterator[str]:
    yield ""
    yield ""
    yield f"class {service.interface}(Protocol):"
    yield f'    """What can be asked through the service port `{service.name}`."""'
    yield ""
    yield "    async def ask(self, question: str) -> str:"
    yield '        """Answer a question; replace it by the methods that you need."""'
    yield "        ..."


def _declarations(design: Design) -> Iterator[str]:
    for kind, ports in (("InPort", design.ins), ("OutPort", design.outs)):
        for one in ports:
            words = {"unit": one.unit, "doc": one.doc, "name": one.label}
            yield from _call(f"{one.name} = {kind}", [one.type, *_keywords(words)])
    for service in design.services:
        head = f"{service.name} = {service.role.capitalize()}[{service.interface}]"
        yield from _call(head, _keywords({"port": service.label, "doc": service.doc}))
    for param in design.params:
        typed = [f"type={_type_of(param.default)}"] if isinstance(param.default, tuple) else []
        words = {"unit": param.unit, "doc": param.doc, "constraint": param.constraint, "widget": param.widget}
        yield from _call(f"{param.name} = Param", [literal(param.default), *typed, *_keywords(words)])
    if design.ins or design.outs or design.services or design.params:
        yield ""


def _call(head: str, arguments: list[str]) -> Iterator[str]:
    """A call in a class body, as ruff formats it."""
    inside = ", ".join(arguments)
    if len(line := f"    {head}({inside})") <= _WIDTH:
        yield line
        return
    yield f"    {head}("
    if len(line := f"        {inside}") <= _WIDTH:
        yield line
    else:
        yield from (f"        {one}," for one in arguments)
    yield "    )"


def _keywords(words: dict[str, str]) -> list[str]:
    return [f"{key}={literal(text)}" for key, text in words.items() if text]


def _type_of(values: tuple[Any, ...]) -> str:
    return f"tuple[{type(values[0]).__name__}, ...]"


def literal(value: Any) -> str:
    """A value as a Python literal, as ruff formats it."""
    if isinstance(value, tuple):
        return f"({', '.join(map(literal, value))}{',' * (len(value) == 1)})"
    if not isinstance(value, str):
        return repr(value)
    quote = "'" if value.count('"') > value.count("'") else '"'
    plain = value.replace("\\", r"\\").replace(quote, f"\\{quote}")
    return quote + "".join(one if one.isprintable() else ascii(one)[1:-1] for one in plain) + quote


def _cycle(design: Design) -> Iterator[str]:
    if design.flexi:
        yield "        for number in range(len(self.types)):"
        yield '            source, target = self.ports[f"input{number}"], self.ports[f"output{number}"]'
        yield "            if isinstance(source, InPort) and isinstance(target, OutPort):"
        yield "                for sample in source.drain():"
        yield "                    await target.write(sample)"
        return
    pairs, alone = _pairs(design)
    for port in design.ins:
        yield f"        for {port.name} in self.{port.name}.drain():"
        if pairs[port]:
            yield from (f"            await self.{one.name}.write({port.name})" for one in pairs[port])
        else:
            yield f'            self.log.info("{port.name}: %s", {port.name})'
    for port in alone:
        stamp = "tm=self.clock.time_ns()" if has_tm(port.cls) else ""
        yield f"        await self.{port.name}.write({port.type}({stamp}))"
    if not design.ins and not alone:
        yield '        self.log.debug("a cycle")'


def _pairs(design: Design) -> tuple[dict[Port, list[Port]], list[Port]]:
    """The out-ports that pass on the samples of each in-port, of the same type; and the other out-ports."""
    pairs: dict[Port, list[Port]] = {port: [] for port in design.ins}
    alone: list[Port] = []
    for out in design.outs:
        source = next((port for port in design.ins if port.cls is out.cls), None)
        (alone if source is None else pairs[source]).append(out)
    return pairs, alone


# -- the system and the test -------------------------------------------------------------------------------------------


def _system(design: Design) -> str:
    name = design.package.removeprefix("aiorts_")
    parts = [
        f"# {design.cls} in a system. The plugin is found because it lies beside this file.\n"
        f"#\n# Run: aiorts run {design.name}/system.toml\nschema = 1\n",
        f"[components.{name}]\ntype = {json.dumps(design.type)}\n",
    ]
    ins = [Port("input0", TimedDouble)] if design.flexi else list(design.ins)
    outs = [Port("output0", TimedDouble)] if design.flexi else list(design.outs)
    members = [name]
    if ins:
        types, constants = [one.type for one in ins], [json.dumps(_data(one)) for one in ins]
        parts.append(
            f'[components.source]\ntype = "FlexiConst"\nparams.outputs = {_texts(types)}\n'
            f"params.constants = {_texts(constants)}\nparams.rate = {min(_RATE, design.rate)}\n"
        )
        members.insert(0, "source")
    if outs:
        parts.append(
            f'[components.show]\ntype = "FlexiDump"\nparams.inputs = {_texts([one.type for one in outs])}\n'
            f"params.names = {_texts([one.name for one in outs])}\n"
        )
        members.append("show")
    for number, one in enumerate(ins):
        source = "output" if len(ins) == 1 else f"output{number}"
        parts.append(f'[[connections]]\nfrom = "source.{source}"\nto = "{name}.{one.label or one.name}"\n')
    parts += [f'[[connections]]\nfrom = "{name}.{one.label or one.name}"\nto = "show.{one.name}"\n' for one in outs]
    parts.append(f'[contexts.loop]\nkind = "periodic"\nrate = {design.rate}\nmembers = {_texts(members)}\n')
    return "\n".join(parts)


def _data(port: Port) -> Any:
    return split_sample(port.cls())[1]


def _texts(texts: list[str]) -> str:
    return json.dumps(texts, ensure_ascii=False)


def _tests(design: Design) -> Iterator[str]:
    name = design.package.removeprefix("aiorts_")
    yield f'"""{design.cls} in a rig, where time is virtual."""'
    yield ""
    yield "from __future__ import annotations"
    yield ""
    yield "from aiorts.testing import Rig, check_component, simulated"
    fed = [Port("input0", TimedDouble)] if design.flexi else design.ins
    yield from _imports(fed)
    yield ""
    yield f"from {design.package}.component import {design.cls}"
    yield ""
    yield ""
    yield "@simulated"
    yield "async def test_a_cycle() -> None:"
    yield f'    async with Rig({design.cls}("{name}0")) as rig:'
    yield from (f"        rig.feed({literal(one.label or one.name)}, {one.type}())" for one in fed)
    yield "        await rig.tick()"
    written = ["output0"] if design.flexi else [one.label or one.name for one in design.outs]
    yield from (f"        assert len(rig.received({literal(one)})) == 1" for one in written)
    if not written:
        yield "        assert rig.failures == ()"
    yield ""
    yield ""
    yield "def test_it_is_a_good_neighbour() -> None:"
    yield f"    check_component({design.cls})"
    yield ""
