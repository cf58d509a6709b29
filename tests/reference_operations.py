"""The page of the reference that has what a kernel can be asked for, from the table of operations."""

from __future__ import annotations

import ast
import dataclasses
import re
import typing
from collections.abc import Iterator
from typing import Any

from aiorts.control.operation import Nothing, Operation
from aiorts.control.operations import OPERATIONS
from aiorts.model.annotations import fields_of_row
from aiorts.model.interface import spelled
from reference_api import REPORTS
from reference_source import doc_of, fields_of, of_class

_ELSEWHERE = frozenset(name for names in REPORTS.values() for name in names)
"""What the page of statistics describes."""


def operations() -> str:
    """Each operation, and the classes that its arguments, results and items are made of."""
    rows = sorted(OPERATIONS.values(), key=lambda row: row.name)
    own: dict[type, None] = {}
    for row in rows:
        for hint in (row.result, row.item, row.end):
            own |= dict.fromkeys(_classes(hint, set()))
    parts = ["## Operations\n", *map(_row, rows), "## What they answer\n"]
    parts += [_class(cls) for cls in sorted(own, key=lambda cls: cls.__name__)]
    return "\n".join(parts)


def _row(row: Operation) -> str:
    more = ", or more for some arguments" if row.demands is not None else ""
    again = " Calling it twice is as good as once." if row.idempotent else ""
    out = f"### {row.name}\n\n{row.text} Right: `{row.right.value}`{more}.{again}\n\n"
    if row.arguments is not Nothing:
        out += "".join(f"{one}\n" for one in fields_of(row.arguments)) + "\n"
    out += f"Answers `{_spelled(row.result)}`."
    if row.streams:
        out += f" Then items: `{_spelled(row.item)}`."
    if row.end is not None:
        out += f" At its end: `{_spelled(row.end)}`."
    return out + "\n"


def _spelled(hint: Any) -> str:
    if isinstance(hint, type) and not typing.get_args(hint):
        return hint.__name__
    return re.sub(r"\b(?:[a-z_]+\.)+(?=[A-Z])", "", spelled(hint))


def _class(cls: type) -> str:
    made = of_class(cls)
    assert made is not None
    assert isinstance(made.node, ast.ClassDef)
    told = doc_of(ast.get_docstring(made.node)).first
    return f"### {cls.__name__}\n\n{told}\n\n" + "".join(f"{one}\n" for one in fields_of(cls))


def _classes(hint: Any, seen: set[Any]) -> Iterator[type]:
    """The dataclasses and rows that a type mentions; statistics and system files have pages of their own."""
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or fields_of_row(hint)):
        if hint not in seen:
            seen.add(hint)
            if hint.__name__ not in _ELSEWHERE and hint.__module__ != "aiorts.model.wanted.entries":
                yield hint
                for one in typing.get_type_hints(hint).values():
                    yield from _classes(one, seen)
    else:
        for one in typing.get_args(hint):
            yield from _classes(one, seen)
