"""From a literal to a sample of a type: data alone or fields by name, checked by the type itself; it keeps no state.

A field that is not named holds its default (nothing, where there is none). What does not fit is refused with the path
of the field: "TimedPose2D.data.position.x".
"""

from __future__ import annotations

import base64
import math
from typing import Any, Final

from aiorts.errors import ConfigurationError, DeclarationError, RecordError
from aiorts.types import describe, from_plain, to_plain, zero
from aiorts_flexi.literal import parse_literal

__all__ = ("sample_of",)

_OCTETS: Final = ("bytes", "seq[u8]")
_FLOATS: Final = ("f32", "f64")
_OPEN: Final = ("map", "ndarray")
"""Kinds whose mapping is data, with names of its own."""


def sample_of(cls: type[Any], text: str, where: str = "constant", length: int = 0) -> Any:
    """A sample of `cls` that holds the literal `text`; its `tm` is 0, whoever sends it stamps it.

    Args:
        where: what the text is, for messages. length: items that a sequence must have; 0 is any number.

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
    """The plain form of a record of `cls` with these fields; what is no mapping is left for the type to refuse."""
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
        return _leaf(field.spelling, value)
    if isinstance(value, list):
        return [_merged(field.record, item) for item in value]
    return _merged(field.record, value)


def _leaf(spelling: str, value: Any) -> Any:
    """What `from_plain` reads: octets as base64, no float that JSON cannot write."""
    if spelling in _OCTETS:
        return _octets(value)
    if isinstance(value, bytes):
        raise RecordError(f"expected {spelling}, got octets")
    if isinstance(value, list):
        return [_leaf(spelling.removeprefix("seq[").removesuffix("]"), item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
    return value


def _octets(value: Any) -> Any:
    if isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, bool) or not isinstance(item, int) or not 0 <= item <= 255:
                raise RecordError(f"[{index}]: expected an octet, 0..255, got {item!r}"[:200])
        value = bytes(value)
    return base64.b64encode(value).decode("ascii") if isinstance(value, bytes) else value
