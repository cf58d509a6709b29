"""Values of configuration parameters: texts in OpenRTM, values of the type in `__type__` in a system file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

from aiorts import Component, Param
from aiorts.errors import AiortsError, ConfigurationError

_WHOLE_TYPES: Final = frozenset(
    {
        *("int", "short", "long", "long long", "unsigned short", "unsigned long", "unsigned int", "octet"),
        *("int8_t", "int16_t", "int32_t", "int64_t", "uint8_t", "uint16_t", "uint32_t", "uint64_t"),
    }
)
_KINDS: Final[Mapping[str, type[bool] | type[int] | type[float]]] = {
    **dict.fromkeys(_WHOLE_TYPES, int),
    **dict.fromkeys(("float", "double", "long double"), float),
    **dict.fromkeys(("bool", "boolean"), bool),
}
"""The Python class of values, by OpenRTM's name of a type; values of other types are texts."""
_LONGEST: Final = 100


def typed(text: str, kind: str) -> Any:
    """The value of a text, by OpenRTM's name of its type; the text itself where it is no value of that type.

    The text is read as a parameter of that type reads a text of `--set`.
    """
    here = kind_of_word(kind)
    if here is None or len(text) > _LONGEST:
        return text
    try:
        value = _parameter_of(here.__name__).params.check({"value": text})["value"]
    except ConfigurationError:
        return text
    return value if math.isfinite(value) else text


def kind_of_word(kind: str) -> type[bool] | type[int] | type[float] | None:
    """The class of the values of a type, by OpenRTM's name of it; None for texts."""
    return _KINDS.get(" ".join(kind.split()).lower())


@cache
def _parameter_of(kind: str) -> Component:
    """A component with one parameter of this type: "bool", "int" or "float"."""
    zero = {"bool": False, "int": 0, "float": 0.0}[kind]
    made: Component = type("Read", (Component,), {"value": Param(zero)})()
    return made


def text_of(value: Any) -> str:
    """A value as OpenRTM writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return ",".join(text_of(one) for one in value)
    return str(value)


def is_said(value: Any, kind: str) -> bool:
    """Whether the text of a value is read as the same value again, with this type."""
    again = typed(text_of(value), kind)
    return type(again) is type(value) and bool(again == value)


def against(value: Any, constraint: str) -> str:
    """The reason why a value breaks a constraint, or why the constraint cannot be read; "" for none."""
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
