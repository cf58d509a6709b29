"""Read what the source says of itself, without running it: definitions, docstrings, fields and signatures."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

WIDTH: Final = 74
_SECTION: Final = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):$")
_ENTRY: Final = re.compile(r"^    (\*{0,2}\w+(?:, \*{0,2}\w+)*): (.*)$")

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


def flat(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """The statements of a body, with those below `if`."""
    for node in body:
        if isinstance(node, ast.If):
            yield from flat(node.body)
            yield from flat(node.orelse)
        else:
            yield node


def followed(body: Iterable[ast.stmt]) -> Iterator[tuple[ast.stmt, str]]:
    """Each statement with the text that stands below it, as its documentation."""
    nodes = list(flat(body))
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
    for node, below in followed(of.tree.body):
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
    return Doc(one_line(paragraphs[0]), sections)


def one_line(text: str) -> str:
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
        for node, below in followed(made.node.body):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                kind, name = made.source.of(node.annotation), node.target.id
                if not name.startswith("_") and not kind.startswith("ClassVar"):
                    default, told = default_of(made.source, node.value)
                    found[name] = Entry(name, kind, default, one_line(below or told or said.get(name, "")))
    return list(found.values())


def default_of(of: Source, value: ast.expr | None) -> tuple[str, str]:
    """A default as it is written, and the description of `setting(default, text)`, with its unit."""
    if value is None:
        return "", ""
    if isinstance(value, ast.Call):
        name = of.of(value.func)
        if name in ("setting", "option"):
            unit = next((f" Unit: {of.of(one.value)[1:-1]}." for one in value.keywords if one.arg == "unit"), "")
            return _plain(of, value.args[0]), str(getattr(value.args[1], "value", "")) + unit
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
    kind = f": {_undeclared(of, one.annotation)}" if one.annotation is not None else ""
    return f"{one.arg}{kind}" if default is None else f"{one.arg}{kind}{' = ' if kind else '='}{_plain(of, default)}"


def _undeclared(of: Source, annotation: ast.expr) -> str:
    """A type without the declaration that `Annotated` has beside it, also where a name stands for both."""
    text = of.of(annotation)
    for node in ast.walk(annotation):
        made = definition(of.module, node.id) if isinstance(node, ast.Name) else None
        value = made.node.value if made is not None and isinstance(made.node, ast.Assign) else node
        where = of if made is None else made.source
        if isinstance(value, ast.Subscript) and where.of(value.value) == "Annotated":
            assert isinstance(value.slice, ast.Tuple)
            text = text.replace(of.of(node), where.of(value.slice.elts[0]))
    return text


def wrapped(head: str, parts: list[str], tail: str) -> str:
    """A signature in one line, or with a parameter in each."""
    line = f"{head}({', '.join(parts)}){tail}"
    if len(line) <= WIDTH or not parts:
        return line
    return f"{head}(\n" + "".join(f"    {part},\n" for part in parts) + f"){tail}"


def returns(of: Source, node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    return f" -> {of.of(node.returns)}" if node.returns is not None else ""


def decorators(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> set[str]:
    return {ast.unparse(one).partition("(")[0].rpartition(".")[2] for one in node.decorator_list}


def block(text: str) -> str:
    return f"```text\n{text}\n```\n\n"


def listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
