"""Values of configuration parameters: texts in OpenRTM, by the type that `__type__` says in a system file."""

from __future__ import annotations

import math
import re
from typing import Any, Final

from aiorts import Component, Param
from aiorts.errors import AiortsError

_WHOLE: Final = re.compile(r"[+-]?\d{1,18}")
_WHOLE_TYPES: Final = frozenset(
    {
        *("int", "short", "long", "long long", "unsigned short", "unsigned long", "unsigned int", "octet"),
        *("int8_t", "int16_t", "int32_t", "int64_t", "uint8_t", "uint16_t", "uint32_t", "uint64_t"),
    }
)
_FLOAT_TYPES: Final = frozenset({"float", "double", "long double"})
_BOOL_TYPES: Final = frozenset({"bool", "boolean"})


def typed(text: str, kind: str) -> Any:
    """The value that a text is, of a type as OpenRTM calls it; the text itself where it is none of that type."""
    word = " ".join(kind.split()).lower()
    bare = text.strip()
    if word in _WHOLE_TYPES and _WHOLE.fullmatch(bare):
        return int(bare)
    if word in _FLOAT_TYPES and len(bare) <= 40:
        try:
            number = float(bare)
        except ValueError:
            return text
        return number if math.isfinite(number) else text
    if word in _BOOL_TYPES and bare.lower() in ("true", "false"):
        return bare.lower() == "true"
    return text


def text_of(value: Any) -> str:
    """A value as OpenRTM writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return ",".join(text_of(one) for one in value)
    return str(value)


def is_said(value: Any, kind: str) -> bool:
    """Whether the text of a value is read as the same value again, of this type."""
    again = typed(text_of(value), kind)
    return type(again) is type(value) and bool(again == value)


def against(value: Any, constraint: str) -> str:
    """What a constraint has against a value, or what cannot be read of it; "" for nothing."""
    found = _refused(value, constraint)
    if found and isinstance(value, str) and (number := typed(value, "double")) != value:
        return _refused(number, constraint) and _refused(typed(value, "int"), constraint)
    return found


def _refused(value: Any, constraint: str) -> str:
    try:
        type("Checked", (Component,), {"value": Param(value, constraint=constraint)})
    except AiortsError as error:
        return " ".join(str(error).split()).removeprefix("Checked.value: ").removeprefix("default ")
    return ""
