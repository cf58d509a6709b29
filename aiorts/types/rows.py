"""Sequences of records: tuples, or, when all leaves have one element type, one (n, k) array with record views.

`RecordArray` keeps no records: it makes a record on access, so that a point cloud of 10^5 points is one object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from operator import is_
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from aiorts.errors import RecordError
from aiorts.types.arrays import NDArrayKind, as_array, exact, freeze, same_array
from aiorts.types.kinds import SCALARS, Kind, shown, wrong_type

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

T = TypeVar("T")


class RecordArray(Sequence[T], Generic[T]):
    """`n` records as one read-only array of shape (n, k), a column for each leaf in order of declaration.

    `rows[i]` makes the record of row i, `rows[a:b]` a `RecordArray` of these rows; `rows.array` is the array itself.
    """

    __slots__ = ("_kind", "array")

    array: npt.NDArray[Any]

    def __init__(self, kind: RowsKind, array: npt.NDArray[Any]) -> None:
        object.__setattr__(self, "_kind", kind)
        object.__setattr__(self, "array", array)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"RecordArray.{name}: records are immutable; build a new array")

    @property
    def type(self) -> type[T]:
        """The record type of a row."""
        return self._kind.cls  # type: ignore[attr-defined,no-any-return]

    @property
    def columns(self) -> tuple[str, ...]:
        """The path of each column, such as "point.x"."""
        return self._kind.columns  # type: ignore[attr-defined,no-any-return]

    def __len__(self) -> int:
        return len(self.array)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> RecordArray[T]: ...
    def __getitem__(self, index: int | slice) -> T | RecordArray[T]:
        kind: RowsKind = self._kind  # type: ignore[attr-defined]
        if isinstance(index, slice):
            return RecordArray(kind, self.array[index])
        return kind.build(self.array[index].tolist())  # type: ignore[no-any-return]

    def __iter__(self) -> Iterator[T]:
        build = self._kind.build  # type: ignore[attr-defined]
        # Rows are read in blocks: single rows cost a numpy call each, and all rows at once need a list of everything.
        for start in range(0, len(self.array), 1024):
            for row in self.array[start : start + 1024].tolist():
                yield build(row)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, RecordArray):
            return self.type is other.type and same_array(self.array, other.array)
        if isinstance(other, tuple):
            return len(self) == len(other) and all(left == right for left, right in zip(self, other, strict=True))
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return (_rebuild, (self.type, self.array))

    def __copy__(self) -> RecordArray[T]:
        return self

    def __deepcopy__(self, memo: object) -> RecordArray[T]:
        return self

    def __repr__(self) -> str:
        head = ", ".join(repr(record) for record in self[:3])
        return f"[{head}{', ...' if len(self) > 3 else ''}]" + (f" ({len(self)} rows)" if len(self) > 3 else "")


def _rebuild(cls: Any, array: Any) -> RecordArray[Any]:
    from aiorts.types.structure import sequence_kind

    return sequence_kind(cls).check(array, cls.__name__)  # type: ignore[no-any-return]


class RowsKind(Kind):
    """Sequence of records with one element type throughout."""

    def __init__(
        self,
        cls: type,
        element: str,
        columns: tuple[str, ...],
        build: Callable[[Sequence[Any]], Any],
        flatten: Callable[[Any], list[Any]],
    ) -> None:
        self.cls, self.element, self.columns, self.build, self.flatten = cls, element, columns, build, flatten
        self.spelling = f"seq[{cls.__name__}]"

    def check(self, value: Any, where: str) -> RecordArray[Any]:
        if isinstance(value, RecordArray):
            if value.type is not self.cls:
                raise wrong_type(where, f"a sequence of {self.cls.__name__}", value)
            owned = freeze(value.array)
            return value if owned is value.array else RecordArray(self, owned)
        return RecordArray(self, self._array(value, where))

    def _array(self, value: Any, where: str) -> npt.NDArray[np.generic]:
        width = len(self.columns)
        assert self.element is not None  # noqa: S101 - every RowsKind is built with one
        if hasattr(value, "__array__") or isinstance(value, memoryview):
            array = exact(as_array(value, self.element, where), self.element, where)
            if array.ndim != 2 or array.shape[1] != width:
                columns = ", ".join(self.columns)
                raise RecordError(f"{where}: expected shape (n, {width}), columns {columns}; got {array.shape}")
            return freeze(array)
        rows = [self.flatten(record) for record in _records(value, self.cls, where)]
        return freeze(_matrix(rows, width, self.element))

    def zero(self) -> Any:
        return ()

    def hashed(self, value: Any) -> Any:
        raise TypeError("a record that holds an array cannot be hashed")


def _matrix(rows: list[list[Any]], width: int, element: str) -> npt.NDArray[np.generic]:
    import numpy as np

    from aiorts.types.arrays import DTYPES

    return np.array(rows, dtype=DTYPES[element]) if rows else np.empty((0, width), dtype=DTYPES[element])


def _records(value: Any, cls: type, where: str) -> Iterator[Any]:
    if not isinstance(value, Iterable) or isinstance(value, (str, bytes, dict)):
        raise wrong_type(where, f"a sequence of {cls.__name__}", value)
    for index, item in enumerate(value):
        if type(item) is not cls:
            raise wrong_type(f"{where}[{index}]", f"a {cls.__name__}", item)
        yield item


class TupleKind(Kind):
    """Any number of items of one kind, as a tuple (for text, enumeration members, records, maps)."""

    def __init__(self, item: Kind, restore: type = tuple) -> None:
        self.item, self.restore = item, restore
        self.element = item.element
        self.spelling = f"seq[{item.spelling}]"
        self.mutable = restore is list or item.mutable  # type: ignore[misc]

    def check(self, value: Any, where: str) -> tuple[Any, ...]:
        item = self.item
        if type(value) is not list and type(value) is not tuple:
            text_for_text = isinstance(value, str) and getattr(item, "limit", None) is None
            if text_for_text or isinstance(value, (dict, set, frozenset)) or not isinstance(value, Iterable):
                raise wrong_type(where, f"a sequence of {item.spelling}", value)
        exact, check = item.exact, item.check
        kept = tuple(
            [entry if type(entry) is exact else check(entry, f"{where}[{index}]") for index, entry in enumerate(value)]
        )
        return _same_or(value, kept)

    def zero(self) -> tuple[Any, ...]:
        return ()

    def same(self, left: Any, right: Any) -> bool:
        same = self.item.same
        return len(left) == len(right) and all(same(a, b) for a, b in zip(left, right, strict=True))

    def hashed(self, value: Any) -> Any:
        return tuple(map(self.item.hashed, value))


def _same_or(value: Any, kept: tuple[Any, ...]) -> tuple[Any, ...]:
    """The value itself if it is a tuple of the same items as `kept`, which saves a copy; else `kept`."""
    return value if type(value) is tuple and all(map(is_, value, kept)) else kept


class FixedTupleKind(Kind):
    """A tuple with one kind for each place."""

    def __init__(self, items: tuple[Kind, ...]) -> None:
        self.items = items
        self.spelling = f"({', '.join(item.spelling for item in items)})"
        self.mutable = any(item.mutable for item in items)  # type: ignore[misc]

    def check(self, value: Any, where: str) -> tuple[Any, ...]:
        if not isinstance(value, (tuple, list)):
            raise wrong_type(where, f"a tuple of {len(self.items)}", value)
        if len(value) != len(self.items):
            raise RecordError(f"{where}: expected {len(self.items)} items, got {len(value)}")
        pairs = zip(self.items, value, strict=True)
        return _same_or(value, tuple(kind.check(item, f"{where}[{index}]") for index, (kind, item) in enumerate(pairs)))

    def zero(self) -> tuple[Any, ...]:
        return tuple(item.zero() for item in self.items)

    def same(self, left: Any, right: Any) -> bool:
        return all(kind.same(a, b) for kind, a, b in zip(self.items, left, right, strict=True))

    def hashed(self, value: Any) -> Any:
        return tuple(kind.hashed(item) for kind, item in zip(self.items, value, strict=True))


MAP_LEVELS = 16
"""The most levels of maps inside maps: far more than data needs, and a limit for what a frame can nest."""


class MapKind(Kind):
    """Text to bool, int (64 bits), float, text, bytes, array or such a map; kept as a read-only copy.

    Args:
        entries: the kinds that values may have; without any, all these kinds. Only the writer checks them: on the
            wire each value names its type.
    """

    spelling = "map"

    def __init__(self, entries: tuple[Kind, ...] = ()) -> None:
        self.entries = entries

    def check(self, value: Any, where: str) -> Any:
        return self._check(value, where, MAP_LEVELS)

    def _check(self, value: Any, where: str, levels: int) -> Any:
        if not levels:
            raise RecordError(f"{where}: expected at most {MAP_LEVELS} maps within each other, got more")
        if not hasattr(value, "keys") or not hasattr(value, "__getitem__"):
            raise wrong_type(where, "a mapping of text to scalars or arrays", value)
        kept: dict[str, Any] = {}
        declares = bool(self.entries)
        for key in value:
            name = key if type(key) is str and key.isascii() else SCALARS["str"].check(key, f"{where} key")
            entry = value[key]
            if declares:
                entry = self._entry(entry, f"{where}[{shown(key)}]", levels)
            elif not _is_as_it_travels(entry):
                entry = _undeclared(entry, where, key, levels)
            kept[name] = entry
        return MappingProxyType(kept)

    def _entry(self, value: Any, where: str, levels: int) -> Any:
        """The value as checked by a declared kind: that of its own class, else the first that accepts it."""
        for kind in self.entries:
            if kind.exact is type(value):
                return value
        for kind in self.entries:
            try:
                return kind._check(value, where, levels - 1) if isinstance(kind, MapKind) else kind.check(value, where)
            except RecordError:
                if len(self.entries) == 1:
                    raise
        raise wrong_type(where, " or ".join(kind.spelling for kind in self.entries), value)

    def zero(self) -> Any:
        return {}

    def same(self, left: Any, right: Any) -> bool:
        return _same_value(left, right)

    def hashed(self, value: Any) -> Any:
        raise TypeError("a record that holds a map cannot be hashed")


def _undeclared(value: Any, where: str, key: Any, levels: int) -> Any:
    """Check a value of a map that declares no kinds."""
    if type(value).__name__ == "ndarray":
        # The key is added to `where` only if the value is refused, because making that text takes as long as the check.
        with suppress(RecordError):
            return _ARRAY.check(value, where)
    where = f"{where}[{shown(key)}]"
    if isinstance(value, Mapping):
        return _ANY._check(value, where, levels - 1)
    return _entry_kind(value).check(value, where)


def _is_as_it_travels(value: Any) -> bool:
    """Whether a value is a scalar that travels unchanged, so that no kind has to check it."""
    cls = type(value)
    if cls is str:
        return bool(value.isascii())
    return cls is float or cls is bool or cls is bytes or (cls is int and _LOWEST <= value <= _HIGHEST)


_ANY, _ARRAY = MapKind(), NDArrayKind()
_LOWEST, _HIGHEST = -(2**63), 2**64 - 1
_ENTRY = {bool: "bool", int: "i64", float: "f64", str: "str", bytes: "bytes"}


def _entry_kind(value: Any) -> Kind:
    """The kind of an entry of a map that declares no kinds: the kind of the scalar; for any other value, an array."""
    for cls, name in _ENTRY.items():
        if isinstance(value, cls):
            return SCALARS["u64" if name == "i64" and value > SCALARS["i64"].high else name]  # type: ignore[attr-defined]
    return _ARRAY


def as_dict(entries: Any) -> dict[str, Any]:
    """A map as dictionaries that its reader may change."""
    return {key: as_dict(entry) if isinstance(entry, Mapping) else entry for key, entry in entries.items()}


def _same_value(left: Any, right: Any) -> bool:
    if isinstance(left, Mapping):
        same_keys = isinstance(right, Mapping) and left.keys() == right.keys()
        return same_keys and all(_same_value(left[key], right[key]) for key in left)
    if type(left) is not type(right):
        return False
    if hasattr(left, "dtype"):
        return same_array(left, right)
    return bool(left == right or (left != left and right != right))
