"""Records inside records; records whose leaves all have one element type become rows of an array."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts.types.kinds import Kind, wrong_type
from aiorts.types.registry import full_name
from aiorts.types.rows import RowsKind
from aiorts.types.samples import frozen_class, snapshot
from aiorts.types.structure import NUMBERS, Structure

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class RecordKind(Kind):
    """A nested record: an instance of exactly this class, because the fields that a subclass adds would not travel."""

    def __init__(self, structure: Structure) -> None:
        self.structure = structure
        self.cls = structure.cls
        name = full_name(structure.cls)
        self.spelling = name if "/" in name else structure.cls.__name__
        self.mutable = structure.mutable  # type: ignore[misc]
        if structure.checked:
            self.exact = structure.cls

    def check(self, value: Any, where: str) -> Any:
        if type(value) is self.cls and self.structure.checked:
            return value
        if type(value) is self.cls or type(value) is frozen_class(self.cls):
            return snapshot(value)
        raise wrong_type(where, f"a {self.spelling}", value)

    def zero(self) -> Any:
        return self.cls()

    def same(self, left: Any, right: Any) -> bool:
        return bool(left == right)


def rows_kind(kind: RecordKind) -> RowsKind | None:
    """The kind for a sequence of such records if all their leaves have one element type, else None."""
    leaves = list(_leaves(kind, ""))
    elements = {element for _, element in leaves}
    element = next(iter(elements), None)
    if len(elements) != 1 or element is None:
        return None
    build, _ = _builder(kind, 0)
    return RowsKind(kind.cls, element, tuple(path for path, _ in leaves), build, _flattener(kind))


def _leaves(kind: RecordKind, prefix: str) -> Iterator[tuple[str, str | None]]:
    if not kind.structure.checked:
        yield prefix, None
        return
    for field in kind.structure.fields:
        path = prefix + field.name
        if isinstance(field.kind, RecordKind):
            yield from _leaves(field.kind, path + ".")
        else:
            yield path, field.kind.spelling if field.kind.spelling in NUMBERS else None


def _builder(kind: RecordKind, start: int) -> tuple[Callable[[Any], Any], int]:
    """A function that makes a row's record from the columns from `start` on, and the column after its last leaf."""
    from aiorts.types.record import setters_of

    steps: list[tuple[Callable[[Any, Any], None], int | Callable[[Any], Any]]] = []
    column = start
    for field, setter in zip(kind.structure.fields, setters_of(kind.cls), strict=True):
        if isinstance(field.kind, RecordKind):
            inner, column = _builder(field.kind, column)
            steps.append((setter, inner))
        else:
            steps.append((setter, column))
            column += 1
    cls, new = kind.cls, object.__new__

    def build(row: Any) -> Any:
        record: Any = new(cls)
        for setter, source in steps:
            setter(record, row[source] if type(source) is int else source(row))  # type: ignore[operator]
        return record

    return build, column


def _flattener(kind: RecordKind) -> Callable[[Any], list[Any]]:
    def flatten(record: Any) -> list[Any]:
        row: list[Any] = []
        _collect(record, kind, row)
        return row

    return flatten


def _collect(record: Any, kind: RecordKind, row: list[Any]) -> None:
    for field in kind.structure.fields:
        value = getattr(record, field.name)
        if isinstance(field.kind, RecordKind):
            _collect(value, field.kind, row)
        else:
            row.append(value)
