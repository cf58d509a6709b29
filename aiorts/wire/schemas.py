"""Describes the bytes of records to readers without the type, by a JSON Schema of each type.

A frame of the msgpack codec is explained with `x-array` for its arrays; in JSON a record is an object that Foxglove
shows as it is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from typing import Any, Final

from aiorts.types import describe, to_plain, wire_name
from aiorts.types.samples import PLAIN_TYPES
from aiorts.wire.arrays import ELEMENTS
from aiorts.wire.codec import FORMAT

# Part of the format to the letter: a file whose schema differs is read as one of another type.
_LAYOUT: Final = {
    "what": "a binary with x-array holds an array of numbers",
    "head": "octet 0: code of the element type; octet 1: dimensions; octets 2-7: zero; then one u64 for each length",
    "body": "the elements in C order",
    "byte order": "little-endian",
    "codes": dict(enumerate(ELEMENTS, start=1)),
}
_UNIT: Final = "x-unit"
"""The key of the unit of a field's values: no part of their layout."""
_DRAFT: Final = "https://json-schema.org/draft/2020-12/schema"


def schema_text(cls: type, *, as_json: bool = False) -> str:
    """The JSON Schema of a type's frames, or of its messages in JSON; the same text for the same type."""
    name = wire_name(cls)
    fields = _type_schema(cls, as_json)
    document: dict[str, Any] = {"$schema": _DRAFT, "title": name}
    if as_json:
        if cls in PLAIN_TYPES:
            fields = {"type": "object", "properties": {"value": fields}, "required": ["value"]}
        document |= {"description": 'Numbers that are not finite are "NaN", "Infinity", "-Infinity".', **fields}
    else:
        document |= {
            "description": "MessagePack: a list of the version of this form, the name of the type, and the value.",
            "type": "array",
            "prefixItems": [{"const": FORMAT}, {"const": name}, fields],
            "items": False,
            "x-array-layout": _LAYOUT,
        }
    return json.dumps(document, separators=(",", ":"))


def _type_schema(cls: type, as_json: bool) -> dict[str, Any]:
    if cls in PLAIN_TYPES:
        return _SCALARS[cls.__name__](as_json)
    fields = describe(cls).fields
    kinds: dict[str, Any] = {field.name: field.kind for field in fields}
    units = {field.name: {_UNIT: field.unit} for field in fields if field.unit}
    # Foxglove refuses a schema with a field that may be null, which has no one type: such a field is left out.
    left_out = [one for one in fields if as_json and one.default is None and hasattr(one.kind, "inner")]
    absent = {one.name: kinds[one.name].inner for one in left_out}
    return {
        "type": "object",
        "properties": {
            name: _kind_schema(absent.get(name, kind), as_json) | units.get(name, {}) for name, kind in kinds.items()
        },
        "required": [name for name in kinds if name not in absent],
        "additionalProperties": False,
    }


def without_units(schema: Any) -> Any:
    """The document without the units of its fields: records that differ in units alone have one type."""
    if isinstance(schema, dict):
        return {key: without_units(one) for key, one in schema.items() if key != _UNIT}
    return [without_units(one) for one in schema] if isinstance(schema, list) else schema


def units_in(schema: Any) -> dict[str, str]:
    """The units in a schema's document, by the paths of the fields without indices; the document may be hostile."""
    found: dict[str, str] = {}

    def walk(part: Any, path: str, outer: str) -> None:
        if not isinstance(part, dict):
            return
        unit = part[_UNIT] if isinstance(part.get(_UNIT), str) else outer
        either, items = part.get("anyOf"), part.get("items")
        if isinstance(either, list) and either:
            walk(either[0], path, unit)
        elif isinstance(items, dict):
            walk(items, path, unit)
        elif isinstance(properties := part.get("properties"), dict):
            for name, one in properties.items():
                walk(one, f"{path}.{name}" if path else str(name), unit)
        elif unit:
            found[path] = unit

    if isinstance(schema, dict) and isinstance(frame := schema.get("prefixItems"), list) and len(frame) == 3:
        schema = frame[2]
    walk(schema, "", "")
    return found


def json_message(record: Any) -> Any:
    """The message in JSON of a record: an object, without the fields that are left out."""
    cls, plain = type(record), to_plain(record)
    if not hasattr(cls, "__dataclass_fields__"):
        return {"value": plain}
    if cls not in _shortening:
        schema = _type_schema(cls, True)
        _shortening[cls] = schema if _may_leave_out(schema) else None
    return plain if _shortening[cls] is None else _without_absent(plain, _shortening[cls])


_shortening: dict[type, dict[str, Any] | None] = {}
"""The schema of each type with fields that are left out where they are None; None for all others."""


def _may_leave_out(schema: Any) -> bool:
    """Whether a field of a schema, or of one inside it, is left out where it is None."""
    if not isinstance(schema, dict):
        return False
    properties: dict[str, Any] = schema.get("properties", {})
    inside = (*properties.values(), schema.get("items"), *schema.get("prefixItems", ()), *schema.get("anyOf", ()))
    required: Collection[str] = schema.get("required", properties)
    return len(required) < len(properties) or any(map(_may_leave_out, inside))


def _without_absent(value: Any, schema: Any) -> Any:
    """Plain data without the fields that are None and that its schema does not require."""
    if isinstance(schema, dict) and "anyOf" in schema:
        schema = schema["anyOf"][0]
    if isinstance(value, dict) and "properties" in schema:
        inner, required = schema["properties"], schema.get("required", ())
        return {
            name: _without_absent(item, inner[name])
            for name, item in value.items()
            if item is not None or name in required
        }
    if isinstance(value, list):
        items = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        return [_without_absent(item, one) for item, one in zip(value, items, strict=True)]
    return value


def _binary(as_json: bool) -> dict[str, Any]:
    return {"type": "string", "contentEncoding": "base64" if as_json else "binary"}


def _kind_schema(kind: Any, as_json: bool) -> dict[str, Any]:
    """The schema of one field; kinds differ by the attributes they have."""
    spelling = str(kind.spelling)
    if hasattr(kind, "inner"):
        return {"anyOf": [_kind_schema(kind.inner, as_json), {"type": "null"}]}
    if hasattr(kind, "choices"):
        text = kind.base == "str"
        return {**(_SCALARS["str"](as_json) if text else _number(kind.base)), "enum": list(kind.choices)}
    if hasattr(kind, "columns"):
        if as_json:
            return {"type": "array", "items": _type_schema(kind.cls, True)}
        return {**_binary(False), "x-array": {"element": kind.element, "dimensions": 2, "columns": list(kind.columns)}}
    if hasattr(kind, "structure"):
        return _type_schema(kind.cls, as_json)
    if hasattr(kind, "enumeration"):
        return _enum_schema(kind.enumeration, as_json)
    if hasattr(kind, "items"):
        return {"type": "array", "prefixItems": [_kind_schema(item, as_json) for item in kind.items], "items": False}
    if hasattr(kind, "item"):
        return {"type": "array", "items": _kind_schema(kind.item, as_json)}
    if spelling.startswith("ndarray"):
        if as_json:
            text = {"dtype": {"type": "string"}, "shape": {"type": "array", "items": {"type": "integer"}}}
            return {"type": "object", "properties": {**text, "data": _binary(True)}}
        return {**_binary(False), "x-array": {"element": kind.element}}
    if spelling.startswith("seq["):
        if as_json:
            return _binary(True) if kind.element == "u8" else {"type": "array", "items": _number(str(kind.element))}
        return {**_binary(False), "x-array": {"element": kind.element, "dimensions": 1}}
    if spelling == "map":
        note = "scalars" if as_json else "scalars; a binary is an array as x-array-layout tells, a list has one binary"
        return {"type": "object", "description": note, **({} if as_json else {"additionalProperties": {"x-array": {}}})}
    if spelling in ("stamp", "datetime"):
        return {"type": "integer", "description": "nanoseconds since the epoch"}
    return _SCALARS[spelling](as_json) if spelling in _SCALARS else _number(spelling)


def _enum_schema(enumeration: Any, as_json: bool) -> dict[str, Any]:
    values: dict[str, Any] = {name: member.value for name, member in enumeration.__members__.items()}
    if as_json or not issubclass(enumeration, int):
        return {"type": "string", "enum": list(values)}
    return {"type": "integer", "enum": list(values.values()), "x-names": list(values)}


def _number(spelling: str) -> dict[str, Any]:
    if spelling == "bool":
        return {"type": "boolean"}
    return {"type": "number" if spelling[0] in "fc" else "integer", "x-number": spelling}


_SCALARS: Final[dict[str, Callable[[bool], dict[str, Any]]]] = {
    "bool": lambda _: {"type": "boolean"},
    "int": lambda _: {"type": "integer"},
    "float": lambda _: {"type": "number"},
    "str": lambda _: {"type": "string"},
    "char": lambda _: {"type": "string", "maxLength": 1},
    "wchar": lambda _: {"type": "string", "maxLength": 1},
    "bytes": _binary,
}
