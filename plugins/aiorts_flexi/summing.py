"""Adds samples of one type, member by member; made once for a type, it never waits and keeps no samples.

Integers are added exactly and then compared with the limits of their field, floats in the order of the inputs. Two
sequences are added item by item and must have one length. Members without a sum (text, truth values, characters,
enumerations, maps, arrays of any shape) are refused when the type becomes known, not when a sample arrives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

from aiorts.errors import ConfigurationError, ConversionError
from aiorts.types import Field, convert, describe, has_tm

_LARGEST: Final = math.nextafter(math.inf, 0.0)
_INTEGERS: Final = ("i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64")
_FLOATS: Final = ("f32", "f64")
_WIDE: Final = ("i64", "u64")
"""Integers whose sum may exceed the widest integer of an array."""
_PLAIN: Final[dict[type, str]] = {int: "i64", float: "f64"}
_REASONS: Final = {
    "bool": "truth values have no sum; convert them to integers with a FlexiFilter",
    "str": "texts have no sum",
    "char": "characters have no sum",
    "wchar": "characters have no sum",
    "bytes": "bytes of no fixed meaning have no sum",
    "map": "the entries of a map have no fixed type",
    "ndarray": "an array of any shape and type has no fixed sum",
    "stamp": "times have no sum",
}

Adder: TypeAlias = Callable[[Sequence[Any], Sequence[str], str], Any]
"""A function that adds values: (values, names of their inputs, path of the field) -> sum."""


class Summation:
    """Adds samples of `cls` under an overflow policy: "error", "saturate" or "wrap".

    Raises ConfigurationError, with the field, for a type with a member that has no sum.
    """

    def __init__(self, cls: type[Any], overflow: str) -> None:
        self._cls = cls
        self._overflow = overflow
        self._add: Adder | None = None
        self._fields: list[tuple[str, Adder]] = []
        if cls in _PLAIN:
            self._add = self._scalar(_PLAIN[cls])
        elif not hasattr(cls, "__dataclass_fields__"):
            raise ConfigurationError(f"{cls.__name__}: {_reason(cls.__name__)}")
        else:
            self._fields = self._adders(cls, cls.__name__, top=True)
            if not self._fields:
                raise ConfigurationError(f"{cls.__name__}: has no member that could be added")

    def __call__(self, samples: Sequence[Any], names: Sequence[str], tm: int) -> Any:
        """The sum of these samples, of the inputs with these names, stamped `tm` where the type has a time.

        Raises:
            ConversionError: two sequences differ in length, or the field cannot hold the sum; the field is named.
        """
        if self._add is not None:
            return self._add(samples, names, self._cls.__name__)
        values = {name: add([getattr(s, name) for s in samples], names, name) for name, add in self._fields}
        return self._cls(tm=tm, **values) if has_tm(self._cls) else self._cls(**values)

    # -- adders of each kind of field --------------------------------------------------------------------------------

    def _adders(self, cls: type[Any], path: str, *, top: bool = False) -> list[tuple[str, Adder]]:
        return [
            (field.name, self._adder(field, f"{path}.{field.name}"))
            for field in describe(cls).fields
            if not (top and has_tm(cls) and field.name == "tm")
        ]

    def _adder(self, field: Field, path: str) -> Adder:
        spelling = field.spelling
        sequence = spelling.startswith("seq[") and spelling.endswith("]")
        if field.record is not None:
            add = self._record(field.record, path)
            return self._rows(add) if sequence else add
        element = spelling[4:-1] if sequence else spelling
        if element not in (*_INTEGERS, *_FLOATS):
            raise ConfigurationError(f"{path}: {_reason(element)}")
        return self._array(element) if sequence else self._scalar(element)

    def _scalar(self, element: str) -> Adder:
        def add(values: Sequence[Any], names: Sequence[str], path: str) -> Any:
            total = sum(values) if element in _INTEGERS else self._float_sum(values, path)
            return self._fitted(total, element, path)

        return add

    def _array(self, element: str) -> Adder:
        def add(values: Sequence[Any], names: Sequence[str], path: str) -> Any:
            _check_lengths(values, names, path)
            if element in _WIDE:
                total: Any = [sum(items) for items in zip(*(value.tolist() for value in values), strict=True)]
            elif element in _FLOATS:
                total = self._float_arrays(values, path)
            else:
                total = sum(value.astype("i8") for value in values)
            return self._fitted(total, f"seq[{element}]", path)

        return add

    def _record(self, cls: type[Any], path: str) -> Adder:
        fields = self._adders(cls, path)

        def add(values: Sequence[Any], names: Sequence[str], path: str) -> Any:
            return cls(**{n: add([getattr(v, n) for v in values], names, f"{path}.{n}") for n, add in fields})

        return add

    def _rows(self, add_one: Adder) -> Adder:
        def add(values: Sequence[Any], names: Sequence[str], path: str) -> Any:
            _check_lengths(values, names, path)
            rows = enumerate(zip(*values, strict=True))
            return [add_one(items, names, f"{path}[{index}]") for index, items in rows]

        return add

    # -- sums out of range ---------------------------------------------------------------------------------------------

    def _fitted(self, total: Any, kind: str, path: str) -> Any:
        try:
            return convert(total, kind, overflow=self._overflow)
        except ConversionError as error:
            raise ConversionError(f"sum of {path}: {error}") from None

    def _float_sum(self, values: Sequence[float], path: str) -> float:
        total = 0.0
        for value in values:
            total += value
        if math.isinf(total) and all(map(math.isfinite, values)):
            return self._overflowed(total, path)
        return total

    def _float_arrays(self, values: Sequence[Any], path: str) -> Any:
        import numpy as np

        with np.errstate(over="ignore", invalid="ignore"):
            total = np.zeros(len(values[0]), dtype="f8")
            for value in values:
                total = total + value.astype("f8")
        beyond = np.isinf(total) & np.all([np.isfinite(value) for value in values], axis=0)
        if beyond.any():
            first = int(beyond.argmax())
            limit = self._overflowed(float(total[first]), f"{path}[{first}]")
            if math.isfinite(limit):
                total[beyond] = np.copysign(limit, total[beyond])
        return total

    def _overflowed(self, total: float, path: str) -> float:
        if self._overflow == "error":
            raise ConversionError(f"sum of {path}: is too large for a number of 64 bits; see overflow")
        return math.copysign(_LARGEST, total) if self._overflow == "saturate" else total


def _check_lengths(values: Sequence[Any], names: Sequence[str], path: str) -> None:
    for value, name in zip(values, names, strict=True):
        if len(value) != len(values[0]):
            raise ConversionError(
                f"sum of {path}: {names[0]} has {len(values[0])} items and {name} has {len(value)}; "
                "only sequences of one length can be added"
            )


def _reason(element: str) -> str:
    return _REASONS.get(element, f"values of {element} have no sum")
