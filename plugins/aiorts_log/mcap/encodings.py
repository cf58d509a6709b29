"""Encodes the records of a port as messages, and makes the schema that explains them to any reader.

"msgpack" is the encoding of `aiorts.wire`, explained by a JSON Schema whose `x-array` marks arrays; "json" is an object
that Foxglove shows as it is (encodings "json" and "jsonschema").
"""

from __future__ import annotations

import base64
import json
import math
import struct
import sys
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, Final, Literal, TypeAlias

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import RecordError, UnknownTypeError, WireError
from aiorts.types import describe, from_plain, to_plain, wire_name, wire_type
from aiorts.wire import FORMAT, MsgpackCodec
from aiorts_log.mcap.format import Schema

Encoding: TypeAlias = Literal["msgpack", "json"]
ENCODINGS: Final = ("msgpack", "json")
SCHEMA_ENCODING: Final = "jsonschema"
ELEMENTS: Final = ("bool", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "f16", "f32", "f64", "c64", "c128")
"""Element types by code, from 1. Part of the format of `aiorts.wire`; every schema has the table."""
_CODES: Final = {"bool": "?", "i8": "b", "i16": "h", "i32": "i", "i64": "q", "u8": "B", "u16": "H", "u32": "I"}
_STRUCT: Final = {**_CODES, "u64": "Q", "f16": "e", "f32": "f", "f64": "d"}
_PLAIN: Final[dict[str, type]] = {cls.__name__: cls for cls in (bool, int, float, str, bytes)}
_OF_FILE: Final = "aiorts_system."
"""Begins the module of a single file, which folder and name of the file follow."""
_LONGEST: Final = 4096
"""Items of a list or map of a type that is not loaded: nested lists in a frame must not fill the memory."""
# Part of the format to the letter: a file whose schema differs is read as one of another type.
_LAYOUT: Final = {
    "what": "a binary with x-array holds an array of numbers",
    "head": "octet 0: code of the element type; octet 1: dimensions; octets 2-7: zero; then one u64 for each length",
    "body": "the elements in C order",
    "byte order": "little-endian",
    "codes": dict(enumerate(ELEMENTS, start=1)),
}
_SPLIT: Final = 2**25
"""Bytes of an array that no limit of the codec can refuse."""
_SPLIT_KINDS: Final = {f"seq[{element}]" for element in ELEMENTS}
_LARGE_BINARY: Final = struct.Struct(">BI")
_LENGTH: Final = struct.Struct("<Q")
_DRAFT: Final = "https://json-schema.org/draft/2020-12/schema"


def named_type(name: str) -> tuple[type | None, str]:
    """The type that a recording names, or None and why there is none; at most what a plugin declares is imported."""
    try:
        cls = wire_type(name)
    except UnknownTypeError as error:
        return None, str(error)
    if cls is not None:
        return cls, ""
    way = "import the module that defines it (--type-mod), or install its plugin"
    if module := name.rpartition(".")[0]:
        file = "" if "." in module else f", not {module[:80]}.py"
        way = f"import the module that defines it (--type-mod {module[:80]}{file}), or install its plugin"
    if name.startswith(_OF_FILE):
        folder, _, stem = name.removeprefix(_OF_FILE).rpartition(".")[0].rpartition(".")
        way = f"it is of a file: --type-mod {folder[:40]}/{stem[:40]}.py, with the way to that folder in front"
    return None, f"no type {name[:80]!r} is known here; {way}"


def file_of_both(first: str, second: str) -> str:
    """The file whose class two names may mean, one by its path and one as a module; "" where they cannot."""
    by_name, by_path = sorted((first, second), key=len)
    folder = by_path.removeprefix(_OF_FILE).removesuffix(f".{by_name}")
    return f"{folder}/{by_name.partition('.')[0]}.py" if by_path == f"{_OF_FILE}{folder}.{by_name}" else ""


def schema_of(number: int, cls: type, encoding: Encoding) -> Schema:
    """The schema record of a port's type."""
    name = wire_name(cls)
    fields = _type_schema(cls, encoding == "json")
    document: dict[str, Any] = {"$schema": _DRAFT, "title": name}
    if encoding == "json":
        if cls in _PLAIN.values():
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
    return Schema(number, name, SCHEMA_ENCODING, json.dumps(document, separators=(",", ":")).encode())


def _type_schema(cls: type, as_json: bool) -> dict[str, Any]:
    if cls in _PLAIN.values():
        return _SCALARS[cls.__name__](as_json)
    kinds: dict[str, Any] = {field.name: field.kind for field in describe(cls).fields}
    # Foxglove refuses a schema with a field that may be null, which has no one type: such a field is left out.
    left_out = [one for one in describe(cls).fields if as_json and one.default is None and hasattr(one.kind, "inner")]
    absent = {one.name: kinds[one.name].inner for one in left_out}
    return {
        "type": "object",
        "properties": {name: _kind_schema(absent.get(name, kind), as_json) for name, kind in kinds.items()},
        "required": [name for name in kinds if name not in absent],
        "additionalProperties": False,
    }


def message_of(record: Any) -> Any:
    """What a message in JSON holds of a record: an object, without the fields that are left out."""
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
    """Whether a field of it, or of what is in it, is left out where it is None."""
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


def encoder(encoding: Encoding, cls: type) -> Callable[[Any], bytes]:
    """A function that encodes records of exactly this class, for one thread. It raises RecordError or LimitError."""
    if encoding == "msgpack":
        return MsgpackCodec().encoder(cls)
    to_text = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode
    unchecked = hasattr(cls, "__dataclass_fields__") and not describe(cls).checked
    check = MsgpackCodec().encoder(cls) if unchecked else None

    def encode(record: Any) -> bytes:
        if check is not None:
            check(record)  # a plain dataclass holds whatever it was given
        try:
            return to_text(message_of(record)).encode()
        except ValueError as error:
            raise RecordError(f"{cls.__name__}: no JSON: {str(error)[:80]}") from None

    return encode


def splitter(encoding: Encoding, cls: type) -> Callable[[Any], tuple[bytes, bytes]] | None:
    """The same as `encoder`, in two parts, for records whose last field is a large array, which is then copied once.

    A recorder that copies a megabyte three times holds the interpreter for as long. None for all other types; records
    below 65,536 bytes come in one part.
    """
    if encoding != "msgpack" or sys.byteorder != "little" or not hasattr(cls, "__dataclass_fields__"):
        return None
    structure = describe(cls)
    name, kind = structure.fields[-1].name, structure.fields[-1].kind
    if not structure.checked or kind.spelling not in _SPLIT_KINDS or hasattr(cls, "__post_init__"):
        return None  # what looks at all fields together might refuse the record without its array
    encode = MsgpackCodec().encoder(cls)

    def split(record: Any) -> tuple[bytes, bytes]:
        array = getattr(record, name)
        if not 65_536 <= array.nbytes <= _SPLIT:
            return encode(record), b""
        frame = encode(replace(record, **{name: ()}))  # ends with an empty array: a head of 16 bytes, its length last
        head = _LARGE_BINARY.pack(0xC6, 16 + array.nbytes) + frame[-16:-8] + _LENGTH.pack(array.size)
        return frame[:-18] + head, array.tobytes()

    return split


def taker(cls: type, encoding: str) -> Callable[[bytes], Any]:
    """A function that decodes bytes to a record of `cls`. It raises WireError or RecordError."""
    if encoding == "msgpack":
        decode = MsgpackCodec().decode
        return lambda data: decode(data, cls)

    def take(data: bytes) -> Any:
        try:
            plain = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise WireError(f"no JSON: {str(error)[:80]}") from None
        if cls in _PLAIN.values():
            if not isinstance(plain, dict) or set(plain) != {"value"}:
                raise WireError('expected an object with "value" alone')
            plain = plain["value"]
        return from_plain(cls, plain)

    return take


def plain_of(
    data: bytes, encoding: str, schema: Schema | None, array: Callable[[bytes, Any], Any] | None = None
) -> Any:
    """Decode a message of a type that is not loaded to plain data for JSON, as far as its schema explains it.

    Args:
        array: makes a value of an array of a frame and what the schema says of it; None makes lists.
    """
    try:
        if encoding == "json":
            return json.loads(data)
        if encoding == "msgpack":
            found = msgpack.unpackb(
                data,
                raw=False,
                strict_map_key=True,
                max_array_len=min(_LONGEST, len(data)),
                max_map_len=min(_LONGEST, len(data)),
                max_ext_len=0,
            )
            return _plain(found, _explained(schema), array or _lists)
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException, WireError, RecordError):
        pass  # given as bytes
    return {"encoding": encoding, "bytes": base64.b64encode(data).decode("ascii")}


def _explained(schema: Schema | None) -> dict[str, Any]:
    if schema is None or schema.encoding != SCHEMA_ENCODING:
        return {}
    try:
        found = json.loads(schema.data)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _plain(value: Any, schema: Any, array: Callable[[bytes, Any], Any]) -> Any:
    schema = schema if isinstance(schema, dict) else {}
    either = schema.get("anyOf")
    if isinstance(either, list) and either and isinstance(either[0], dict):
        schema = either[0]
    if isinstance(value, bytes):
        return array(value, schema["x-array"]) if "x-array" in schema else base64.b64encode(value).decode("ascii")
    if isinstance(value, dict):
        # A map within a map holds what the outer one does.
        inner, rest = schema.get("properties"), schema if "x-array" in schema else schema.get("additionalProperties")
        inner = inner if isinstance(inner, dict) else {}
        return {str(key): _plain(item, inner.get(key, rest), array) for key, item in value.items()}
    if isinstance(value, list):
        first, rest = schema.get("prefixItems"), schema.get("items")
        first = first if isinstance(first, list) else []
        plain = [_plain(item, first[i] if i < len(first) else rest, array) for i, item in enumerate(value)]
        return plain[2] if len(plain) == 3 and first and "x-array-layout" in schema else plain
    return _json_number(value)


def _json_number(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def array_parts(data: bytes) -> tuple[str, tuple[int, ...], int]:
    """Element type, shape and length of the head of an array in a frame; WireError when it has none."""
    head = 8 + 8 * (data[1] if len(data) > 1 else 0)
    if len(data) < max(head, 8) or not 1 <= data[0] <= len(ELEMENTS) or data[1] > 8:
        raise WireError("no array")
    return ELEMENTS[data[0] - 1], struct.unpack_from(f"<{data[1]}Q", data, 8), head


def _lists(data: bytes, _: Any) -> Any:
    """The numbers of an array as lists; WireError when the bytes contradict its head."""
    element, shape, head = array_parts(data)
    code = _STRUCT.get(element)
    count = math.prod(shape)
    if code is None or count * struct.calcsize(f"<{code}") != len(data) - head:
        raise WireError("no array")
    flat: list[Any] = [_json_number(one) for one in struct.unpack_from(f"<{count}{code}", data, head)]
    for length in reversed(shape[1:]):
        flat = [flat[i : i + length] for i in range(0, len(flat), length)] if length else []
    return flat if shape else flat[0]
