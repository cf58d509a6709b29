"""Write the reference pages of the guide from the code. Run: python tests/reference.py

Each page is one function without arguments that gives its text. Descriptions are the docstrings and help texts
themselves: what is unclear on a page is corrected there. A test fails when a page is stale.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import click

ROOT: Final = Path(__file__).parents[1]
FOLDER: Final = ROOT / "aiorts" / "guide" / "pages" / "reference"
_WIDTH: Final = 74
_PROSE: Final = 120
_SPECIAL: Final = re.compile(r" *(?:[-*+] |[|#>]|\d+[.)] )")
"""What a line of prose may not begin with: Markdown takes it for something else."""
_STALE: Final = "<!-- Written by tests/reference.py from the code: correct the docstrings and help texts there. -->\n"
_SECTION: Final = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):$")
_ENTRY: Final = re.compile(r"^    (\*{0,2}\w+(?:, \*{0,2}\w+)*): (.*)$")

HEADS: Final = {
    "api": """# Public names

Every name that a program or a plugin may import, by module, with its signature, what it raises and what it has.

A name that is not here is internal and may change.""",
    "system-file": """# System files

Every table and key of a system file, the TOML file that `aiorts run` runs, with type, default and meaning.

`aiorts check FILE` finds mistakes. `aiorts schema` prints the same as a JSON Schema for editors. A parameter that is a
number or true or false may also be written as the text that means it, such as `"0x10"` or `"yes"`.""",
    "command-line": """# The command line

Every command of `aiorts` with its arguments and options, as `aiorts COMMAND --help` shows them.

Each also has `-h, --help`. [Exit status](exit-status.md) and [error codes](error-codes.md) have their own pages.""",
    "error-codes": """# Error codes

Every code that a message of aiorts begins with, what it means, its usual cause and what to do.

A message reads `aiorts: E-CODE: where: cause; what to do`. `E-` is an error, `W-` a warning, `N-` a note of
`aiorts check`. `aiorts help errors E-CODE` shows one of them. What a command ends with, [exit status](exit-status.md)
says.""",
    "exit-status": """# Exit status

The status that each command of `aiorts` ends with, for scripts and service managers.""",
    "record-types": """# Record types

Every record and enumeration that comes with aiorts, with its fields, their units and their meaning.

A port may have each of them as its type, and also `bool`, `int`, `float`, `str`, `bytes` and records of your own. `tm`
is the time stamp, in nanoseconds since the epoch. Numbers are named by kind and size: `i16` is an integer of 16 bits,
`u8` one of 8 bits without sign, `f64` a float of 64 bits. `seq[f64]` is a sequence. `aiorts inspect NAME` shows one
type with its defaults and a line of JSON.""",
    "flexi": """# Flexi components

The options and parameters of the seven components whose ports are chosen when they start, for the command line and for
system files.

Each is a Unix filter (`aiorts flexiadd`) that reads and writes lines of JSON, and a type for system files
(`type = "FlexiAdd"`), with `options` as on the command line or `params` by name. A mistake in a type, a map or a
constant is refused when the component is created; the message marks its place in the text.""",
    "events": """# Events

Every event of `aiorts.events` with its fields, for programs that observe a kernel.

`kernel.bus.subscribe(StateChanged, observer)` calls `observer` with each event of that class and of the classes derived
from it. Each event also has `sequence: int`, its number on the bus of its kernel. A time is in nanoseconds where its
name ends with `_ns`, else in seconds.""",
    "statistics": """# Statistics and profiles

Every class of counts, times and descriptions that a kernel gives, with fields and units.

All are frozen: a value describes one moment and does not change. A field whose name ends with `_ns` is in nanoseconds.
`kernel.profile()` gives the whole system, and `kernel.profile().to_json()` the same as JSON, with the schema
`aiorts.profile_schema()`.""",
}
"""The beginning of each page."""

Node = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef | ast.Assign | ast.AnnAssign

# -- what the source says ----------------------------------------------------------------------------------------------


class Source:
    """One module, read and not run."""

    def __init__(self, module: str) -> None:
        spec = importlib.util.find_spec(module)
        assert spec is not None
        assert spec.origin is not None
        self.module = module
        self.text = Path(spec.origin).read_text(encoding="utf-8")
        self.lines = self.text.splitlines(keepends=True)
        self.tree = ast.parse(self.text)

    def of(self, node: ast.expr | ast.arg) -> str:
        """What stands there, in one line."""
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        lines = [line.encode() for line in self.lines[first : last + 1]]
        lines[-1] = lines[-1][: node.end_col_offset]
        lines[0] = lines[0][node.col_offset :]
        text = " ".join(re.sub(r"  # .*", "", line.decode()).strip() for line in lines)
        return re.sub(r",? ([\])}])", r"\1", re.sub(r"([\[({]) ", r"\1", text))


@cache
def source(module: str) -> Source:
    return Source(module)


def _flat(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """The statements of a body, with those below `if`."""
    for node in body:
        if isinstance(node, ast.If):
            yield from _flat(node.body)
            yield from _flat(node.orelse)
        else:
            yield node


def _followed(body: Iterable[ast.stmt]) -> Iterator[tuple[ast.stmt, str]]:
    """Each statement with the text that stands below it, as its documentation."""
    nodes = list(_flat(body))
    for at, node in enumerate(nodes):
        after = nodes[at + 1] if at + 1 < len(nodes) else None
        text = ""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str):
            text = inspect.cleandoc(after.value.value)
        yield node, text


class Definition(NamedTuple):
    source: Source
    node: Node
    below: str
    """The text below an assignment."""


@cache
def _names(module: str) -> dict[str, Definition | tuple[str, str]]:
    """What each name of a module is there: a definition, or the module and the name that it is imported from."""
    of, defined, imported = source(module), dict[str, Definition](), dict[str, tuple[str, str]]()
    for node, below in _followed(of.tree.body):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            defined[node.name] = Definition(of, node, "")
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            defined |= {one.id: Definition(of, node, below) for one in targets if isinstance(one, ast.Name)}
        elif isinstance(node, ast.ImportFrom) and node.module:
            imported |= {alias.asname or alias.name: (node.module, alias.name) for alias in node.names}
    return {**imported, **defined}


def definition(module: str, name: str) -> Definition | None:
    """Where a name is defined that a module has; None for one that is no code of ours."""
    found = _names(module).get(name) if module.startswith("aiorts") else None
    if isinstance(found, Definition):
        return found
    return definition(*found) if found not in (None, (module, name)) else None


def of_class(cls: type) -> Definition | None:
    made = definition(cls.__module__, cls.__name__) if "<" not in cls.__qualname__ else None
    return made if made is not None and isinstance(made.node, ast.ClassDef) else None


class Doc(NamedTuple):
    """A docstring: its first paragraph, and its sections."""

    first: str
    sections: Mapping[str, list[tuple[str, str]]]


def doc_of(text: str | None) -> Doc:
    paragraphs = inspect.cleandoc(text or "").split("\n\n")
    sections: dict[str, list[tuple[str, str]]] = {}
    for paragraph in paragraphs[1:]:
        head, *lines = paragraph.split("\n")
        if (title := _SECTION.match(head)) is None:
            continue
        entries = sections.setdefault(title[1], [])
        for line in lines:
            if (found := _ENTRY.match(line)) is not None and title[1] not in ("Returns", "Yields"):
                entries.append((found[1], found[2]))
            elif entries:
                entries[-1] = (entries[-1][0], f"{entries[-1][1]} {line.strip()}")
            else:
                entries.append(("", line.strip()))
    return Doc(_line(paragraphs[0]), sections)


def _line(text: str) -> str:
    return " ".join(text.replace("``", "`").split())


class Entry(NamedTuple):
    """An attribute: what it is called, its type, its default and what it means."""

    name: str
    type: str
    default: str
    doc: str

    def __str__(self) -> str:
        default = f" = {self.default}" if self.default else ""
        kind = f": {self.type}" if self.type else ""
        return item(f"{self.name}{kind}{default}", self.doc)


def item(code: str, text: str) -> str:
    """A line of a list."""
    return f"- `{code}`: {text}" if text else f"- `{code}`"


def fields_of(cls: type) -> list[Entry]:
    """What the bodies of a class and its bases declare, the base's own first, and what a docstring says of it."""
    found: dict[str, Entry] = {}
    for base in reversed(cls.__mro__):
        made = of_class(base)
        if made is None:
            continue
        assert isinstance(made.node, ast.ClassDef)
        said = dict(doc_of(ast.get_docstring(made.node)).sections.get("Attributes", ()))
        for node, below in _followed(made.node.body):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                kind, name = made.source.of(node.annotation), node.target.id
                if not name.startswith("_") and not kind.startswith("ClassVar"):
                    default, told = _default(made.source, node.value)
                    found[name] = Entry(name, kind, default, _line(below or told or said.get(name, "")))
    return list(found.values())


def _default(of: Source, value: ast.expr | None) -> tuple[str, str]:
    """A default as it is written, and the description of `setting(default, text)`."""
    if value is None:
        return "", ""
    if isinstance(value, ast.Call):
        name = of.of(value.func)
        if name == "setting":
            return _plain(of, value.args[0]), str(getattr(value.args[1], "value", ""))
        if name == "field" and any(one.arg == "default" for one in value.keywords):
            return _plain(of, next(one.value for one in value.keywords if one.arg == "default")), ""
        return "...", ""
    return _plain(of, value), ""


def _plain(of: Source, value: ast.expr) -> str:
    text = of.of(value)
    return "..." if re.search(r"\b_[A-Za-z]|lambda|\n", text) or len(text) > 40 else text


# -- signatures --------------------------------------------------------------------------------------------------------


def parameters(of: Source, node: ast.FunctionDef | ast.AsyncFunctionDef, *, bound: bool) -> list[str]:
    """The parameters as they are written, without `self`."""
    args = node.args
    every = [*args.posonlyargs, *args.args]
    defaults = [None] * (len(every) - len(args.defaults)) + list(args.defaults)
    parts = [_parameter(of, one, default) for one, default in zip(every, defaults, strict=True)]
    if args.posonlyargs:
        parts.insert(len(args.posonlyargs), "/")
    if bound:
        parts = parts[1:]
    if args.vararg is not None:
        parts.append(f"*{_parameter(of, args.vararg, None)}")
    elif args.kwonlyargs:
        parts.append("*")
    parts += [_parameter(of, *one) for one in zip(args.kwonlyargs, args.kw_defaults, strict=True)]
    if args.kwarg is not None:
        parts.append(f"**{_parameter(of, args.kwarg, None)}")
    return [part for part in parts if not part.startswith("_")]


def _parameter(of: Source, one: ast.arg, default: ast.expr | None) -> str:
    kind = f": {of.of(one.annotation)}" if one.annotation is not None else ""
    return f"{one.arg}{kind}" if default is None else f"{one.arg}{kind}{' = ' if kind else '='}{_plain(of, default)}"


def wrapped(head: str, parts: list[str], tail: str) -> str:
    """A signature in one line, or with a parameter in each."""
    line = f"{head}({', '.join(parts)}){tail}"
    if len(line) <= _WIDTH or not parts:
        return line
    return f"{head}(\n" + "".join(f"    {part},\n" for part in parts) + f"){tail}"


def _returns(of: Source, node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    return f" -> {of.of(node.returns)}" if node.returns is not None else ""


def _decorators(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> set[str]:
    return {ast.unparse(one).partition("(")[0].rpartition(".")[2] for one in node.decorator_list}


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
        names = _listed(one for one in own if not one.startswith("_"))
        return f"A module. {doc_of(value.__doc__).first} It has {names}.\n"
    if made is None:
        said = doc_of(inspect.getdoc(value))
        return f"{_code(f'class {name}')}{said.first}\n"
    if isinstance(made.node, ast.ClassDef):
        return _class(path, value, made.source, made.node)
    if isinstance(made.node, ast.FunctionDef | ast.AsyncFunctionDef):
        said = doc_of(ast.get_docstring(made.node))
        way = "async def" if isinstance(made.node, ast.AsyncFunctionDef) else "def"
        head = wrapped(
            f"{way} {name}", parameters(made.source, made.node, bound=False), _returns(made.source, made.node)
        )
        return f"{_code(head)}{said.first}\n{_sections(said)}"
    return _value(name, value, made)


def _value(name: str, value: Any, made: Definition) -> str:
    assert isinstance(made.node, ast.Assign | ast.AnnAssign)
    written = made.source.of(made.node.value) if made.node.value is not None else ""
    below = f"{doc_of(made.below).first}\n" if made.below else ""
    if isinstance(value, int | str):
        return f"{_code(f'{name} = {value!r}')}{below}"
    short = _code(f"{name} = {written}") if len(written) <= _WIDTH - len(name) else ""
    if isinstance(value, Mapping) and value:
        below += "\nIts keys: " + ", ".join(f"`{key}`" for key in value) + ".\n"
    return f"{short}{below}".lstrip("\n") or f"{_code(name)}"


def _code(text: str) -> str:
    return f"```text\n{text}\n```\n\n"


def _sections(said: Doc, *names: str) -> str:
    out = ""
    for title in names or ("Args", "Returns", "Yields", "Raises"):
        entries = said.sections.get(title)
        if entries and title in ("Returns", "Yields"):
            out += f"\n{title}: {_line(entries[0][1])}\n"
        elif entries:
            out += f"\n{title}:\n\n" + "".join(f"{item(name, _line(text))}\n" for name, text in _resolved(entries))
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
        return f"{said.first}\n\n{'Members' if issubclass(cls, Enum) else 'Fields'}: {_listed(shown)}.\n"
    if issubclass(cls, Enum):
        members = "".join(f"- `{member.name}` = `{member.value!r}`\n" for member in cls)
        return f"{_code(f'class {name}')}{said.first}\n\nMembers:\n\n{members}"
    own, bases = _walk(cls)
    parts = _constructor(cls, own, said)
    head = f"class {name}" if parts is None else wrapped(f"class {name}", parts, "")
    out = f"{_code(head)}{said.first}\n"
    if code := getattr(cls, "code", ""):
        out += f"\nIts code is `{code}`.\n"
    if bases:
        out += f"\nDerived from {_listed(bases)}.\n"
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


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


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
        for one in _flat(node.body):
            if isinstance(one, ast.FunctionDef) and one.name == name and "overload" not in _decorators(one):
                return of, one
    return None


def _constructor(cls: type, own: list[tuple[Source, ast.ClassDef]], said: Doc) -> list[str] | None:
    """The parameters of a class; None where its attributes say the same, or it is not made by its user."""
    every = [(made.source, made.node) for base in cls.__mro__ if (made := of_class(base)) is not None]
    bodies = [(of, node) for of, node in every if isinstance(node, ast.ClassDef)]
    data = any("dataclass" in _decorators(node) for _, node in own)
    for made in () if data else ("__init__", "__new__"):
        if (found := _method(bodies, made)) is not None:
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
        for one in _flat(node.body):
            if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef) or one.name.startswith("_"):
                continue
            marks = _decorators(one)
            if marks & {"overload", "setter", "deleter"}:
                continue
            told = doc_of(ast.get_docstring(one) or _inherited(cls, one.name))
            raised = [name for name, _ in told.sections.get("Raises", ())]
            text = told.first + (f" Raises {_listed(raised)}." if raised else "")
            if marks & {"property", "cached_property"}:
                kind = _returns(of, one).removeprefix(" -> ")
                attributes.setdefault(one.name, item(f"{one.name}: {kind}" if kind else one.name, text))
                continue
            way = "async " if isinstance(one, ast.AsyncFunctionDef) else ""
            line = ", ".join(parameters(of, one, bound="staticmethod" not in marks))
            methods.setdefault(one.name, item(f"{way}{one.name}({line}){_returns(of, one)}", text))
    return list(attributes.values()), list(methods.values())


def _inherited(cls: type, name: str) -> str:
    return inspect.getdoc(getattr(cls, name, None)) or ""


def _declared(of: Source, node: ast.ClassDef, said: Mapping[str, str]) -> Iterator[Entry]:
    """The attributes that a class body or its `__init__` documents."""
    for one, below in _followed(node.body):
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name) and not one.target.id.startswith("_"):
            kind = re.sub(r"^(?:ClassVar|Final)(?:\[(.*)\])?$", r"\1", of.of(one.annotation))
            default, told = _default(of, one.value)
            yield Entry(one.target.id, kind, default, _line(below or told or said.get(one.target.id, "")))
        elif isinstance(one, ast.FunctionDef) and one.name == "__init__":
            for inner, text in _followed(one.body):
                if isinstance(inner, ast.Assign | ast.AnnAssign):
                    target = inner.targets[0] if isinstance(inner, ast.Assign) else inner.target
                    if (
                        isinstance(target, ast.Attribute)
                        and not target.attr.startswith("_")
                        and (text or target.attr in said)
                    ):
                        kind = of.of(inner.annotation) if isinstance(inner, ast.AnnAssign) else ""
                        yield Entry(target.attr, kind, "", _line(text or said[target.attr]))


# -- system files ------------------------------------------------------------------------------------------------------


def system_file() -> str:
    from aiorts.system import schema

    made = schema()
    parts = []
    top = made["properties"]
    parts.append("## At the top\n\n" + _keys({"schema": top.pop("schema")}, made["required"]))
    parts.append(_table("[plugins]", top.pop("plugins"), "Where to look for components besides installed packages."))
    clock = top.pop("clock")
    kinds = [word for one in clock["oneOf"] for word in _words(one["properties"]["kind"])]
    speed = _key("speed", clock["oneOf"][1]["properties"]["speed"], required=False).rstrip()
    parts.append(
        f"## `[clock]`\n\n{_sentence(clock['description'])}\n\n"
        f"{_key('kind', {'enum': kinds, 'default': 'system'}, required=False)}"
        f'{speed} Required with kind `"scaled"`, and only there.\n'
    )
    component = made["$defs"]["component"]["oneOf"][-1]
    parts.append(
        f"## `[components.NAME]`\n\n{_sentence(top.pop('components')['description'])}\n\n"
        + _keys(
            {
                **component["properties"],
                "type": {
                    "type": "string",
                    "description": f"An installed component by name; {component['properties']['type']['description']}.",
                },
                "params": {"type": "object", "description": "[components.NAME.params]: parameters by name."},
                "supervision": {"type": "object", "description": "See [components.NAME.supervision]."},
                "start": {"type": "object", "description": "See [components.NAME.start]."},
            },
            ["type"],
        )
    )
    parts += [_table(f"[components.NAME.{name}]", made["$defs"][name]) for name in ("supervision", "start")]
    parts.append(_table("[composites.NAME]", made["$defs"]["composite"]))
    top.pop("composites")
    parts.append(_table("[[connections]]", made["$defs"]["connection"], top.pop("connections")["description"]))
    parts.append(_contexts(top.pop("contexts"), made["$defs"]["context"]["oneOf"]))
    parts += [_table(f"[{name}]", table) for name, table in top.items()]
    return "\n".join(parts)


def _contexts(table: Mapping[str, Any], kinds: list[dict[str, Any]]) -> str:
    out = f"## `[contexts.NAME]`\n\n{_sentence(table['description'])}\n"
    shared = {
        name: value
        for name, value in kinds[0]["properties"].items()
        if name != "kind" and all(one["properties"].get(name) == value for one in kinds)
    }
    words = [one["properties"]["kind"]["const"] for one in kinds]
    out += f"\n- `kind`: {_choice(words)}; required.\n" + _keys(shared, kinds[0]["required"])
    for one in kinds:
        kind = one["properties"]["kind"]
        rest = {name: value for name, value in one["properties"].items() if name != "kind" and name not in shared}
        out += f'\n### `kind = "{kind["const"]}"`\n\n{_line(kind.get("description", ""))}\n\n' + _keys(
            rest, one["required"]
        )
    return out


def _sentence(text: str) -> str:
    """A description without the table's name that stands before it."""
    said = re.sub(r"^\[\[?[\w.]+\]\]?: ", "", text)
    return said[:1].upper() + said[1:]


def _table(name: str, table: Mapping[str, Any], text: str = "") -> str:
    said = _sentence(table.get("description", text))
    return f"## `{name}`\n\n{said}\n\n{_keys(table['properties'], table.get('required', ()))}"


def _keys(table: Mapping[str, Any], required: Iterable[str]) -> str:
    return "".join(_key(name, value, required=name in set(required)) for name, value in table.items())


def _key(name: str, value: Mapping[str, Any], *, required: bool) -> str:
    facts = [_kind(value)]
    if required:
        facts.append("required")
    if "default" in value and value["default"] is not None:
        facts.append(f"default `{_toml(value['default'])}`")
    text = _ticked(_line(value.get("description", "").replace("\n", " ")))
    told = "; ".join(fact for fact in facts if fact)
    below = value.get("properties", {})
    more = f" Its keys: {_listed(below)}, each a {_kind(next(iter(below.values())))}." if below else ""
    return item(name, f"{f'{told}. ' if told else ''}{text}{more}".strip()) + "\n"


def _ticked(text: str) -> str:
    """The text with names of tables as code, which Markdown would take for links."""
    return re.sub(r"(?<![`\w])(\[\[?[a-z_]+(?:\.[A-Za-z_]+)*\]?\])(?!`)", r"`\1`", text)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value).replace("'", '"')


def _words(value: Mapping[str, Any]) -> list[str]:
    return [value["const"]] if "const" in value else list(value.get("enum", ()))


def _choice(words: Iterable[Any]) -> str:
    return "one of " + ", ".join(f"`{_toml(word)}`" for word in words)


_KINDS: Final = {
    "object": "table",
    "array": "array",
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
}
_LIMITS: Final = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}


def _kind(value: Mapping[str, Any]) -> str:
    if words := _words(value):
        return _choice(words) if len(words) > 1 else f"always `{_toml(words[0])}`"
    if several := value.get("anyOf"):
        found = [_kind(one) for one in several if "pattern" not in one or one is several[0]]
        found = [one for one in found if "true or false" not in found or not one.startswith("one of")]
        return " or ".join(dict.fromkeys(found))
    kind = value.get("type", "")
    kinds = [kind] if isinstance(kind, str) else list(kind)
    if "array" in kinds and isinstance(items := value.get("items"), dict):
        inner = items.get("type", "")
        plural = {"string": "array of texts", "number": "array of numbers", "array": "array of arrays of texts"}
        kinds[kinds.index("array")] = plural.get(inner, "array") if isinstance(inner, str) else "array"
    said = " or ".join(_KINDS.get(one, one) for one in kinds)
    limits = [f"{word} {_shown(value[name])}" for name, word in _LIMITS.items() if name in value]
    return f"{said}, {', '.join(limits)}" if limits else said


def _shown(number: float) -> str:
    return f"{number:,}" if isinstance(number, int) else f"{number:g}"


# -- the command line --------------------------------------------------------------------------------------------------


def command_line() -> str:
    from aiorts.cli.app import aiorts

    return "\n".join(_commands(aiorts, click.Context(aiorts, info_name="aiorts"), 2))


def _commands(command: click.Command, context: click.Context, depth: int) -> Iterator[str]:
    yield f"{'#' * depth} `{context.command_path}`\n\n{_command(command, context)}"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from _commands(below, click.Context(below, parent=context, info_name=name), min(depth + 1, 3))


def _command(command: click.Command, context: click.Context) -> str:
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    out = _code(textwrap.fill(usage, _WIDTH, subsequent_indent="    ", break_on_hyphens=False))
    out += _help(command.help or "")
    options = [one for one in command.params if isinstance(one, click.Option) and not one.hidden]
    if options:
        out += "\nOptions:\n\n" + "".join(_option(one) for one in options)
    if context.command_path == "aiorts run":
        for name, found in _of_services(command).items():
            out += f"\nOptions of the service `{name}`:\n\n" + "".join(_option(one) for one in found)
    return out


def _of_services(command: click.Command) -> Mapping[str, list[click.Option]]:
    from aiorts.cli.runtime import service_options

    found: Mapping[str, list[click.Option]] = service_options._found((), command.params)[0]
    return found


def _help(text: str) -> str:
    """The help of a command: what it marks to stay as it is becomes code."""
    out = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if paragraph.startswith("\b\n"):
            out.append(f"```text\n{textwrap.dedent(paragraph[2:])}\n```")
        else:
            out.append(_ticked(_line(paragraph)))
    return "\n\n".join(out) + "\n"


def _option(option: click.Option) -> str:
    names = ", ".join(option.opts) + "".join(f" / {name}" for name in option.secondary_opts)
    kind = option.type
    value = ""
    if not option.is_flag and not option.count:
        value = "|".join(map(str, kind.choices)) if isinstance(kind, click.Choice) else kind.name.split(" ")[0].upper()
        value = f" {option.metavar or value}"
    text = re.sub(r"(?<!\.)\.$", "", _ticked(_line(option.help or "")))
    more = "; ".join(
        fact for fact in _facts(option) if fact not in text and not (fact == "repeatable" and _TOLD.search(text))
    )
    parts = [text if not text or text.endswith(".") else f"{text}.", f"{more[:1].upper()}{more[1:]}." if more else ""]
    return item(f"{names}{value}", " ".join(filter(None, parts))) + "\n"


_TOLD: Final = re.compile(r"repeat|more than once")
"""Words of a help text that says that an option may be repeated."""


def _facts(option: click.Option) -> Iterator[str]:
    kind = option.type
    if isinstance(kind, click.IntRange | click.FloatRange):
        low, high = "above" if kind.min_open else "at least", "below" if kind.max_open else "at most"
        bounds = [f"{low} {kind.min}"] if kind.min is not None else []
        bounds += [f"{high} {kind.max}"] if kind.max is not None else []
        yield " and ".join(bounds)
    if option.required:
        yield "required"
    if option.multiple:
        yield "repeatable"
    if type(option.default) in (str, int, float) and option.default != "" and not option.is_flag:
        yield f"default `{option.default}`"


# -- codes and statuses ------------------------------------------------------------------------------------------------


def error_codes() -> str:
    from aiorts import errors
    from aiorts.cli.console.codes import CODES

    raised: dict[str, list[str]] = {}
    for name in errors.__all__:
        cls = getattr(errors, name)
        if isinstance(cls, type) and issubclass(cls, errors.AiortsError):
            raised.setdefault(cls.code, []).append(f"aiorts.errors.{name}")
    parts = []
    for code, one in sorted(CODES.items()):
        lines = [f"- Cause: {one.cause}", f"- Remedy: {one.remedy}"]
        if code in raised:
            lines.append(f"- Raised as {_listed(raised[code])}.")
        parts.append(f"## `{code}`\n\n{one.meaning}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def exit_status() -> str:
    from aiorts import exits

    names = {str(value): name for name in exits.__all__ if isinstance(value := getattr(exits, name), int)}
    lines = []
    for status, meaning in exits.TABLE:
        name = f" (`aiorts.exits.{names[status]}`)" if status in names else ""
        lines.append(f"- `{status}`{name}: {_ticked(meaning)}.\n")
    return (
        f"{''.join(lines)}\n"
        "A component ends `aiorts run` with a status of its own by `self.kernel.request_stop(status)`. A filter that "
        "could not read a line goes on and ends with `1`. Which error a message is about says its code: "
        "[error codes](error-codes.md).\n"
    )


# -- record types ------------------------------------------------------------------------------------------------------

_GROUPS: Final = {
    "basic": "Basic records of OpenRTM",
    "extended": "Extended records of OpenRTM",
    "interface": "Records of OpenRTM's device interfaces",
    "extra": "Further records",
    "ros": "Messages of ROS 2",
}


def record_types() -> str:
    from aiorts import types
    from aiorts.cli.commands.record_types import profile_of_type
    from aiorts.types import all_types, ros

    ours = {id(getattr(module, name)) for module in (types, ros) for name in module.__all__}
    profiles = [profile_of_type(cls) for cls in all_types().values() if id(cls) in ours]
    parts = []
    for group, title in _GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [_record(one) for one in profiles if one["group"] == group]
    return "\n".join(parts)


def _record(profile: Mapping[str, Any]) -> str:
    said = doc_of(profile["doc"]).first
    if profile["openrtm"]:
        said += f" `{profile['openrtm'].split(' ')[0]}` of OpenRTM."
    out = f"### `{profile['name']}`\n\n{said.strip()}\n\n"
    if profile["kind"] == "enum":
        return out + "".join(f"- `{name}` = {value}\n" for name, value in profile["members"].items())
    for one in profile["fields"]:
        unit = f" [{one['unit']}]" if one["unit"] else ""
        text = "" if one["name"] == "tm" else one["doc"]
        out += item(f"{one['name']}: {one['type']}{unit}", _line(text)) + "\n"
    return out


# -- Flexi components --------------------------------------------------------------------------------------------------


def flexi() -> str:
    from aiorts_flexi.readme import COMPONENTS

    parts = []
    for cls in sorted(COMPONENTS, key=lambda cls: cls.__name__):
        paragraphs = [_ticked(_line(one)) for one in inspect.cleandoc(cls.__doc__ or "").split("\n\n")]
        parts.append(f"## {cls.__name__}\n\n" + "\n\n".join(paragraphs) + f"\n\nPorts: {cls.interface}.\n")
        if cls.help_text:
            parts.append(_help(cls.help_text))
        parts.append("Options:\n")
        for one in cls.options:
            sets = f" Sets `{one.param}`." if one.param else ""
            needed = " Required." if one.required else ""
            parts[-1] += "\n" + item(", ".join(one.flags), f"{one.help}.{needed}{sets}")
        parts[-1] += "\n"
        parts.append("Parameters:\n")
        for each in cls("x").params.values():
            limits = str(each.spec.constraint)
            if limits and not limits.startswith("one of"):
                limits = f"`{limits}`"
            unit = f" [{each.spec.unit}]" if each.spec.unit else ""
            default = str(each.spec.default) if isinstance(each.spec.default, Path) else each.spec.default
            allowed = f"; {limits}" if limits else ""
            parts[-1] += "\n" + item(
                f"{each.name}: {each.spec.type_text}{unit} = {default!r}", f"{each.spec.doc.rstrip('.')}{allowed}."
            )
        parts[-1] += "\n"
    return "\n".join(parts)


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
            out += f"\nDerived from {_listed(bases)}.\n" if bases else ""
            entries = [str(one) for one in fields_of(cls) if one.name != "sequence" or name in ("Event", "Change")]
            out += "\n" + "\n".join(entries) + "\n" if entries else ""
        parts.append(out)
    return "\n".join(parts)


# -- statistics --------------------------------------------------------------------------------------------------------

_REPORTS: Final = {
    "Connectors": ("ConnectorStatistics", "ConnectorProfile", "PublisherTiming", "Spans"),
    "Execution contexts": ("ContextStatistics", "HookStatistics", "ContextProfile"),
    "The event loop": ("LoopStalls", "Blame", "GcPauses"),
    "Components and ports": ("ComponentProfile", "PortProfile", "LogLine"),
    "Configuration": ("ConfigurationProfile", "ParameterProfile"),
    "Services": (
        *("ServiceStatistics", "ServiceConnectorProfile", "InterfaceProfile", "MethodProfile"),
        "aiorts.model.profile.ParameterProfile",
    ),
    "Observers, recordings": ("ObserverStatistics", "RecordingStatistics"),
    "The whole system": (
        *("SystemProfile", "ClockReport", "ComponentReport", "ParameterReport", "ConfigurationReport"),
        *("MachineReport", "ModeReport", "CompositeReport", "ConnectorReport", "ServiceConnectorReport"),
        *("BindingReport", "ContextReport"),
    ),
}
_HOMES: Final = (
    *("aiorts.model.configuration.configuration_profile", "aiorts.model.profile", "aiorts.model.timing"),
    *("aiorts.model.service_profile", "aiorts.model.blame", "aiorts.diagnostics.loop_monitor"),
    *("aiorts.kernel.loop.observers", "aiorts.observe.profiles", "aiorts_log.recorder.options"),
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
    for title, names in _REPORTS.items():
        parts.append(f"## {title}\n")
        for name in names:
            cls = report_class(name)
            made = of_class(cls)
            assert made is not None
            assert isinstance(made.node, ast.ClassDef)
            known = {"aiorts.model.profile.ParameterProfile": "ParameterProfile of a method"}.get(name, cls.__name__)
            out = f"### {known}\n\n{doc_of(ast.get_docstring(made.node)).first}\n"
            if given := _givers(cls):
                out += f"\nGiven by {_listed(given)}.\n"
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
            for one in _flat(node.body):
                if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef) or one.name.startswith("_"):
                    continue
                if one.returns is not None and "overload" not in (marks := _decorators(one)):
                    call = "" if marks & {"property", "cached_property"} else "()"
                    found.append((f"{path.rpartition('.')[2]}.{one.name}{call}", of.of(one.returns), of))
    return found


def _givers(cls: type) -> list[str]:
    """The public properties and methods that give one."""
    named = re.compile(rf"\b{cls.__name__}\b")
    every = [(path, of) for path, kind, of in _given() if named.search(kind)]
    return list(dict.fromkeys(path for path, of in every if definition(of.module, cls.__name__) == of_class(cls)))


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "api": api,
    "system-file": system_file,
    "command-line": command_line,
    "error-codes": error_codes,
    "exit-status": exit_status,
    "record-types": record_types,
    "flexi": flexi,
    "events": events,
    "statistics": statistics,
}


def page(name: str) -> str:
    """The text of a page as it ought to be now."""
    return _folded(re.sub(r"\n{3,}", "\n\n", f"{HEADS[name]}\n\n{PAGES[name]()}").rstrip()) + f"\n\n{_STALE}"


def _literal(line: str) -> str:
    """The line, with what Markdown would take for HTML or for bold text as code."""
    parts = line.split("`")
    parts[::2] = [re.sub(r"[^\s,;(]*(?:<[A-Za-z]|\w\*\*\w)[^\s,;)]*(?<!\.)", r"`\g<0>`", part) for part in parts[::2]]
    return "`".join(parts)


def _folded(text: str) -> str:
    """The text with lines of prose no longer than those of other pages."""
    out, fenced = [], False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        if not fenced and not line.startswith(("#", "<!--", "```")):
            line = _literal(line)
        if fenced or len(line) <= _PROSE or line.startswith(("#", "<!--")):
            out.append(line)
            continue
        after = "  " if line.startswith("- ") else ""
        lines = textwrap.wrap(line, _PROSE, subsequent_indent=after, break_long_words=False, break_on_hyphens=False)
        out += [line] if any(_SPECIAL.match(one) for one in lines[1:]) else lines
    return "\n".join(out)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).with_name("architecture")))
    os.environ.pop("AIORTS_PLUGINS", None)
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PAGES:
        (FOLDER / f"{name}.md").write_text(page(name), encoding="utf-8")
        print(f"{FOLDER / name}.md")
