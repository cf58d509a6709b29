"""Records that OpenRTM does not have: 64-bit integers, arrays of any shape, maps."""

from __future__ import annotations

# Annotations are read at run time.
from typing import Any

from aiorts.types.record import Stamped, record
from aiorts.types.spelling import EMPTY, Array, Map, NDArray, i64, u64

__all__ = (
    "TimedLongLong",
    "TimedLongLongSeq",
    "TimedMap",
    "TimedNDArray",
    "TimedULongLong",
    "TimedULongLongSeq",
)

NO_ENTRIES: Any = {}


@record
class TimedLongLong(Stamped):
    """An integer of 64 bits, signed."""

    tm: int = 0
    data: i64 = 0


@record
class TimedLongLongSeq(Stamped):
    """A read-only numpy array of i64 numbers."""

    tm: int = 0
    data: Array[i64] = EMPTY


@record
class TimedULongLong(Stamped):
    """An integer of 64 bits, unsigned."""

    tm: int = 0
    data: u64 = 0


@record
class TimedULongLongSeq(Stamped):
    """A read-only numpy array of u64 numbers."""

    tm: int = 0
    data: Array[u64] = EMPTY


@record
class TimedNDArray(Stamped):
    """A read-only numpy array of up to 8 dimensions: bool, i8-i64, u8-u64, f16-f64, c64, c128."""

    tm: int = 0
    data: NDArray = EMPTY


@record
class TimedMap(Stamped):
    """A read-only mapping of text to bool, int, float, text, bytes or array."""

    tm: int = 0
    data: Map = NO_ENTRIES
