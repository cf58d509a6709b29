"""Records invented from their type alone, the same ones in every run: hard values first, then random ones."""

from __future__ import annotations

import math
import random
import struct
from enum import Enum
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import RecordError
from aiorts.types import all_types, fields_of
from aiorts.types.arrays import ArrayKind, NDArrayKind
from aiorts.types.kinds import (
    BoolKind,
    BytesKind,
    DateTimeKind,
    EnumKind,
    FloatKind,
    IntKind,
    Kind,
    LiteralKind,
    OptionalKind,
    StampKind,
    TextKind,
)
from aiorts.types.nested import RecordKind
from aiorts.types.rows import FixedTupleKind, MapKind, RowsKind, TupleKind

if TYPE_CHECKING:
    from collections.abc import Iterator

HARD_FLOATS: Final = (
    -0.0,
    math.inf,
    -math.inf,
    struct.unpack("<d", bytes.fromhex("efbeadde0000f87f"))[0],  # a quiet NaN with a payload
    struct.unpack("<d", bytes.fromhex("010000000000f8ff"))[0],  # a negative one
    5e-324,
    1.7976931348623157e308,
    0.1,
)
_TRIES: Final = 20
_TEXTS: Final = ("", "a", "\0", "äöü", "日本語", "\U0001f916", "a\nb", "x" * 300)
_ELEMENTS: Final = ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8")


def record_types() -> Iterator[type]:
    """Every known record type that comes with aiorts, in order of definition."""
    for name, cls in tuple(all_types().items()):
        if name.startswith("aiorts.types.") and not issubclass(cls, Enum):
            yield cls


def invent(cls: type, dice: random.Random) -> Any:
    """A record of `cls` with invented fields; if the class has rules of its own, the record keeps them."""
    for _ in range(_TRIES):
        try:
            return cls(**{field.name: _value(field.kind, dice) for field in fields_of(cls)})
        except RecordError:
            continue
    return cls()


def _value(kind: Kind, dice: random.Random) -> Any:
    for sort, make in _MAKERS:
        if isinstance(kind, sort):
            return make(kind, dice)
    raise TypeError(f"no values are known for a field of kind {kind!r}")


def _float(kind: Any, dice: random.Random) -> float:
    value = dice.choice((*HARD_FLOATS, dice.uniform(-1e6, 1e6)))
    # A float32 field refuses what it cannot hold; its NaNs are shorter.
    return dice.choice((-0.0, math.inf, 0.5, 1e-40)) if kind.single else value


def _text(kind: Any, dice: random.Random) -> str:
    if kind.limit is not None:
        return dice.choice(("\0", "a", "\xff" if kind.limit == 0xFF else "日"))
    return dice.choice(_TEXTS)


def _array(element: str, shape: tuple[int, ...], dice: random.Random) -> Any:
    import numpy as np

    dtype = np.dtype(element)
    count = math.prod(shape)
    data = dice.randbytes(count * dtype.itemsize)
    array = np.frombuffer(data, dtype) if dtype.kind != "b" else np.frombuffer(data, "u1") & 1 == 1
    return array.reshape(shape).copy()


_DTYPES: Final = {"bool": "?", **{f"{sign}{bits}": f"{sign}{bits // 8}" for sign in "iuf" for bits in (8, 16, 32, 64)}}


def _ndarray(kind: Any, dice: random.Random) -> Any:
    element = _DTYPES[kind.element] if kind.element else dice.choice(_ELEMENTS)
    return _array(element, dice.choice(((0,), (3, 0), (2, 3), (2, 1, 4), (5,))), dice)


def _map(kind: Any, dice: random.Random) -> dict[str, Any]:
    if kind.entries:
        return {f"key{number}": _value(dice.choice(kind.entries), dice) for number in range(dice.choice((0, 1, 3)))}
    entries = {"bool": True, "int": -5, "float": -0.0, "text": "ä", "bytes": b"\x00", "array": _array("f8", (4,), dice)}
    entries["map"] = {"inner": dict(entries), "float": 0.5, "map": {}}
    return {key: entries[key] for key in dice.sample(sorted(entries), dice.randint(0, len(entries)))}


_MAKERS: Final[tuple[tuple[type, Any], ...]] = (
    (StampKind, lambda _, dice: dice.choice((0, 1, 1_700_000_000_123_456_789, 2**32 * 10**9 - 1))),
    (IntKind, lambda kind, dice: dice.choice((kind.low, kind.high, 0, dice.randint(kind.low, kind.high)))),
    (FloatKind, _float),
    (BoolKind, lambda _, dice: dice.random() < 0.5),
    (TextKind, _text),
    (BytesKind, lambda _, dice: dice.randbytes(dice.choice((0, 1, 300)))),
    (EnumKind, lambda kind, dice: dice.choice(list(kind.enumeration))),
    (OptionalKind, lambda kind, dice: _value(kind.inner, dice) if dice.random() < 0.7 else None),
    (LiteralKind, lambda kind, dice: dice.choice(kind.choices)),
    (DateTimeKind, lambda _, dice: dice.choice((0, -1000, 2**63 // 1000 * 1000, 1_700_000_000_123_456_000))),
    (RecordKind, lambda kind, dice: invent(kind.cls, dice)),
    (MapKind, _map),
    (RowsKind, lambda kind, dice: [invent(kind.cls, dice) for _ in range(dice.choice((0, 1, 3)))]),
    (FixedTupleKind, lambda kind, dice: tuple(_value(item, dice) for item in kind.items)),
    (TupleKind, lambda kind, dice: [_value(kind.item, dice) for _ in range(dice.choice((0, 1, 3)))]),
    (NDArrayKind, _ndarray),
    (ArrayKind, lambda kind, dice: _array(_DTYPES[kind.element], (dice.choice((0, 1, 7, 300)),), dice)),
)
"""The kinds of fields, each with a function that invents a value; the first that fits is used, derived ones first."""
