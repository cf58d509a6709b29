"""Makes a sample of a type from a literal: its data alone, or fields by name, checked by the type itself.

A field without a value has its default, else it is zero or empty. A value that does not fit is refused with
the path of its field: "TimedPose2D.data.position.x".
"""

from __future__ import annotations

import base64
import math
from typing import Any, Final

from aiorts.errors import ConfigurationError, DeclarationError, RecordError
from aiorts.types import describe, from_plain, to_plain, zero
from aiorts_flexi.common.literal import parse_literal

_BYTES: Final = ("bytes", "seq[u8]")
_OPEN: Final = ("map", "ndarray")
"""Kinds whose mapping is data with keys of its own."""


def sample_of(cls: type[Any], text: str, where: str = "constant", length: int = 0) -> Any:
    """Make a sample of `cls` from the literal `text`; its `tm` is 0, and the sender stamps it.

    Args:
        where: the name of the text in messages. length: items that a sequence must have; 0 is any number.

    Raises:
        TypedTextError: the text is no literal.
        ConfigurationError: the literal does not fit the type; names the field.
    """
    value = parse_literal(text, where)
    try:
        if not hasattr(cls, "__dataclass_fields__"):
            return from_plain(cls, _leaf(cls.__name__, value))
        return _record(cls, value, length)
    except (RecordError, DeclarationError) as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _record(cls: type[Any], value: Any, length: int) -> Any:
    structure = describe(cls)
    names = [field.name for field in structure.fields if not (structure.has_tm and field.name == "tm")]
    if names == ["data"]:
        data = next(field for field in structure.fields if field.name == "data")
        spelled_out = isinstance(value, dict) and list(value) == ["data"]
        if spelled_out and data.spelling not in _OPEN and not _has_data(data.record):
            value = value["data"]
        if length and isinstance(value, list | str | bytes) and len(value) != length:
            raise RecordError(f"{cls.__name__}.data: expected {length} items, got {len(value)}")
        value = {"data": value}
    elif structure.has_tm and isinstance(value, dict) and "tm" in value:
        raise RecordError(f"{cls.__name__}.tm: is when the sample is sent, by the kernel's clock; leave it out")
    return from_plain(cls, _merged(cls, value))


def _has_data(cls: type[Any] | None) -> bool:
    return cls is not None and describe(cls).field("data") is not None


def _merged(cls: type[Any], value: Any) -> Any:
    """The plain form of a record of `cls` with these fields; `cls` itself refuses a value that is no mapping."""
    if not isinstance(value, dict):
        return value
    plain = to_plain(_default(cls))
    for field in describe(cls).fields:
        if field.name in value:
            plain[field.name] = _field(field, value.pop(field.name))
    return {**plain, **value}  # unknown names stay, and are refused by name


def _default(cls: type[Any]) -> Any:
    try:
        return cls()
    except TypeError:
        return zero(cls)


def _field(field: Any, value: Any) -> Any:
    if field.record is None:
        return None if value is None else _leaf(field.kind.base, value)
    if isinstance(value, list):
        return [_merged(field.record, item) for item in value]
    return _merged(field.record, value)


def _leaf(spelling: str, value: Any) -> Any:
    """The value in the form that `from_plain` reads: bytes as base64, no float that JSON cannot write."""
    if spelling in _BYTES:
        return _base64(value)
    if isinstance(value, bytes):
        raise RecordError(f"expected {spelling}, got bytes")
    if isinstance(value, list):
        return [_leaf(spelling.removeprefix("seq[").removesuffix("]"), item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
    return value


def _base64(value: Any) -> Any:
    if isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, bool) or not isinstance(item, int) or not 0 <= item <= 255:
                raise RecordError(f"[{index}]: expected a byte, 0..255, got {item!r}"[:200])
        value = bytes(value)
    return base64.b64encode(value).decode("ascii") if isinstance(value, bytes) else value
