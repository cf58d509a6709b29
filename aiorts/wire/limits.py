"""The limits of a frame's size and contents, which hold before anything is allocated for it."""

from __future__ import annotations

from aiorts.late import dataclass

KIB = 1024
MIB = 1024 * KIB


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one frame, checked when it is written and read: `frame` and `string` in bytes, others in number."""

    frame: int = 64 * MIB
    string: int = 1 * MIB
    values: int = 65_536
    """Values in the whole frame: each scalar, key, list and map is one, an array is one however large."""
    length: int = 65_536
    """Items of one list or map."""
    parts: int = 64
    """Buffers that travel with the head of a frame; `frame` limits head and buffers together."""
    head: int = 64 * MIB
    """Bytes of the head of a frame with parts: texts, small arrays, all that is no part."""

    def __post_init__(self) -> None:
        for name in ("frame", "string", "values", "length", "parts", "head"):
            limit = getattr(self, name)
            # Texts of up to 31 bytes are not measured one by one: they can do no harm.
            least = 32 if name == "string" else 1
            if type(limit) is not int or not least <= limit < 2**31:
                raise ValueError(f"Limits.{name}: expected an integer {least}..2147483647, got {limit!r}")


DATA = Limits()
"""The limits of samples."""
CONTROL = Limits(frame=64 * KIB, string=64 * KIB, length=64)
"""Smaller limits, for short messages."""
LINK = Limits(values=4_096, length=4_096, head=2 * MIB)
"""Smaller limits, for frames of another kernel, so that a bomb does not hold up the loop: it is refused in 10 ms.

A frame that is no bomb takes 1 us a value for texts, up to 4 ms for a MiB of them, 3 us for arrays without elements,
and 4 us for a record of a plain dataclass, however deep it lies in others: at most some 10 ms.
"""
