"""`Time`: a moment since the epoch as seconds and nanoseconds, always normalised, with exact arithmetic.

Records carry their time stamp as one integer (`tm`, nanoseconds); `Time` is for fields that are times themselves.
"""

from __future__ import annotations

# Annotations are read at run time.
import math

from aiorts.errors import RecordError
from aiorts.types.kinds import NS_PER_SEC, SCALARS
from aiorts.types.record import record
from aiorts.types.spelling import u32


@record
class Time:
    """A moment: 0 <= sec < 2**32, 0 <= nsec < 10**9. An nsec of a second or more is refused, not carried over."""

    sec: u32 = 0
    nsec: u32 = 0

    def __post_init__(self) -> None:
        if self.nsec >= NS_PER_SEC:
            raise RecordError(f"Time.nsec: expected 0..999999999, got {self.nsec}; Time.from_ns carries over")

    @classmethod
    def from_ns(cls, ns: int) -> Time:
        """The moment so many nanoseconds after the epoch; RecordError outside 0 <= ns < 2**32 s."""
        sec, nsec = divmod(SCALARS["stamp"].check(ns, "Time"), NS_PER_SEC)
        return cls(sec, nsec)

    @classmethod
    def from_seconds(cls, seconds: float) -> Time:
        """The moment so many seconds after the epoch, rounded to the nearest nanosecond; RecordError as `from_ns`."""
        if not math.isfinite(seconds):
            raise RecordError(f"Time: expected a finite number of seconds, got {seconds}")
        whole = math.floor(seconds)
        return cls.from_ns(whole * NS_PER_SEC + round((seconds - whole) * NS_PER_SEC))

    @property
    def ns(self) -> int:
        """Nanoseconds since the epoch."""
        return self.sec * NS_PER_SEC + self.nsec

    def __add__(self, ns: int) -> Time:
        """The moment `ns` nanoseconds later; RecordError if that is out of range."""
        return Time.from_ns(self.ns + ns) if isinstance(ns, int) else NotImplemented

    def __sub__(self, other: Time) -> int:
        """Nanoseconds from `other` to this moment, negative if `other` is later."""
        return self.ns - other.ns if isinstance(other, Time) else NotImplemented

    def __lt__(self, other: Time) -> bool:
        return self.ns < other.ns if isinstance(other, Time) else NotImplemented

    def __le__(self, other: Time) -> bool:
        return self.ns <= other.ns if isinstance(other, Time) else NotImplemented

    def __gt__(self, other: Time) -> bool:
        return self.ns > other.ns if isinstance(other, Time) else NotImplemented

    def __ge__(self, other: Time) -> bool:
        return self.ns >= other.ns if isinstance(other, Time) else NotImplemented
