"""Field paths such as `pose.position.x` and `ranges[3]`: how generic tools read any record without running code."""

from __future__ import annotations

import re
from typing import Any

from aiorts.errors import InvalidNameError, RecordError
from aiorts.spelling import suggestion
from aiorts.types.kinds import Kind, OptionalKind
from aiorts.types.nested import RecordKind
from aiorts.types.rows import FixedTupleKind, MapKind, RowsKind, TupleKind
from aiorts.types.samples import PLAIN_TYPES, original
from aiorts.types.structure import Structure, describe

_STEP = re.compile(r"(?:\.?(?P<name>[^\W\d]\w*)|\[(?P<index>-?\d{1,9})\]|\[(?P<quote>['\"])(?P<key>.*?)(?P=quote)\])")

_STAMPS = {"sec": "u32", "nsec": "u32", "tm": "stamp"}
"""Attributes of records with a time stamp besides their fields; `tm` is one where a header holds the stamp."""

Step = str | int


def parse_path(path: str) -> tuple[tuple[bool, Step], ...]:
    """The steps of a path.

    Each step is a pair: whether it is a field name, and the name, index or map key. InvalidNameError names the mistake.
    """
    steps: list[tuple[bool, Step]] = []
    position = 0
    while position < len(path):
        match = _STEP.match(path, position)
        starts_wrong = match is not None and match["name"] is not None and (path[position] == ".") != bool(steps)
        if match is None or starts_wrong:
            raise InvalidNameError(
                f"field path {path[:120]!r}, character {position + 1}: expected a field name, or an index such as [3]; "
                "write for example pose.position.x or ranges[3]"
            )
        if match["name"] is not None:
            steps.append((True, match["name"]))
        else:
            steps.append((False, int(match["index"]) if match["index"] is not None else match["key"]))
        position = match.end()
    return tuple(steps)


def read_path(record: Any, path: str) -> Any:
    """The value at a path such as `pose.position.x`, `ranges[3]`, `actuators[0].position` or `data['speed']`.

    The empty path is the record itself. RecordError names the part of the path that exists;
    InvalidNameError: the text is no path.
    """
    value = record
    reached = type(record).__qualname__
    for is_name, step in parse_path(path):
        value = _field(value, str(step), reached) if is_name else _item(value, step, reached)
        reached += f".{step}" if is_name else f"[{step!r}]"
    return value


def _field(value: Any, name: str, reached: str) -> Any:
    structure = _structure(type(value))
    if structure is None:
        raise RecordError(f"{reached} is {_article(value)} and has no field {name!r}")
    if structure.field(name) is None and not (name in _STAMPS and structure.has_tm):
        raise _no_field(structure, name, reached)
    return getattr(value, name)


def _item(value: Any, index: Step, reached: str) -> Any:
    if isinstance(index, str):
        if not hasattr(value, "keys"):
            raise RecordError(f"{reached} is {_article(value)}, not a map: it has no entry {index!r}")
        if index not in value:
            raise RecordError(
                f"{reached} has no entry {index!r}; it has {', '.join(map(repr, list(value)[:20])) or 'none'}"
            )
        return value[index]
    if not hasattr(value, "__len__") or hasattr(value, "keys") or getattr(value, "shape", None) == ():
        raise RecordError(f"{reached} is {_article(value)} and has no items")
    if not -len(value) <= index < len(value):
        raise RecordError(f"{reached}[{index}]: expected an index below {len(value)}, got {index}")
    item = value[index]
    return item.item() if hasattr(item, "dtype") and item.shape == () else item


def path_type(cls: type, path: str) -> Kind | type:
    """The type at `path` in records of `cls`: a record type for nested records, a kind for all else.

    RecordError names the step that does not exist. A path may lead through optional fields, and indices may
    be of any size: only a sample shows whether they exist.
    """
    current: Any = cls
    reached = cls.__qualname__
    for is_name, step in parse_path(path):
        if isinstance(current, OptionalKind):
            current = current.inner.cls if isinstance(current.inner, RecordKind) else current.inner
        current = _type_of_field(current, str(step), reached) if is_name else _type_of_item(current, reached)
        reached += f".{step}" if is_name else f"[{step!r}]"
        if isinstance(current, RecordKind):
            current = current.cls
    found: Kind | type = current
    return found


def _type_of_field(current: Any, name: str, reached: str) -> Kind:
    from aiorts.types.kinds import SCALARS

    structure = _structure(current) if isinstance(current, type) else None
    if structure is None:
        raise RecordError(f"{reached} is {current!r} and has no field {name!r}")
    field = structure.field(name)
    if field is None and name in _STAMPS and structure.has_tm:
        return SCALARS[_STAMPS[name]]
    if field is None:
        raise _no_field(structure, name, reached)
    return field.kind


def _type_of_item(current: Any, reached: str) -> Kind | type:
    from aiorts.types.kinds import SCALARS

    if isinstance(current, RowsKind):
        return current.cls
    if isinstance(current, TupleKind):
        return current.item
    if isinstance(current, FixedTupleKind) and len(set(map(repr, current.items))) == 1:
        return current.items[0]
    if isinstance(current, Kind) and current.spelling.startswith("seq[") and current.element:
        return SCALARS[current.element]
    if isinstance(current, MapKind) or (isinstance(current, Kind) and current.spelling.startswith("ndarray")):
        return current
    raise RecordError(f"{reached} is {current!r} and has no items")


def _structure(cls: type) -> Structure | None:
    cls = original(cls)
    return None if cls in PLAIN_TYPES or not hasattr(cls, "__dataclass_fields__") else describe(cls)


def _no_field(structure: Structure, name: str, reached: str) -> RecordError:
    names = [field.name for field in structure.fields]
    hint = suggestion(name, names, f"its fields are {', '.join(names)}", shown=str)
    return RecordError(f"{reached} has no field {name!r}; {hint}")


def _article(value: Any) -> str:
    return f"a value of type {type(value).__name__}"
