"""Frozen values to what JSON can carry, and the JSON Schema of a class of frozen values; neither reads nor writes.

Schema and text come from the same annotations, so one cannot forget what the other has.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType
from typing import Any, Final, cast
from weakref import WeakKeyDictionary

NUMBER_SCHEMA: Final = {"anyOf": [{"type": "number"}, {"enum": ["NaN", "Infinity", "-Infinity"]}]}
_SIMPLE: Final[Mapping[Any, dict[str, Any]]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: NUMBER_SCHEMA,
    NoneType: {"type": "null"},
    Any: {},
}
_FIELDS: Final[WeakKeyDictionary[Any, tuple[str, ...]]] = WeakKeyDictionary()
"""Names of the fields of each dataclass met so far."""


def plain(value: object) -> Any:
    """`value` as dicts, lists, text, numbers, booleans and None; what is none of these becomes its `str`."""
    kind = value.__class__
    if kind is str or kind is int or value is None or kind is bool:
        return value
    if kind is float:
        number = cast("float", value)
        return number if math.isfinite(number) else _non_finite(number)
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list | set | frozenset):
        return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(getattr(value, name)) for name in _names(kind)}
    listed = getattr(value, "tolist", None)  # a numpy array or number
    if listed is not None:
        return plain(listed())
    for base in (str, bool, int, float):
        if isinstance(value, base):
            return plain(base(value))
    return str(value)


def schema_of(kind: type[Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a dataclass's `plain` form; those of the classes it mentions go into `definitions`."""
    if kind.__name__ not in definitions:
        definitions[kind.__name__] = {}  # it may mention itself
        hints = typing.get_type_hints(kind)
        names = _names(kind)
        definitions[kind.__name__] = {
            "type": "object",
            "description": (kind.__doc__ or "").split("\n\n")[0].strip(),
            "properties": {name: _schema(hints[name], definitions) for name in names},
            "required": list(names),
            "additionalProperties": False,
        }
    return {"$ref": f"#/$defs/{kind.__name__}"}


def _schema(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        return {"anyOf": [_schema(argument, definitions) for argument in arguments]}
    if origin is tuple:
        return {"type": "array", "items": _schema(arguments[0], definitions)}
    if origin is not None:
        return {"type": "object", "additionalProperties": _schema(arguments[1], definitions)}
    if issubclass(hint, Enum):
        return {"enum": [plain(member) for member in hint]}
    return schema_of(hint, definitions)


def _names(kind: Any) -> tuple[str, ...]:
    names = _FIELDS.get(kind)
    if names is None:
        names = _FIELDS[kind] = tuple(one.name for one in fields(kind))
    return names


def _non_finite(number: float) -> str:
    if number != number:
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"
