"""The 25 basic records of OpenRTM: a time stamp `tm` (nanoseconds since the epoch) and `data`."""

from __future__ import annotations

# Annotations are read at run time.
from aiorts.types.record import Stamped, record
from aiorts.types.spelling import EMPTY, Array, Seq, char, f32, f64, i16, i32, u8, u16, u32, wchar, wstr

__all__ = (
    "TimedState",
    "TimedShort",
    "TimedShortSeq",
    "TimedLong",
    "TimedLongSeq",
    "TimedUShort",
    "TimedUShortSeq",
    "TimedULong",
    "TimedULongSeq",
    "TimedFloat",
    "TimedFloatSeq",
    "TimedDouble",
    "TimedDoubleSeq",
    "TimedChar",
    "TimedCharSeq",
    "TimedWChar",
    "TimedWCharSeq",
    "TimedBoolean",
    "TimedBooleanSeq",
    "TimedOctet",
    "TimedOctetSeq",
    "TimedString",
    "TimedStringSeq",
    "TimedWString",
    "TimedWStringSeq",
)


@record
class TimedState(Stamped):
    """A state number, 16 bits signed."""

    tm: int = 0
    data: i16 = 0


@record
class TimedShort(Stamped):
    """An integer of 16 bits, signed."""

    tm: int = 0
    data: i16 = 0


@record
class TimedShortSeq(Stamped):
    """A read-only numpy array of i16 numbers."""

    tm: int = 0
    data: Array[i16] = EMPTY


@record
class TimedLong(Stamped):
    """An integer of 32 bits, signed."""

    tm: int = 0
    data: i32 = 0


@record
class TimedLongSeq(Stamped):
    """A read-only numpy array of i32 numbers."""

    tm: int = 0
    data: Array[i32] = EMPTY


@record
class TimedUShort(Stamped):
    """An integer of 16 bits, unsigned."""

    tm: int = 0
    data: u16 = 0


@record
class TimedUShortSeq(Stamped):
    """A read-only numpy array of u16 numbers."""

    tm: int = 0
    data: Array[u16] = EMPTY


@record
class TimedULong(Stamped):
    """An integer of 32 bits, unsigned."""

    tm: int = 0
    data: u32 = 0


@record
class TimedULongSeq(Stamped):
    """A read-only numpy array of u32 numbers."""

    tm: int = 0
    data: Array[u32] = EMPTY


@record
class TimedFloat(Stamped):
    """A 32-bit float: the nearest one to what was given."""

    tm: int = 0
    data: f32 = 0.0


@record
class TimedFloatSeq(Stamped):
    """A read-only numpy array of f32 numbers."""

    tm: int = 0
    data: Array[f32] = EMPTY


@record
class TimedDouble(Stamped):
    """A 64-bit float."""

    tm: int = 0
    data: f64 = 0.0


@record
class TimedDoubleSeq(Stamped):
    """A read-only numpy array of f64 numbers."""

    tm: int = 0
    data: Array[f64] = EMPTY


@record
class TimedChar(Stamped):
    """One character of 8 bits (Latin-1)."""

    tm: int = 0
    data: char = "\0"


@record
class TimedCharSeq(Stamped):
    """A tuple of 8-bit characters."""

    tm: int = 0
    data: Seq[char] = EMPTY


@record
class TimedWChar(Stamped):
    """One character, any of Unicode."""

    tm: int = 0
    data: wchar = "\0"


@record
class TimedWCharSeq(Stamped):
    """A tuple of characters."""

    tm: int = 0
    data: Seq[wchar] = EMPTY


@record
class TimedBoolean(Stamped):
    """True or False."""

    tm: int = 0
    data: bool = False


@record
class TimedBooleanSeq(Stamped):
    """A read-only numpy array of truth values."""

    tm: int = 0
    data: Array[bool] = EMPTY


@record
class TimedOctet(Stamped):
    """One byte, 0..255."""

    tm: int = 0
    data: u8 = 0


@record
class TimedOctetSeq(Stamped):
    """A read-only numpy array of bytes; `bytes` are taken without a copy."""

    tm: int = 0
    data: Array[u8] = EMPTY


@record
class TimedString(Stamped):
    """Text."""

    tm: int = 0
    data: str = ""


@record
class TimedStringSeq(Stamped):
    """A tuple of texts."""

    tm: int = 0
    data: Seq[str] = EMPTY


@record
class TimedWString(Stamped):
    """Text; the same as TimedString, kept because OpenRTM has two kinds."""

    tm: int = 0
    data: wstr = ""


@record
class TimedWStringSeq(Stamped):
    """A tuple of texts."""

    tm: int = 0
    data: Seq[wstr] = EMPTY
