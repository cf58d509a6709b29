"""How much the clock of another machine is ahead of this one's. It asks no clock; stamps are never changed by it.

A question has the time of this clock when it was asked and when it was answered, and its answer the other's time in
between: so the offset is that at the middle, and it is off by half of the round trip at the most.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

LAST: Final = 32
"""Round trips that are kept."""
DRIFT: Final = 100e-6
"""How much faster or slower one clock may be than the other."""


class Offset(NamedTuple):
    """What the other clock shows more than this one, at a time of this one."""

    ahead_ns: int
    within_ns: int
    """How far `ahead_ns` may be off."""


class _Trip(NamedTuple):
    asked_ns: int
    ahead_ns: int
    half_ns: int

    def at(self, now_ns: int) -> Offset:
        return Offset(self.ahead_ns, self.half_ns + round(DRIFT * abs(now_ns - self.asked_ns)))


class ClockOffset:
    """The offset to one other clock, by the shortest of the last round trips; the older, the less exact."""

    def __init__(self) -> None:
        self._trips: deque[_Trip] = deque(maxlen=LAST)

    def add(self, asked_ns: int, theirs_ns: int, answered_ns: int) -> None:
        """A round trip; what was known before is forgotten where it cannot be true any more: a clock was set."""
        half = (answered_ns - asked_ns + 1) // 2
        if half < 0:
            return  # this clock was set in between
        trip = _Trip(asked_ns, theirs_ns - asked_ns - half, half)
        before = self.at(answered_ns)
        if (
            before is not None
            and abs(trip.ahead_ns - before.ahead_ns) > before.within_ns + trip.at(answered_ns).within_ns
        ):
            self._trips.clear()
        self._trips.append(trip)

    def at(self, now_ns: int) -> Offset | None:
        """What is known now; None: nothing was asked yet."""
        return min((trip.at(now_ns) for trip in self._trips), key=lambda offset: offset.within_ns, default=None)
