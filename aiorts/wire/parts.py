"""Records to a head and parts: values by position, without names, and large arrays apart.

Both ends know the type and have compared its layout, so that a frame says neither the names of the fields nor that of
the type. A record of nothing but numbers is a packed structure, little-endian. Any other is one msgpack value: a list
of its fields in order, nested records likewise. An array or bytes of 16 KiB and more are a part: the list has the head
of the array in a list, or an empty list for bytes, and the parts follow in that order.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from aiorts.errors import WireError
from aiorts.types.arrays import MAX_DIMENSIONS, ArrayKind, NDArrayKind, element_dtype
from aiorts.types.generated import generate
from aiorts.types.kinds import BytesKind, Kind, OptionalKind, shown
from aiorts.types.nested import RecordKind
from aiorts.types.plain import build, is_built_plainly
from aiorts.types.rows import FixedTupleKind, RowsKind, TupleKind
from aiorts.types.samples import PLAIN_TYPES, settling
from aiorts.types.structure import describe, kind_of
from aiorts.wire.arrays import array_of_part, array_part, pack_array, unpack_array
from aiorts.wire.direct import number_builder
from aiorts.wire.forms import list_of, pair_of

if TYPE_CHECKING:
    from aiorts.types.structure import Structure

BESIDE: Final = 16_384
"""The least bytes of an array that is a part, apart from the head."""
_LARGEST_ARRAY: Final = BESIDE + 8 + 8 * MAX_DIMENSIONS
"""A size above that of any array inside a head, including the array's own head."""
Buffer: TypeAlias = bytes | bytearray | memoryview
Put: TypeAlias = Callable[[Any, list[memoryview]], Any]
Take: TypeAlias = Callable[[Any, str, Iterator[Buffer]], Any]

NUMBER_CODES: Final = {
    **dict(zip(("i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64"), "bBhHiIqQ", strict=True)),
    "f32": "f",
    "f64": "d",
    "bool": "?",
    "stamp": "Q",
}
"""The code of a field in the packed structure of a record of numbers, by its type."""


class Packed(NamedTuple):
    """The layout of a record of nothing but numbers in its frame."""

    layout: struct.Struct
    read: Callable[[Any], tuple[Any, ...]]
    """Gives the numbers of a record, in order, those of nested records too."""
    build: Callable[..., Any]
    """Makes the record of such numbers. RecordError: one does not fit."""


def packed(structure: Structure) -> Packed | None:
    """The packed layout of a record; None where it has other fields than numbers."""
    leaves = list(_leaves(structure, ""))
    if not leaves or any(kind is None for _, kind in leaves):
        return None
    layout = struct.Struct("<" + "".join(NUMBER_CODES[kind.spelling] for _, kind in leaves if kind is not None))
    getter = attrgetter(*(path for path, _ in leaves))
    read = getter if len(leaves) > 1 else lambda record: (getter(record),)
    return Packed(layout, read, number_builder(structure))


def _leaves(structure: Structure, prefix: str) -> Iterator[tuple[str, Kind | None]]:
    if not structure.checked:
        yield prefix, None
        return
    for field in structure.fields:
        if isinstance(field.kind, RecordKind):
            yield from _leaves(field.kind.structure, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, field.kind if field.kind.spelling in NUMBER_CODES else None


class Positions(NamedTuple):
    """Two functions for a value: to the value that msgpack packs, and back."""

    put: Put
    take: Take


def positions_of(kind: Kind) -> Positions:
    """The functions that put a kind's values into a frame, and take them out."""
    for base, make in _MAKERS:
        if isinstance(kind, base):
            return make(kind)
    put, take = pair_of(kind)
    return Positions(
        (lambda value, _parts: value) if put is None else (lambda value, _parts: put(value)),
        _as_it_is if take is None else (lambda value, where, _parts: take(value, where)),
    )


def _as_it_is(value: Any, _where: str, _parts: Iterator[Buffer]) -> Any:
    return value


def record_positions(structure: Structure, *, nested: bool = False) -> Positions:
    """The way of a record into a frame and back: a list of its fields. `nested`: taken ready to travel on."""
    cls, fields = structure.cls, structure.fields
    ways = [positions_of(field.kind) for field in fields]
    wheres = [f"{cls.__qualname__}.{field.name}" for field in fields]
    checks = [None if structure.checked else field.kind.check for field in fields]
    putting = list(zip([field.name for field in fields], [way.put for way in ways], wheres, checks, strict=True))

    def put(record: Any, parts: list[memoryview]) -> Any:
        values = []
        for name, put_one, where, check in putting:
            value = getattr(record, name)
            values.append(put_one(value if check is None else check(value, where), parts))
        return values

    return Positions(put, _record_taker(structure, [way.take for way in ways], wheres, nested=nested))


def _record_taker(structure: Structure, takes: Sequence[Take], wheres: Sequence[str], *, nested: bool) -> Take:
    """A function that takes a record out of the list of its fields, written out: frames have thousands of records."""
    cls, fields = structure.cls, structure.fields
    values = [f"v{i}" for i in range(len(fields))]
    known: dict[str, Any] = {"cls": cls, "list_of": list_of, "build": build}
    lines = [f"if type(values) is not list or len(values) != {len(fields)}: list_of(values, where, {len(fields)})"]
    if fields:
        lines.append(f"{', '.join(values)}, = values")
    for i, (field, take, where) in enumerate(zip(fields, takes, wheres, strict=True)):
        known |= {f"take{i}": take, f"where{i}": where, f"exact{i}": field.kind.exact, f"check{i}": field.kind.check}
        if take is not _as_it_is:
            lines.append(f"v{i} = take{i}(v{i}, where{i}, parts)")
        if not structure.checked and not _settled(field.kind):
            lines.append(f"if type(v{i}) is not exact{i}: v{i} = check{i}(v{i}, where{i})")
    if structure.checked:
        lines.append(f"return cls({', '.join(values)})")
    else:
        entries = ", ".join(f"{field.name!r}: {value}" for field, value in zip(fields, values, strict=True))
        lines.append(f"made = {'cls(**' if is_built_plainly(cls) else 'build(cls, '}{{{entries}}})")
        if nested:
            known["settle"] = settling(cls)
            lines.append(f"return settle(made, [{', '.join(values)}])")
        else:
            lines.append("return made")
    return generate("take(values, where, parts)", lines, known)


def _settled(kind: Kind) -> bool:
    """Whether decoded values of a kind are ready to travel on, so that a record around them need not check them."""
    if isinstance(kind, OptionalKind):
        return _settled(kind.inner)
    if isinstance(kind, FixedTupleKind):
        return all(map(_settled, kind.items))
    return isinstance(kind, RecordKind) or (isinstance(kind, TupleKind) and _settled(kind.item))


def _next(parts: Iterator[Buffer], where: str) -> Buffer:
    part = next(parts, None)
    if part is None:
        raise WireError(f"{where}: expected a part beside the frame, and there is none left")
    return part


def _beside(value: Any) -> bool:
    """Whether a value in the frame stands for a part."""
    return type(value) is list


def _array_positions(kind: ArrayKind) -> Positions:
    element, spelling = kind.element, kind.spelling
    one_dimension = not isinstance(kind, NDArrayKind)

    def take(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
        array = take_array(value, where, parts)
        if (element is not None and array.dtype != element_dtype(element)) or (one_dimension and array.ndim != 1):
            raise WireError(f"{where}: expected {spelling}, got {array.dtype} of shape {array.shape}")
        return array

    return Positions(_put_array, take)


def _put_array(array: Any, parts: list[memoryview]) -> Any:
    if array.nbytes < BESIDE:
        return pack_array(array)
    head, part = array_part(array)
    parts.append(part)
    return [head]


def take_array(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
    """The array of a frame, from the head or from a part; of any element type and shape."""
    if not _beside(value):
        if type(value) is bytes and len(value) >= _LARGEST_ARRAY:
            raise _belongs_beside(value, where)
        return unpack_array(value, where)
    if len(value) != 1:
        raise WireError(f"{where}: expected the head of an array, got {shown(value)}")
    return array_of_part(value[0], _next(parts, where), where)


def _belongs_beside(value: bytes, where: str) -> WireError:
    return WireError(f"{where}: {len(value)} bytes in the head of a frame; from {BESIDE} on they are beside it")


def _rows_positions(kind: RowsKind) -> Positions:
    dtype, width = kind.element or "", len(kind.columns)

    def put(rows: Any, parts: list[memoryview]) -> Any:
        return _put_array(rows.array, parts)

    def take(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
        array = take_array(value, where, parts)
        if array.dtype != element_dtype(dtype) or array.ndim != 2 or array.shape[1] != width:
            raise WireError(
                f"{where}: expected {dtype} of shape (n, {width}), got {array.dtype} of shape {array.shape}"
            )
        return array

    return Positions(put, take)


def _bytes_positions(_kind: BytesKind) -> Positions:
    def put(value: bytes, parts: list[memoryview]) -> Any:
        if len(value) < BESIDE:
            return value
        parts.append(memoryview(value))
        return []

    return Positions(put, take_bytes)


def take_bytes(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
    """The bytes of a frame, from the head or from a part."""
    if not _beside(value):
        if type(value) is bytes and len(value) >= BESIDE:
            raise _belongs_beside(value, where)
        return value
    list_of(value, where, 0)
    return bytes(_next(parts, where))


def _nested_positions(kind: RecordKind) -> Positions:
    return record_positions(kind.structure, nested=True)


def _tuple_positions(kind: TupleKind) -> Positions:
    way, settled = positions_of(kind.item), _settled(kind.item)
    take_one = way.take

    def put(items: Any, parts: list[memoryview]) -> Any:
        return [way.put(item, parts) for item in items]

    def take(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
        list_of(value, where)
        found = [take_one(item, f"{where}[{index}]", parts) for index, item in enumerate(value)]
        return tuple(found) if settled else found

    return Positions(put, take)


def _fixed_positions(kind: FixedTupleKind) -> Positions:
    ways = [positions_of(item) for item in kind.items]

    def put(items: Any, parts: list[memoryview]) -> Any:
        return [way.put(item, parts) for way, item in zip(ways, items, strict=True)]

    def take(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
        list_of(value, where, len(ways))
        numbered = enumerate(zip(ways, value, strict=True))
        return tuple(way.take(item, f"{where}[{index}]", parts) for index, (way, item) in numbered)

    return Positions(put, take)


def _optional_positions(kind: OptionalKind) -> Positions:
    way = positions_of(kind.inner)

    def put(value: Any, parts: list[memoryview]) -> Any:
        return None if value is None else way.put(value, parts)

    def take(value: Any, where: str, parts: Iterator[Buffer]) -> Any:
        return None if value is None else way.take(value, where, parts)

    return Positions(put, take)


_MAKERS: Final[tuple[tuple[type, Callable[[Any], Positions]], ...]] = (
    (RecordKind, _nested_positions),
    (ArrayKind, _array_positions),
    (RowsKind, _rows_positions),
    (BytesKind, _bytes_positions),
    (TupleKind, _tuple_positions),
    (FixedTupleKind, _fixed_positions),
    (OptionalKind, _optional_positions),
)


def layout_of(cls: type) -> tuple[Packed | None, Positions]:
    """The layout of a class that can travel: packed where that is possible, and by position."""
    found = _layouts.get(cls)
    if found is None:
        found = _layouts[cls] = _plain_layout(cls) if cls in PLAIN_TYPES else _record_layout(describe(cls))
    return found


_layouts: dict[type, tuple[Packed | None, Positions]] = {}


def _record_layout(structure: Structure) -> tuple[Packed | None, Positions]:
    return packed(structure), record_positions(structure)


def _plain_layout(cls: type) -> tuple[Packed | None, Positions]:
    kind = kind_of(cls, cls.__name__)
    way = positions_of(kind)
    return None, Positions(
        lambda value, parts: way.put(kind.check(value, cls.__name__), parts),
        lambda value, where, parts: kind.check(way.take(value, where, parts), where),
    )


def flat(parts: Sequence[Buffer]) -> list[Buffer]:
    """The parts as read-only bytes. WireError: one is not contiguous."""
    found: list[Buffer] = []
    for part in parts:
        if type(part) is bytes:
            found.append(part)
            continue
        view = memoryview(part)
        if not view.c_contiguous:
            raise WireError("expected parts that are contiguous")
        found.append(view.cast("B").toreadonly() if view.nbytes else b"")
    return found
