"""Estimates by how much another machine's clock is ahead of this one's. Reads no clock, and never changes stamps.

A round trip gives three times: this clock's when the question is sent and when the answer comes, and the other clock's
in between. The offset is taken at the middle of the round trip, and its error is at most half of the round trip.
"""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

LAST: Final = 32
"""The most round trips that are kept."""
DRIFT: Final = 100e-6
"""The most by which one clock is faster or slower than the other, as a part of the time."""


class Offset(NamedTuple):
    """By how much the other clock is ahead of this one, at a time of this clock."""

    ahead_ns: int
    within_ns: int
    """The possible error of `ahead_ns`."""


class _Trip(NamedTuple):
    asked_ns: int
    ahead_ns: int
    half_ns: int

    def at(self, now_ns: int) -> Offset:
        return Offset(self.ahead_ns, self.half_ns + round(DRIFT * abs(now_ns - self.asked_ns)))


class ClockOffset:
    """The offset to one other clock, by the shortest of the last round trips; an older one counts as less exact."""

    def __init__(self) -> None:
        self._trips: deque[_Trip] = deque(maxlen=LAST)

    def add(self, asked_ns: int, theirs_ns: int, answered_ns: int) -> None:
        """Add a round trip. Earlier round trips are forgotten if they contradict it: a clock was set."""
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
        """The offset by the best round trip at this time; None: there was no round trip yet."""
        return min((trip.at(now_ns) for trip in self._trips), key=lambda offset: offset.within_ns, default=None)
