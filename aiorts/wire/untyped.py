"""Decodes frames of records without their class to plain values, for tools that only have the text of a layout.

The text comes from another kernel and is data: it is walked, and refused where it is not as `layout_text` writes it.
Nothing is imported, compiled or made a class because of it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from aiorts.errors import WireError
from aiorts.types.kinds import shown
from aiorts.wire.codec import MsgpackCodec
from aiorts.wire.forms import list_of, map_entries
from aiorts.wire.limits import LINK
from aiorts.wire.parts import NUMBER_CODES, Buffer, Take, layout_of, take_array, take_bytes
from aiorts.wire.scan import MAX_DEPTH
from aiorts.wire.schemas import schema_text, without_units

_LIES_AS: Final = "x-frame"
_PACKED: Final = "packed"
_BY_POSITION: Final = "positions"


def layout_text(cls: type) -> str:
    """The text of the layout of a class's records in head and parts: their schema, and whether they are packed."""
    document = without_units(json.loads(schema_text(cls)))
    packed, _ = layout_of(cls)
    return json.dumps({_LIES_AS: _BY_POSITION if packed is None else _PACKED, **document}, separators=(",", ":"))


def untyped_decoder(layout: str, codec: MsgpackCodec | None = None) -> Callable[[Buffer, Sequence[Buffer]], Any]:
    """A decoder of heads and parts of the class that a layout describes, without the class.

    A record becomes a dict of its fields, in order, a sequence a list, an enumeration the name of its member, a stamp
    and a datetime nanoseconds; an array, and a sequence of records of one element type, is a read-only numpy array.

    Args:
        layout: the result of `layout_text` where the class is.
        codec: the codec whose limits hold; by default those of `LINK`.

    Raises:
        WireError: the layout is none. The decoder raises it for a frame that does not fit the layout.
    """
    try:
        document = json.loads(layout)
        _, name, value = document["prefixItems"]
        lies, name = document[_LIES_AS], name["const"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise WireError("expected the text of a layout, as layout_text gives it") from None
    if type(name) is not str or lies not in (_PACKED, _BY_POSITION):
        raise WireError(f"expected a layout that is {_PACKED} or by {_BY_POSITION}, got {shown(lies)}")
    if lies == _PACKED:
        return _packed_decoder(value, name)
    return (codec or MsgpackCodec(LINK)).taking_parts(name, _take_of(value, name, MAX_DEPTH))


def _packed_decoder(schema: Any, name: str) -> Callable[[Buffer, Sequence[Buffer]], Any]:
    codes: list[str] = []
    build = _packed_builder(schema, name, codes, MAX_DEPTH)
    layout = struct.Struct("<" + "".join(codes))

    def decode(head: Buffer, parts: Sequence[Buffer]) -> Any:
        if parts or len(head) != layout.size:
            raise WireError(f"{name}: expected {layout.size} bytes, got {len(head)} and {len(parts)} parts")
        return build(iter(layout.unpack(head)))

    return decode


def _packed_builder(schema: Any, where: str, codes: list[str], levels: int) -> Callable[[Iterator[Any]], Any]:
    """A function that makes the value of the numbers of a packed frame, in order; adds their codes to `codes`."""
    properties = _properties(schema, where, levels)
    if properties is not None:
        fields = [
            (name, _packed_builder(one, f"{where}.{name}", codes, levels - 1)) for name, one in properties.items()
        ]
        return lambda numbers: {name: build(numbers) for name, build in fields}
    spelling = schema.get("x-number", _PACKED_TYPES.get(str(schema.get("type")))) if type(schema) is dict else None
    code = NUMBER_CODES.get(spelling) if type(spelling) is str else None
    if code is None:
        raise _no_layout(schema, where)
    codes.append(code)
    return next


_PACKED_TYPES: Final = {"boolean": "bool", "integer": "stamp"}


def _take_of(schema: Any, where: str, levels: int) -> Take:
    """A function that takes the value that a schema describes out of a frame by position."""
    if type(schema) is not dict:
        raise _no_layout(schema, where)
    for word, make in _MAKERS.items():
        if word in schema:
            return make(schema, where, levels)
    if schema.get("contentEncoding") == "binary":
        return take_bytes
    name = str(schema.get("type"))
    if name not in _TYPES:
        raise _no_layout(schema, where)
    types = _TYPES[name]

    def take(value: Any, place: str, _parts: Iterator[Buffer]) -> Any:
        if type(value) not in types:
            raise WireError(f"{place}: expected {name}, got {shown(value)}")
        return value

    return take


_TYPES: Final[dict[str, tuple[type, ...]]] = {
    "boolean": (bool,),
    "integer": (int,),
    "number": (float, int),
    "string": (str,),
}


def _properties(schema: Any, where: str, levels: int) -> dict[str, Any] | None:
    """The fields of a record's schema; None: it is no record's. WireError: the nesting is too deep."""
    if not levels:
        raise WireError(f"{where}: expected at most {MAX_DEPTH} levels, got more")
    found = schema.get("properties") if type(schema) is dict else None
    return found if type(found) is dict else None


def _record(schema: Any, where: str, levels: int) -> Take:
    properties = _properties(schema, where, levels)
    if properties is None:
        raise _no_layout(schema, where)
    fields = [
        (name, _take_of(one, f"{where}.{name}", levels - 1), f"{where}.{name}") for name, one in properties.items()
    ]

    def take(values: Any, place: str, parts: Iterator[Buffer]) -> Any:
        list_of(values, place, len(fields))
        return {name: one(value, at, parts) for (name, one, at), value in zip(fields, values, strict=True)}

    return take


def _items(schema: Any, where: str, levels: int) -> Take:
    _properties(schema, where, levels)
    item = _take_of(schema["items"], where, levels - 1)

    def take(values: Any, place: str, parts: Iterator[Buffer]) -> Any:
        return [item(value, f"{place}[{index}]", parts) for index, value in enumerate(list_of(values, place))]

    return take


def _fixed(schema: Any, where: str, levels: int) -> Take:
    _properties(schema, where, levels)
    if type(schema["prefixItems"]) is not list:
        raise _no_layout(schema, where)
    items = [_take_of(item, f"{where}[{index}]", levels - 1) for index, item in enumerate(schema["prefixItems"])]

    def take(values: Any, place: str, parts: Iterator[Buffer]) -> Any:
        numbered = enumerate(zip(items, list_of(values, place, len(items)), strict=True))
        return [item(value, f"{place}[{index}]", parts) for index, (item, value) in numbered]

    return take


def _optional(schema: Any, where: str, levels: int) -> Take:
    _properties(schema, where, levels)
    if type(schema["anyOf"]) is not list or len(schema["anyOf"]) != 2:
        raise _no_layout(schema, where)
    inner = _take_of(schema["anyOf"][0], where, levels - 1)
    return lambda value, place, parts: None if value is None else inner(value, place, parts)


def _members(schema: Any, where: str, _levels: int) -> Take:
    """A function that takes an enumeration or a choice: its name where numbers have names, else the value itself."""
    choices, names = schema["enum"], schema.get("x-names", schema["enum"])
    if type(choices) is not list or type(names) is not list or len(names) != len(choices):
        raise _no_layout(schema, where)

    def take(value: Any, place: str, _parts: Iterator[Buffer]) -> Any:
        if type(value) not in (bool, int, str) or value not in choices:
            raise WireError(f"{place}: expected one of {shown(choices)}, got {shown(value)}")
        return names[choices.index(value)]

    return take


def _map(_schema: Any, _where: str, _levels: int) -> Take:
    return lambda value, place, _parts: map_entries(value, place)


def _array(_schema: Any, _where: str, _levels: int) -> Take:
    return take_array


_MAKERS: Final[dict[str, Callable[[Any, str, int], Take]]] = {
    "anyOf": _optional,
    "enum": _members,
    "x-array": _array,
    "properties": _record,
    "prefixItems": _fixed,
    "items": _items,
    "additionalProperties": _map,
}
"""The makers, by the word that tells the kind of a schema: the first of these that it has."""


def _no_layout(schema: Any, where: str) -> WireError:
    return WireError(f"{where}: expected the layout of a field, got {shown(schema)}")
