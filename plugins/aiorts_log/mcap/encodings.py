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
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, Literal, TypeAlias

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import RecordError, UnknownTypeError, WireError
from aiorts.types import describe, from_plain, wire_name, wire_type
from aiorts.wire import ELEMENTS, MsgpackCodec, json_message, schema_text
from aiorts_log.mcap.format import Schema

Encoding: TypeAlias = Literal["msgpack", "json"]
ENCODINGS: Final = ("msgpack", "json")
SCHEMA_ENCODING: Final = "jsonschema"
_CODES: Final = {"bool": "?", "i8": "b", "i16": "h", "i32": "i", "i64": "q", "u8": "B", "u16": "H", "u32": "I"}
_STRUCT: Final = {**_CODES, "u64": "Q", "f16": "e", "f32": "f", "f64": "d"}
_PLAIN: Final[dict[str, type]] = {cls.__name__: cls for cls in (bool, int, float, str, bytes)}
_OF_FILE: Final = "aiorts_system."
"""The beginning of a single file's module name; folder and name of the file follow."""
_LONGEST: Final = 4096
"""The most items of a list or map of a type that is not loaded: nested lists in a frame must not fill the memory."""
_SPLIT: Final = 2**25
"""Bytes up to which no limit of the codec can refuse an array."""
_SPLIT_KINDS: Final = {f"seq[{element}]" for element in ELEMENTS}
_LARGE_BINARY: Final = struct.Struct(">BI")
_LENGTH: Final = struct.Struct("<Q")


def named_type(name: str) -> tuple[type | None, str]:
    """The type that a recording names, or None and the reason why not; imports only classes that a plugin declares."""
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
    """The file whose class two names may mean, one by its path and one as a module; "" where there is none."""
    by_name, by_path = sorted((first, second), key=len)
    folder = by_path.removeprefix(_OF_FILE).removesuffix(f".{by_name}")
    return f"{folder}/{by_name.partition('.')[0]}.py" if by_path == f"{_OF_FILE}{folder}.{by_name}" else ""


def schema_of(number: int, cls: type, encoding: Encoding) -> Schema:
    """The schema record of a port's type."""
    return Schema(number, wire_name(cls), SCHEMA_ENCODING, schema_text(cls, as_json=encoding == "json").encode())


def encoder(encoding: Encoding, cls: type) -> Callable[[Any], bytes]:
    """A function that encodes records of exactly this class, for one thread. It raises RecordError or LimitError."""
    if encoding == "msgpack":
        return MsgpackCodec().encoder(cls)
    to_text = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode
    unchecked = hasattr(cls, "__dataclass_fields__") and not describe(cls).checked
    check = MsgpackCodec().encoder(cls) if unchecked else None

    def encode(record: Any) -> bytes:
        if check is not None:
            check(record)  # a plain dataclass does not check its values
        try:
            return to_text(json_message(record)).encode()
        except ValueError as error:
            raise RecordError(f"{cls.__name__}: no JSON: {str(error)[:80]}") from None

    return encode


def splitter(encoding: Encoding, cls: type) -> Callable[[Any], tuple[bytes, bytes]] | None:
    """A function that encodes in two parts records whose last field is a large array, which is then copied once.

    A recorder that copies a megabyte three times holds the interpreter three times as long. None for all other types;
    records below 65,536 bytes come in one part.
    """
    if encoding != "msgpack" or sys.byteorder != "little" or not hasattr(cls, "__dataclass_fields__"):
        return None
    structure = describe(cls)
    name, kind = structure.fields[-1].name, structure.fields[-1].kind
    if not structure.checked or kind.spelling not in _SPLIT_KINDS or hasattr(cls, "__post_init__"):
        return None  # a check of all fields together might refuse the record without its array
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
        array: makes a value of the bytes of an array and its schema; None makes lists.
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
        # The schema of an array in a map is also that of the arrays in a map within it.
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
