"""The pages of the reference that describe classes: public names, events, statistics."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Final

from aiorts.model.declared import options_of
from reference_source import (
    WIDTH,
    Definition,
    Doc,
    Entry,
    Source,
    block,
    decorators,
    default_of,
    definition,
    doc_of,
    fields_of,
    flat,
    followed,
    item,
    listed,
    of_class,
    one_line,
    parameters,
    returns,
    wrapped,
)

# -- api ---------------------------------------------------------------------------------------------------------------


@cache
def public() -> dict[str, Any]:
    """Every public name, "module.Name", with what it is."""
    from test_layers import PUBLIC

    found = {}
    for module in PUBLIC:
        loaded = importlib.import_module(module)
        found.update({f"{module}.{name}": getattr(loaded, name) for name in sorted(loaded.__all__, key=str.lower)})
    return found


@cache
def first_path() -> dict[int, str]:
    """The path by which each public class and function is named, by its id."""
    paths: dict[int, str] = {}
    for path, value in public().items():
        if isinstance(value, type) or callable(value):
            paths.setdefault(id(value), path)
    return paths


def api() -> str:
    from test_layers import PUBLIC

    parts = []
    for module in PUBLIC:
        said = doc_of(importlib.import_module(module).__doc__)
        more = "\n[Record types](record-types.md) has units and meaning of the fields.\n" if ".types" in module else ""
        parts.append(f"## `{module}`\n\n{said.first}\n{more}")
        parts += [
            f"### `{path}`\n\n{_described(path, value)}"
            for path, value in public().items()
            if path.rpartition(".")[0] == module
        ]
    return "\n".join(parts)


def _described(path: str, value: Any) -> str:
    module, _, name = path.rpartition(".")
    first = first_path().get(id(value), path)
    if first != path:
        return f"The same as `{first}`.\n"
    made = definition(module, name)
    if inspect.ismodule(value):
        own = [name for name, one in vars(value).items() if getattr(one, "__module__", "") == value.__name__]
        names = listed(one for one in own if not one.startswith("_"))
        return f"A module. {doc_of(value.__doc__).first} It has {names}.\n"
    if made is None:
        said = doc_of(inspect.getdoc(value))
        return f"{block(f'class {name}')}{said.first}\n"
    if isinstance(made.node, ast.ClassDef):
        return _class(path, value, made.source, made.node)
    if isinstance(made.node, ast.FunctionDef | ast.AsyncFunctionDef):
        said = doc_of(ast.get_docstring(made.node))
        way = "async def" if isinstance(made.node, ast.AsyncFunctionDef) else "def"
        head = wrapped(
            f"{way} {name}", parameters(made.source, made.node, bound=False), returns(made.source, made.node)
        )
        return f"{block(head)}{said.first}\n{_sections(said)}"
    return _value(name, value, made)


def _value(name: str, value: Any, made: Definition) -> str:
    assert isinstance(made.node, ast.Assign | ast.AnnAssign)
    written = made.source.of(made.node.value) if made.node.value is not None else ""
    below = f"{doc_of(made.below).first}\n" if made.below else ""
    if isinstance(value, int | str):
        return f"{block(f'{name} = {value!r}')}{below}"
    short = block(f"{name} = {written}") if len(written) <= WIDTH - len(name) else ""
    if isinstance(value, Mapping) and value:
        below += "\nIts keys: " + ", ".join(f"`{key}`" for key in value) + ".\n"
    return f"{short}{below}".lstrip("\n") or f"{block(name)}"


def _sections(said: Doc, *names: str) -> str:
    out = ""
    for title in names or ("Args", "Returns", "Yields", "Raises"):
        entries = said.sections.get(title)
        if entries and title in ("Returns", "Yields"):
            out += f"\n{title}: {one_line(entries[0][1])}\n"
        elif entries:
            out += f"\n{title}:\n\n" + "".join(f"{item(name, one_line(text))}\n" for name, text in _resolved(entries))
    return out


def _resolved(entries: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """The entries; where one says "see `Port`" of an internal class, what that says."""
    for names, text in entries:
        seen = re.fullmatch(r"see `(\w+)`\.?", text)
        if seen is None or seen[1] != "Port":
            yield names, text
            continue
        told = definition("aiorts.kernel.ports.port", seen[1])
        assert told is not None
        assert isinstance(told.node, ast.ClassDef)
        yield from doc_of(ast.get_docstring(told.node)).sections["Args"]


def _class(path: str, cls: type, of: Source, node: ast.ClassDef) -> str:
    name = path.rpartition(".")[2]
    said = doc_of(ast.get_docstring(node))
    if path.startswith("aiorts.types") and _is_record(cls):
        shown = cls.__members__ if issubclass(cls, Enum) else [f"{one.name}: {one.type}" for one in fields_of(cls)]
        return f"{said.first}\n\n{'Members' if issubclass(cls, Enum) else 'Fields'}: {listed(shown)}.\n"
    if issubclass(cls, Enum):
        members = "".join(f"- `{member.name}` = `{member.value!r}`\n" for member in cls)
        return f"{block(f'class {name}')}{said.first}\n\nMembers:\n\n{members}"
    own, bases = _walk(cls)
    parts = _constructor(cls, own, said)
    head = f"class {name}" if parts is None else wrapped(f"class {name}", parts, "")
    out = f"{block(head)}{said.first}\n"
    if code := getattr(cls, "code", ""):
        out += f"\nIts code is `{code}`.\n"
    if bases:
        out += f"\nDerived from {listed(bases)}.\n"
    declared = [] if is_dataclass(cls) else [(name, one.described) for name, one in options_of(cls).items()]
    above = {(name, one.described) for base in cls.__mro__[1:] for name, one in options_of(base).items()}
    declared = [one for one in declared if one not in above]  # a base class, which is named, says it
    said.sections.update({"Args": [*said.sections.get("Args", ()), *declared]} if declared else {})
    out += _sections(said, "Args", "Raises")
    init = _method(own, "__init__")
    if init is not None:
        out += _sections(
            doc_of(ast.get_docstring(init[1])), *(("Args",) if "Args" not in said.sections else ()), "Raises"
        )
    attributes, methods = _members(cls, own, said)
    if attributes:
        out += "\nAttributes:\n\n" + "".join(f"{one}\n" for one in attributes)
    if methods:
        out += "\nMethods:\n\n" + "".join(f"{one}\n" for one in methods)
    return out


def _is_record(cls: type) -> bool:
    from aiorts.types import all_types

    return cls in all_types().values()


def _walk(cls: type) -> tuple[list[tuple[Source, ast.ClassDef]], list[str]]:
    """The bodies that are described with a class, its own and those of internal bases, and its public bases."""
    own: list[tuple[Source, ast.ClassDef]] = []
    bases: list[str] = []
    covered: set[type] = set()
    for one in cls.__mro__:
        if one in covered:
            continue
        path = first_path().get(id(one))
        if one is not cls and (path is not None or (one.__module__ == "builtins" and issubclass(one, Exception))):
            bases.append(path or one.__name__)
            covered.update(one.__mro__)
        elif (made := of_class(one)) is not None:
            assert isinstance(made.node, ast.ClassDef)
            own.append((made.source, made.node))
    return own, bases


def _method(own: list[tuple[Source, ast.ClassDef]], name: str) -> tuple[Source, ast.FunctionDef] | None:
    for of, node in own:
        for one in flat(node.body):
            if isinstance(one, ast.FunctionDef) and one.name == name and "overload" not in decorators(one):
                return of, one
    return None


def _constructor(cls: type, own: list[tuple[Source, ast.ClassDef]], said: Doc) -> list[str] | None:
    """The parameters of a class; None where its attributes say the same, or it is not made by its user."""
    every = [(made.source, made.node) for base in cls.__mro__ if (made := of_class(base)) is not None]
    bodies = [(of, node) for of, node in every if isinstance(node, ast.ClassDef)]
    data = any("dataclass" in decorators(node) for _, node in own)
    for name in () if data else ("__init__", "__new__"):
        if (found := _method(bodies, name)) is not None:
            return parameters(*found, bound=True)
    if "Args" in said.sections:
        return [
            f"{one.name}: {one.type}{f' = {one.default}' if one.default else ''}"
            for one in sorted(fields_of(cls), key=lambda one: bool(one.default))
        ]
    return None


def _members(cls: type, own: list[tuple[Source, ast.ClassDef]], said: Doc) -> tuple[list[str], list[str]]:
    """Public attributes and methods, a line for each."""
    attributes: dict[str, str] = {}
    methods: dict[str, str] = {}
    for of, node in own:
        arguments = {name for names, _ in said.sections.get("Args", ()) for name in names.split(", ")}
        for entry in _declared(of, node, dict(said.sections.get("Attributes", ()))):
            if entry.doc or entry.name not in arguments:
                attributes.setdefault(entry.name, str(entry))
        for one in flat(node.body):
            if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef) or one.name.startswith("_"):
                continue
            marks = decorators(one)
            if marks & {"overload", "setter", "deleter"}:
                continue
            told = doc_of(ast.get_docstring(one) or _inherited(cls, one.name))
            raised = [name for name, _ in told.sections.get("Raises", ())]
            text = told.first + (f" Raises {listed(raised)}." if raised else "")
            if marks & {"property", "cached_property"}:
                kind = returns(of, one).removeprefix(" -> ")
                attributes.setdefault(one.name, item(f"{one.name}: {kind}" if kind else one.name, text))
                continue
            way = "async " if isinstance(one, ast.AsyncFunctionDef) else ""
            line = ", ".join(parameters(of, one, bound="staticmethod" not in marks))
            methods.setdefault(one.name, item(f"{way}{one.name}({line}){returns(of, one)}", text))
    return list(attributes.values()), list(methods.values())


def _inherited(cls: type, name: str) -> str:
    return inspect.getdoc(getattr(cls, name, None)) or ""


def _declared(of: Source, node: ast.ClassDef, said: Mapping[str, str]) -> Iterator[Entry]:
    """The attributes that a class body or its `__init__` documents."""
    for one, below in followed(node.body):
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name) and not one.target.id.startswith("_"):
            kind = re.sub(r"^(?:ClassVar|Final)(?:\[(.*)\])?$", r"\1", of.of(one.annotation))
            default, told = default_of(of, one.value)
            yield Entry(one.target.id, kind, default, one_line(below or told or said.get(one.target.id, "")))
        elif isinstance(one, ast.FunctionDef) and one.name == "__init__":
            for inner, text in followed(one.body):
                if isinstance(inner, ast.Assign | ast.AnnAssign):
                    target = inner.targets[0] if isinstance(inner, ast.Assign) else inner.target
                    if (
                        isinstance(target, ast.Attribute)
                        and not target.attr.startswith("_")
                        and (text or target.attr in said)
                    ):
                        kind = of.of(inner.annotation) if isinstance(inner, ast.AnnAssign) else ""
                        yield Entry(target.attr, kind, "", one_line(text or said[target.attr]))


# -- events ------------------------------------------------------------------------------------------------------------


def events() -> str:
    from aiorts import events as module

    parts = []
    for name in sorted(module.__all__):
        cls = getattr(module, name)
        made = of_class(cls)
        assert made is not None
        said = doc_of(cls.__doc__)
        out = f"## `{name}`\n\n{said.first}\n"
        if issubclass(cls, Enum):
            out += "\n" + "".join(f"- `{member.name}` = `{member.value!r}`\n" for member in cls)
        else:
            bases = [
                base.__name__
                for base in cls.__mro__[1:]
                if base.__name__ in module.__all__ and base is not module.Event
            ]
            out += f"\nDerived from {listed(bases)}.\n" if bases else ""
            entries = [str(one) for one in fields_of(cls) if one.name != "sequence" or name in ("Event", "Change")]
            out += "\n" + "\n".join(entries) + "\n" if entries else ""
        parts.append(out)
    return "\n".join(parts)


# -- statistics --------------------------------------------------------------------------------------------------------

REPORTS: Final = {
    "Connectors": ("ConnectorStatistics", "ConnectorProfile", "PublisherTiming", "Spans"),
    "Synchronisers": ("SynchronizerStatistics",),
    "Execution contexts": ("ContextStatistics", "HookStatistics", "ContextProfile"),
    "The event loop": ("LoopStalls", "Blame", "GcPauses"),
    "Components and ports": ("ComponentProfile", "PortProfile", "ThreadWriteStatistics", "LogLine"),
    "Configuration": ("ConfigurationProfile", "ParameterProfile"),
    "Services": (
        *("ServiceStatistics", "GoalStatistics", "ServiceConnectorProfile", "InterfaceProfile", "MethodProfile"),
        "aiorts.model.profile.ParameterProfile",
    ),
    "Observers, recordings": ("ObserverStatistics", "RecordingStatistics"),
    "The whole system": (
        *("SystemProfile", "ClockReport", "ComponentReport", "ParameterReport", "ConfigurationReport"),
        *("MachineReport", "ModeReport", "CompositeReport", "ConnectorReport", "ServiceConnectorReport"),
        *("BindingReport", "ContextReport", "ProcessReport", "Limits"),
    ),
}
_HOMES: Final = (
    *("aiorts.model.configuration.configuration_profile", "aiorts.model.profile", "aiorts.model.timing"),
    *("aiorts.model.service_profile", "aiorts.model.blame", "aiorts.diagnostics.loop_monitor"),
    "aiorts.sync.matching",
    *("aiorts.kernel.loop.observers", "aiorts.observe.profiles", "aiorts.observe.part", "aiorts_log.recorder.options"),
)


def report_class(name: str) -> type:
    """A class of the page, by name or by its full name."""
    home, _, name = name.rpartition(".")
    for module in [home] if home else _HOMES:
        if (found := vars(importlib.import_module(module)).get(name)) is not None and found.__module__ == module:
            assert isinstance(found, type)
            return found
    raise LookupError(name)


def statistics() -> str:
    parts = []
    for title, names in REPORTS.items():
        parts.append(f"## {title}\n")
        for name in names:
            cls = report_class(name)
            made = of_class(cls)
            assert made is not None
            assert isinstance(made.node, ast.ClassDef)
            known = {"aiorts.model.profile.ParameterProfile": "ParameterProfile of a method"}.get(name, cls.__name__)
            out = f"### {known}\n\n{doc_of(ast.get_docstring(made.node)).first}\n"
            if given := _givers(cls):
                out += f"\nGiven by {listed(given)}.\n"
            out += "\n" + "".join(f"{one}\n" for one in fields_of(cls))
            attributes, methods = _members(cls, [(made.source, made.node)], Doc("", {}))
            names_of = {one.name for one in fields_of(cls)}
            out += "".join(f"{one}\n" for one in [*attributes, *methods] if re.split(r"[`:(]", one)[1] not in names_of)
            parts.append(out)
    return "\n".join(parts)


@cache
def _given() -> list[tuple[str, str, Source]]:
    """Every public property and method, with what it says that it gives, and where."""
    found = []
    for path, value in public().items():
        if not isinstance(value, type) or first_path().get(id(value)) != path:
            continue
        for of, node in _walk(value)[0]:
            for one in flat(node.body):
                if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef) or one.name.startswith("_"):
                    continue
                if one.returns is not None and "overload" not in (marks := decorators(one)):
                    call = "" if marks & {"property", "cached_property"} else "()"
                    found.append((f"{path.rpartition('.')[2]}.{one.name}{call}", of.of(one.returns), of))
    return found


def _givers(cls: type) -> list[str]:
    """The public properties and methods that give one."""
    named = re.compile(rf"\b{cls.__name__}\b")
    every = [(path, of) for path, kind, of in _given() if named.search(kind)]
    return list(dict.fromkeys(path for path, of in every if definition(of.module, cls.__name__) == of_class(cls)))
