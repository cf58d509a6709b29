"""Turns frozen values into forms that JSON can carry, and makes their JSON Schemas; it neither reads nor writes.

Schema and text come from the same annotations, so neither can lack a field that the other has.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from types import MappingProxyType, NoneType
from typing import Any, Final, cast
from weakref import WeakKeyDictionary

from aiorts.model.annotations import ByAnnotation, fields_of_row

Schema = dict[str, Any]

NUMBER_SCHEMA: Final = {"anyOf": [{"type": "number"}, {"enum": ["NaN", "Infinity", "-Infinity"]}]}
_SIMPLE: Final[Mapping[Any, Schema]] = MappingProxyType(
    {
        str: {"type": "string"},
        bool: {"type": "boolean"},
        int: {"type": "integer"},
        float: NUMBER_SCHEMA,
        bytes: {"type": "string", "contentEncoding": "base64"},
        NoneType: {"type": "null"},
        Any: {},
        object: {},
    }
)
_FIELDS: Final[WeakKeyDictionary[Any, tuple[str, ...]]] = WeakKeyDictionary()
"""Names of the fields of each dataclass met so far."""


_EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})


def empty() -> Mapping[str, Any]:
    """An empty read-only mapping: the default of a field."""
    return _EMPTY


def plain(value: object) -> Any:
    """`value` as dicts, lists, text, numbers, booleans and None; any other value becomes its `str`."""
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


class Schemas:
    """Makes schemas of annotations, and gathers those of the dataclasses that they mention.

    Args:
        place: the place of the gathered schemas in the document, with which references begin.
        defaults: whether fields with a default may be left out.
        simple: schemas of simple types that differ from the usual.

    Attributes:
        definitions: the schemas of dataclasses by name; if two have the same name, the second has its module's
            name in front.
    """

    def __init__(
        self, place: str = "#/$defs/", *, defaults: bool = False, simple: Mapping[Any, Schema] = MappingProxyType({})
    ) -> None:
        self._forms = SchemaForms(place, defaults=defaults, simple=simple)
        self.definitions = self._forms.definitions

    def of(self, hint: Any) -> Schema:
        """The schema of an annotation.

        Raises:
            TypeError: values of the annotation have no known form in JSON.
        """
        return self._forms.of(hint)


class SchemaForms(ByAnnotation[Schema]):
    """The schema of each form of an annotation; the arguments are those of `Schemas`."""

    def __init__(
        self, place: str = "#/$defs/", *, defaults: bool = False, simple: Mapping[Any, Schema] = MappingProxyType({})
    ) -> None:
        super().__init__({**_SIMPLE, **simple})
        self.definitions: dict[str, Schema] = {}
        self._place = place
        self._defaults = defaults
        self._names: dict[Any, str] = {}

    def union(self, hint: Any, arms: dict[Any, Schema]) -> Schema:
        return {"anyOf": list(arms.values())}

    def words(self, hint: Any, words: tuple[Any, ...]) -> Schema:
        return {"enum": list(words)}

    def fixed(self, hint: Any, items: list[Schema]) -> Schema:
        if row := fields_of_row(hint):
            items = [{**item, "title": name} for item, name in zip(items, row, strict=True)]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}

    def many(self, hint: Any, kind: Any, item: Schema) -> Schema:
        return {"type": "array", "items": item}

    def mapping(self, hint: Any, kind: Any, key: Any, item: Schema) -> Schema:
        return {"type": "object", "additionalProperties": item}

    def members(self, kind: type[Enum]) -> Schema:
        return {"enum": [plain(member) for member in kind]}

    def record(self, kind: type) -> Schema:
        return {"$ref": f"{self._place}{self._named(kind)}"}

    def other(self, hint: Any) -> Schema:
        raise TypeError(f"{hint!r}: has no JSON Schema")

    def _named(self, kind: type[Any]) -> str:
        if kind not in self._names:
            name = kind.__name__.lstrip("_")
            if name in self.definitions:
                name = f"{kind.__module__.rpartition('.')[2]}.{name}"
            self._names[kind] = name
            self.definitions[name] = {}  # the class may mention itself
            self.definitions[name] = self._record(kind)
        return self._names[kind]

    def _record(self, kind: type[Any]) -> Schema:
        hints = typing.get_type_hints(kind)
        every = {one.name: one for one in fields(kind)}
        return {
            "type": "object",
            "description": (kind.__doc__ or "").split("\n\n")[0].strip(),
            "properties": {name: self._field(hints[name], every[name]) for name in _names(kind)},
            "required": [name for name in _names(kind) if not self._defaults or not has_default(every[name])],
            "additionalProperties": False,
        }

    def _field(self, hint: Any, field: Field[Any]) -> Schema:
        schema = self.of(hint)
        if not self._defaults or field.default is MISSING or "$ref" in schema:
            return schema
        return {**schema, "default": plain(field.default)}


def has_default(field: Field[Any]) -> bool:
    """Whether a field may be left out."""
    return field.default is not MISSING or field.default_factory is not MISSING


def _names(kind: Any) -> tuple[str, ...]:
    names = _FIELDS.get(kind)
    if names is None:
        names = _FIELDS[kind] = tuple(one.name for one in fields(kind))
    return names


def _non_finite(number: float) -> str:
    if number != number:
        return "NaN"
    return "Infinity" if number > 0 else "-Infinity"
