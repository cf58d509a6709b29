"""The form of each kind of field in a frame: a pair of functions, made once for each type.

Records are maps from field name to value, so that a frame shows missing and unknown fields; number sequences and
sequences of records with one element type are one binary each; enumerations are their integer, or their member's name;
an absent value is nil, and a datetime its nanoseconds since the epoch.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum
from operator import attrgetter
from typing import Any, NamedTuple

from aiorts.errors import RecordError, WireError
from aiorts.types.arrays import ArrayKind, NDArrayKind, element_dtype
from aiorts.types.generated import generate
from aiorts.types.kinds import DateTimeKind, EnumKind, Kind, OptionalKind, datetime_ns, shown
from aiorts.types.nested import RecordKind
from aiorts.types.plain import build
from aiorts.types.rows import MAP_LEVELS, FixedTupleKind, MapKind, RecordArray, RowsKind, TupleKind
from aiorts.types.structure import Structure, describe
from aiorts.wire.arrays import pack_array, unpack_array

Put = Callable[[Any], Any]
Take = Callable[[Any, str], Any]


class Form(NamedTuple):
    """Turns a record into the value that msgpack packs, and back. `take` raises WireError or RecordError."""

    put: Put
    take: Take


# None: the value goes into the frame unchanged; the record's constructor checks a value read from a frame.
Pair = tuple[Put | None, Take | None]
_forms: dict[type, Form] = {}


def form_of(cls: type) -> Form:
    """The form of a record type or dataclass."""
    form = _forms.get(cls)
    if form is None:
        form = _forms[cls] = _record_form(describe(cls))
    return form


def _record_form(structure: Structure) -> Form:
    names = tuple(field.name for field in structure.fields)
    pairs = tuple(pair_of(field.kind) for field in structure.fields)
    wheres = tuple(f"{structure.cls.__qualname__}.{name}" for name in names)
    return Form(_putter(structure, names, pairs, wheres), _taker(structure, names, pairs, wheres))


def _putter(structure: Structure, names: tuple[str, ...], pairs: tuple[Pair, ...], wheres: tuple[str, ...]) -> Put:
    if structure.checked:
        known: dict[str, Any] = {}
        return generate("put(record)", [f"return {_entries(structure, 'record', known)}"], known)
    read: Any = attrgetter(*names) if len(names) > 1 else lambda record: tuple(getattr(record, name) for name in names)
    puts = tuple((name, put) for name, (put, _) in zip(names, pairs, strict=True) if put is not None)
    kinds = tuple(zip((field.kind for field in structure.fields), wheres, strict=True))

    def put_unchecked(record: Any) -> Any:
        fields = {
            n: kind.check(value, where) for n, (kind, where), value in zip(names, kinds, read(record), strict=True)
        }
        for name, put in puts:
            fields[name] = put(fields[name])
        return fields

    return put_unchecked


def _entries(structure: Structure, record: str, known: dict[str, Any]) -> str:
    """The code of the map as which a checked record is packed; `known` gets the objects that it names."""
    entries = []
    for field in structure.fields:
        # Python would normalise a name that is written out, if it is not ASCII.
        value = f"{record}.{field.name}" if field.name.isascii() else f"getattr({record}, {field.name!r})"
        if isinstance(field.kind, RecordKind) and field.kind.structure.checked:
            value = _entries(field.kind.structure, value, known)
        elif (put := pair_of(field.kind)[0]) is not None:
            name = f"put{len(known)}"
            known[name] = put
            value = f"{name}({value})"
        entries.append(f"{field.name!r}: {value}")
    return f"{{{', '.join(entries)}}}"


def _taker(structure: Structure, names: tuple[str, ...], pairs: tuple[Pair, ...], wheres: tuple[str, ...]) -> Take:
    cls, count = structure.cls, len(names)
    takes = tuple(
        (name, take, where) for name, (_, take), where in zip(names, pairs, wheres, strict=True) if take is not None
    )
    kinds = {field.name: field.kind for field in structure.fields}

    def take_record(fields: Any, where: str) -> Any:
        if type(fields) is not dict or len(fields) != count:
            raise _wrong_fields(fields, names, where)
        try:
            for name, take, place in takes:
                fields[name] = take(fields[name], place)
            if structure.checked:
                return cls(*[fields[name] for name in names])
        except KeyError:
            raise _wrong_fields(fields, names, where) from None
        if any(name not in kinds for name in fields):
            raise _wrong_fields(fields, names, where)
        return build(cls, {name: kinds[name].check(fields[name], f"{where}.{name}") for name in names})

    return take_record


def _wrong_fields(fields: Any, names: tuple[str, ...], where: str) -> WireError:
    if type(fields) is not dict:
        return WireError(f"{where}: expected a map with {', '.join(names)}, got {shown(fields)}")
    missing = [name for name in names if name not in fields]
    unknown = [shown(name) for name in fields if name not in names][:5]
    parts = [f"missing {', '.join(missing)}"] if missing else []
    parts += [f"unknown {', '.join(unknown)}"] if unknown else []
    return WireError(f"{where}: {'; '.join(parts)}; expected the fields {', '.join(names)}")


def pair_of(kind: Kind) -> Pair:
    for base, make in _PAIRS:
        if isinstance(kind, base):
            return make(kind)
    return None, None


def _array_pair(kind: ArrayKind) -> Pair:
    element, spelling = kind.element, kind.spelling
    one_dimension = not isinstance(kind, NDArrayKind)

    def take(data: Any, where: str) -> Any:
        array = unpack_array(data, where)
        # The element type is part of the record's type: another one is the sender's mistake even if the values would
        # fit.
        if (element is not None and array.dtype != element_dtype(element)) or (one_dimension and array.ndim != 1):
            raise WireError(f"{where}: expected {spelling}, got {array.dtype} of shape {array.shape}")
        return array

    return pack_array, take


def _rows_pair(kind: RowsKind) -> Pair:
    dtype, width = kind.element or "", len(kind.columns)

    def take(data: Any, where: str) -> Any:
        array = unpack_array(data, where)
        if array.dtype != element_dtype(dtype) or array.ndim != 2 or array.shape[1] != width:
            raise WireError(
                f"{where}: expected {dtype} of shape (n, {width}), got {array.dtype} of shape {array.shape}"
            )
        return array

    def put(rows: RecordArray[Any]) -> bytes:
        return pack_array(rows.array)

    return put, take


def _nested_pair(kind: RecordKind) -> Pair:
    form = form_of(kind.cls)
    return form.put, form.take


def _enum_pair(kind: EnumKind) -> Pair:
    if issubclass(kind.enumeration, IntEnum):
        return int, None

    def take(name: Any, where: str) -> Any:
        if type(name) is not str or name not in kind.enumeration.__members__:
            raise WireError(f"{where}: expected {kind.expected}, got {shown(name)}")
        return kind.enumeration[name]

    return lambda member: member.name, take


def list_of(value: Any, where: str, count: int | None = None) -> Any:
    if type(value) is not list or (count is not None and len(value) != count):
        raise WireError(f"{where}: expected a list{f' of {count}' if count is not None else ''}, got {shown(value)}")
    return value


def _tuple_pair(kind: TupleKind) -> Pair:
    put, take = pair_of(kind.item)

    def put_items(items: Any) -> Any:
        return list(items) if put is None else [put(item) for item in items]

    def take_items(items: Any, where: str) -> Any:
        list_of(items, where)
        return items if take is None else [take(item, f"{where}[{index}]") for index, item in enumerate(items)]

    return put_items, take_items


def _fixed_pair(kind: FixedTupleKind) -> Pair:
    pairs = tuple(pair_of(item) for item in kind.items)

    def put_items(items: Any) -> Any:
        return [put(item) if put is not None else item for (put, _), item in zip(pairs, items, strict=True)]

    def take_items(items: Any, where: str) -> Any:
        list_of(items, where, len(pairs))
        numbered = enumerate(zip(pairs, items, strict=True))
        return tuple(take(item, f"{where}[{i}]") if take is not None else item for i, ((_, take), item) in numbered)

    return put_items, take_items


def _map_pair(kind: MapKind) -> Pair:
    """The pair of a map. Entries have no declared kind: a binary is an array, bytes are a list of one binary."""

    def put(entries: Any) -> Any:
        return {name: _put_entry(entry) for name, entry in entries.items()}

    return put, map_entries


def map_entries(entries: Any, where: str) -> Any:
    """The entries of a map in a frame."""
    if type(entries) is not dict:
        raise WireError(f"{where}: expected a map, got {shown(entries)}")
    return _take_entries(entries, where, MAP_LEVELS)


def _take_entries(entries: Any, where: str, levels: int) -> Any:
    found = {}
    for name, entry in entries.items():
        cls = type(entry)
        if cls is bytes:
            # The text of its place is made only if it is no array, because that takes as long as reading an array.
            with suppress(WireError):
                found[name] = unpack_array(entry, where)
                continue
        is_scalar = cls is int or cls is float or cls is str or cls is bool
        found[name] = entry if is_scalar else _take_entry(entry, f"{where}[{shown(name)}]", levels)
    return found


def _put_entry(entry: Any) -> Any:
    if type(entry) is bytes:
        return [entry]
    if hasattr(entry, "keys"):
        return {name: _put_entry(inner) for name, inner in entry.items()}
    return pack_array(entry) if hasattr(entry, "dtype") else entry


def _take_entry(entry: Any, where: str, levels: int) -> Any:
    if type(entry) is dict:
        if levels == 1:
            raise WireError(f"{where}: expected at most {MAP_LEVELS} maps within each other, got more")
        return _take_entries(entry, where, levels - 1)
    if type(entry) is bytes:
        return unpack_array(entry, where)
    if type(entry) is list:
        if len(entry) != 1 or type(entry[0]) is not bytes:
            raise WireError(f"{where}: expected bytes, got {shown(entry)}")
        return entry[0]
    if type(entry) not in (bool, int, float, str):
        raise RecordError(f"{where}: expected a scalar or an array, got {shown(entry)}")
    return entry


def _optional_pair(kind: OptionalKind) -> Pair:
    put, take = pair_of(kind.inner)
    return (
        None if put is None else lambda value: None if value is None else put(value),
        None if take is None else lambda value, where: None if value is None else take(value, where),
    )


_PAIRS: tuple[tuple[type, Callable[[Any], Pair]], ...] = (
    (RecordKind, _nested_pair),
    (ArrayKind, _array_pair),
    (RowsKind, _rows_pair),
    (EnumKind, _enum_pair),
    (TupleKind, _tuple_pair),
    (FixedTupleKind, _fixed_pair),
    (MapKind, _map_pair),
    (OptionalKind, _optional_pair),
    (DateTimeKind, lambda _: (datetime_ns, None)),
)
