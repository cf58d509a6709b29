"""Records to and from plain data that JSON can carry, without losing a bit of value.

Non-finite floats are "NaN", "Infinity", "-Infinity"; bytes base64 text; enumerations their member's name; `tm` and a
datetime an integer (nanoseconds); arrays lists; absent values null. An array of any shape and a map's values carry
their type, because the record does not declare it.
"""

from __future__ import annotations

import base64
import binascii
import math
import re
from typing import TYPE_CHECKING, Any, TypeVar, cast

from aiorts.errors import RecordError
from aiorts.types.arrays import DTYPES, ArrayKind, NDArrayKind, element_name
from aiorts.types.kinds import (
    SCALARS,
    BytesKind,
    DateTimeKind,
    EnumKind,
    FloatKind,
    Kind,
    OptionalKind,
    datetime_ns,
    shown,
    wrong_type,
    wrong_value,
)
from aiorts.types.nested import RecordKind
from aiorts.types.rows import MAP_LEVELS, FixedTupleKind, MapKind, RowsKind, TupleKind, as_dict
from aiorts.types.samples import PLAIN_TYPES, original
from aiorts.types.structure import describe, kind_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from enum import Enum

T = TypeVar("T")
Plain = Any

_NON_FINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def to_plain(record: Any) -> Plain:
    """A record (or a bool, int, float, str, bytes) as dict, list and scalars that strict JSON accepts."""
    cls = type(record)
    if cls in PLAIN_TYPES:
        return _put(kind_of(cls, cls.__name__), record)
    return {field.name: _put(field.kind, getattr(record, field.name)) for field in describe(original(cls)).fields}


def from_plain(cls: type[T], plain: Plain, *, defaults: bool = False) -> T:
    """The record that `to_plain` wrote. RecordError names the field that is missing, unknown or wrong.

    Args:
        defaults: whether fields that have a default may be missing, and a datetime may be text (ISO 8601, with a zone),
            as in the lines of filters; fields that are None by default may always be missing.
    """
    if cls in PLAIN_TYPES:
        return cast("T", _take(kind_of(cls, cls.__name__), plain, cls.__name__, defaults))
    return cast("T", _take_record(cls, plain, cls.__qualname__, defaults))


def _take_record(cls: type, plain: Plain, where: str, defaults: bool) -> Any:
    structure = describe(cls)
    names = [field.name for field in structure.fields]
    if not isinstance(plain, dict):
        raise wrong_type(where, f"a mapping with {', '.join(names)}", plain)
    unknown = [str(name) for name in plain if name not in names]
    missing = [
        one.name
        for one in structure.fields
        if one.name not in plain and one.default is not None and not (defaults and one.has_default)
    ]
    if unknown or missing:
        parts = (
            f"unknown field {', '.join(unknown)[:200]}" if unknown else "",
            f"missing field {', '.join(missing)}" if missing else "",
        )
        raise RecordError(f"{where}: {'; '.join(filter(None, parts))}; expected {', '.join(names)}")
    given = [(field, plain[field.name]) for field in structure.fields if field.name in plain]
    values = {field.name: _take(field.kind, value, f"{where}.{field.name}", defaults) for field, value in given}
    return build(cls, values)


def build(cls: type, values: dict[str, Any]) -> Any:
    """Make an instance of a record type or dataclass; a mutable dataclass gets lists where it declares lists."""
    restores, late = _making.get(cls) or _know_making(cls)
    for name, restore in restores:
        if values.get(name) is not None:
            values[name] = restore(values[name])
    if not late:
        return cls(**values)
    instance = cls(**{name: value for name, value in values.items() if name not in late})
    for name in late:
        if name in values:
            object.__setattr__(instance, name, values[name])
    return instance


def is_built_plainly(cls: type) -> bool:
    """Whether `build` only calls the class."""
    return not any(_making.get(cls) or _know_making(cls))


_making: dict[type, tuple[list[tuple[str, Callable[[Any], Any]]], tuple[str, ...]]] = {}
"""Data for `build` by class: functions that restore fields, and the fields that its constructor does not take."""


def _know_making(cls: type) -> tuple[list[tuple[str, Callable[[Any], Any]]], tuple[str, ...]]:
    import dataclasses

    structure = describe(cls)
    restores = (
        []
        if structure.checked
        else [(one.name, restore) for one in structure.fields if (restore := _restore(one.kind))]
    )
    _making[cls] = restores, tuple(field.name for field in dataclasses.fields(cls) if not field.init)
    return _making[cls]


def _restore(kind: Kind) -> Callable[[Any], Any] | None:
    """The function that restores a field of a mutable dataclass: `list` for a declared list, `as_dict` for a map."""
    kind = kind.inner if isinstance(kind, OptionalKind) else kind
    if isinstance(kind, MapKind):
        return as_dict
    return list if isinstance(kind, TupleKind) and kind.restore is list else None


def _put(kind: Kind, value: Any) -> Plain:
    for base, put in _PUT:
        if isinstance(kind, base):
            return put(kind, value)
    return value


def _take(kind: Kind, plain: Plain, where: str, defaults: bool) -> Any:
    for base, take in _TAKE:
        if isinstance(kind, base):
            return take(kind, plain, where)
    for base, take_parts in _TAKE_PARTS:
        if isinstance(kind, base):
            return take_parts(kind, plain, where, defaults)
    return kind.check(plain, where)


def _put_float(kind: Kind, value: float) -> Plain:
    if math.isfinite(value):
        return value
    return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"


def _take_float(kind: Kind, plain: Plain, where: str) -> Any:
    if isinstance(plain, str):
        if plain not in _NON_FINITE:
            raise wrong_value(where, 'a number, "NaN", "Infinity" or "-Infinity"', plain)
        return _NON_FINITE[plain]
    return kind.check(plain, where)


def _take_datetime(kind: Kind, plain: Plain, where: str, defaults: bool) -> Any:
    if not defaults or not isinstance(plain, str):
        return kind.check(plain, where)
    from datetime import datetime

    try:
        moment = datetime.fromisoformat(plain)
    except ValueError:
        raise wrong_value(where, "a datetime such as 2026-03-01T12:00:00Z, or its nanoseconds", plain) from None
    if moment.utcoffset() is None:
        raise RecordError(f"{where}: {shown(plain)} has no time zone; add Z for UTC, or an offset such as +09:00")
    if re.search(r"[.,]\d{6}0*[1-9]", plain):
        raise wrong_value(where, "whole microseconds", plain)
    return kind.check(moment, where)


def _put_bytes(kind: Kind, value: bytes) -> Plain:
    return base64.b64encode(value).decode("ascii")


def _take_bytes(kind: Kind, plain: Plain, where: str) -> bytes:
    if not isinstance(plain, str):
        raise wrong_type(where, "base64 text", plain)
    try:
        return base64.b64decode(plain.encode(), validate=True)
    except (binascii.Error, UnicodeEncodeError) as error:
        raise RecordError(f"{where}: expected base64 text, got {shown(plain)}: {error}") from None


def _put_enum(kind: Kind, value: Enum) -> Plain:
    return value.name


def _take_enum(kind: Any, plain: Plain, where: str) -> Any:
    if isinstance(plain, str) and plain in kind.enumeration.__members__:
        return kind.enumeration[plain]
    raise wrong_value(where, kind.expected, plain)


def _put_array(kind: Kind, value: Any) -> Plain:
    if kind.element == "u8" and not isinstance(kind, NDArrayKind):
        return base64.b64encode(value.tobytes()).decode("ascii")
    items = value.tolist()
    return [_put_float(kind, item) for item in items] if value.dtype.kind == "f" else items


def _take_array(kind: Kind, plain: Plain, where: str) -> Any:
    if kind.element == "u8":
        return kind.check(_take_bytes(kind, plain, where), where)
    if not isinstance(plain, list):
        raise wrong_type(where, "a list", plain)
    if isinstance(SCALARS.get(kind.element or ""), FloatKind):
        plain = [
            _take_float(SCALARS[kind.element or ""], item, f"{where}[{index}]") for index, item in enumerate(plain)
        ]
    return kind.check(plain, where)


def _put_ndarray(kind: Kind, value: Any) -> Plain:
    """Type, shape and bytes (little-endian), because nested lists lose the type, the shape and NaN payloads."""
    little = value.astype(value.dtype.newbyteorder("<"), copy=False)
    return {
        "dtype": element_name(value.dtype),
        "shape": list(value.shape),
        "data": base64.b64encode(little.tobytes()).decode("ascii"),
    }


def _take_ndarray(kind: Kind, plain: Plain, where: str) -> Any:
    if not isinstance(plain, dict) or set(plain) != {"dtype", "shape", "data"}:
        raise wrong_type(where, "a mapping with dtype, shape, data", plain)
    return kind.check(
        array_of(plain["dtype"], plain["shape"], _take_bytes(kind, plain["data"], f"{where}.data"), where), where
    )


def array_of(element: Any, shape: Any, data: bytes, where: str) -> Any:
    """An array that shares the memory of `data`.

    RecordError, before anything is allocated, if type, shape and length disagree.
    """
    import numpy as np

    from aiorts.types.arrays import MAX_DIMENSIONS

    code = DTYPES.get(element) if isinstance(element, str) else None
    if code is None:
        raise RecordError(f"{where}: expected element type {', '.join(DTYPES)}, got {shown(element)}")
    if not isinstance(shape, (list, tuple)) or len(shape) > MAX_DIMENSIONS:
        raise RecordError(f"{where}: expected a shape of at most {MAX_DIMENSIONS} lengths, got {shown(shape)}")
    if not all(type(length) is int and 0 <= length < 2**63 for length in shape):
        raise RecordError(f"{where}: expected a shape of lengths that are not negative, got {list(shape)}")
    expected = math.prod(shape) * int(code[1:])
    if expected != len(data) or (not expected and any(length > 2**32 for length in shape)):
        raise RecordError(f"{where}: expected {expected} bytes for {element} of shape {list(shape)}, got {len(data)}")
    if code == "b1" and data.translate(None, b"\x00\x01"):
        raise RecordError(f"{where}: expected truth values as bytes 0 and 1, got others")
    if not data:
        return np.empty(shape, dtype=code)
    return np.frombuffer(data, dtype=f"<{code}").reshape(shape)


def _put_rows(kind: Any, value: Any) -> Plain:
    return [to_plain(record) for record in value]


def _take_rows(kind: Any, plain: Plain, where: str, defaults: bool) -> Any:
    if not isinstance(plain, list):
        raise wrong_type(where, "a list", plain)
    items = [_take_record(kind.cls, item, f"{where}[{index}]", defaults) for index, item in enumerate(plain)]
    return kind.check(items, where)


def _put_tuple(kind: Any, value: Any) -> Plain:
    return [_put(kind.item, item) for item in value]


def _take_tuple(kind: Any, plain: Plain, where: str, defaults: bool) -> Any:
    if not isinstance(plain, list):
        raise wrong_type(where, "a list", plain)
    return tuple(_take(kind.item, item, f"{where}[{index}]", defaults) for index, item in enumerate(plain))


def _put_fixed(kind: Any, value: Any) -> Plain:
    return [_put(item_kind, item) for item_kind, item in zip(kind.items, value, strict=True)]


def _take_fixed(kind: Any, plain: Plain, where: str, defaults: bool) -> Any:
    if not isinstance(plain, list) or len(plain) != len(kind.items):
        raise wrong_type(where, f"a list of {len(kind.items)}", plain)
    pairs = zip(kind.items, plain, strict=True)
    return tuple(_take(item_kind, item, f"{where}[{index}]", defaults) for index, (item_kind, item) in enumerate(pairs))


def _put_map(kind: Kind, value: Any) -> Plain:
    return {name: _put_entry(entry) for name, entry in value.items()}


def _put_entry(entry: Any) -> Plain:
    """Scalars that JSON tells apart stay as they are; all other values name their type."""
    if hasattr(entry, "keys"):
        return {"map": {name: _put_entry(inner) for name, inner in entry.items()}}
    if type(entry) is bytes:
        return {"bytes": _put_bytes(SCALARS["bytes"], entry)}
    if type(entry) is float and not math.isfinite(entry):
        return {"float": _put_float(SCALARS["f64"], entry)}
    return _put_ndarray(NDArrayKind(), entry) if hasattr(entry, "dtype") else entry


def _take_map(kind: Kind, plain: Plain, where: str) -> Any:
    if not isinstance(plain, dict):
        raise wrong_type(where, "a mapping", plain)
    return kind.check(_take_entries(plain, where, MAP_LEVELS), where)


def _take_entries(plain: Plain, where: str, levels: int) -> Any:
    return {name: _take_entry(entry, f"{where}[{shown(name)}]", levels) for name, entry in plain.items()}


def _take_entry(entry: Plain, where: str, levels: int) -> Any:
    if not isinstance(entry, dict):
        return entry
    if set(entry) == {"map"} and isinstance(entry["map"], dict):
        if levels == 1:
            raise RecordError(f"{where}: expected at most {MAP_LEVELS} maps within each other, got more")
        return _take_entries(entry["map"], where, levels - 1)
    if set(entry) == {"bytes"}:
        return _take_bytes(SCALARS["bytes"], entry["bytes"], where)
    if set(entry) == {"float"}:
        return _take_float(SCALARS["f64"], entry["float"], where)
    return _take_ndarray(NDArrayKind(), entry, where)


def _take_nested(kind: Any, plain: Plain, where: str, defaults: bool) -> Any:
    return _take_record(kind.cls, plain, where, defaults)


def _put_optional(kind: Any, value: Any) -> Plain:
    return None if value is None else _put(kind.inner, value)


def _take_optional(kind: Any, plain: Plain, where: str, defaults: bool) -> Any:
    return None if plain is None else _take(kind.inner, plain, where, defaults)


_PUT: tuple[tuple[type, Callable[[Any, Any], Plain]], ...] = (
    (RecordKind, lambda kind, value: to_plain(value)),
    (FloatKind, _put_float),
    (BytesKind, _put_bytes),
    (EnumKind, _put_enum),
    (NDArrayKind, _put_ndarray),
    (ArrayKind, _put_array),
    (RowsKind, _put_rows),
    (TupleKind, _put_tuple),
    (FixedTupleKind, _put_fixed),
    (MapKind, _put_map),
    (OptionalKind, _put_optional),
    (DateTimeKind, lambda kind, value: datetime_ns(value)),
)
_TAKE: tuple[tuple[type, Callable[[Any, Plain, str], Any]], ...] = (
    (FloatKind, _take_float),
    (BytesKind, _take_bytes),
    (EnumKind, _take_enum),
    (NDArrayKind, _take_ndarray),
    (ArrayKind, _take_array),
    (MapKind, _take_map),
)
_TAKE_PARTS: tuple[tuple[type, Callable[[Any, Plain, str, bool], Any]], ...] = (
    (RecordKind, _take_nested),
    (RowsKind, _take_rows),
    (TupleKind, _take_tuple),
    (FixedTupleKind, _take_fixed),
    (OptionalKind, _take_optional),
    (DateTimeKind, _take_datetime),
)
"""The functions that read kinds which may hold records, or which have several forms in a line."""
