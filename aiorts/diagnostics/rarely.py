"""Repeated lines of one thing: the first at once, the next at growing distances, with how often they were left out."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

from aiorts.kernel.loop import distances

_NS: Final = 1_000_000_000
_MOST: Final = 256
"""Things that are known, at most; the one that was asked about longest ago is forgotten."""


class Rarely:
    """Decides when a thing that repeats is said. Time comes as nanoseconds of any clock that never goes back."""

    def __init__(self) -> None:
        self._said: dict[Hashable, tuple[int, int, int]] = {}
        """By thing: when it was said last, the seconds to the next time, and how often it was left out since."""

    def left_out(self, what: Hashable, now_ns: int) -> int | None:
        """Whether to say it now: the count of times it was left out since the last one. None: it is left out again.

        After twice the distance without it, the distance is the first one again.
        """
        at_ns, distance, count = self._said.pop(what, (0, 0, 0))
        if distance and now_ns < at_ns + distance * _NS:
            self._said[what] = at_ns, distance, count + 1
            return None
        goes_on = distance and now_ns < at_ns + 2 * distance * _NS
        self._said[what] = now_ns, distances.longer(distance) if goes_on else distances.FIRST, 0
        if len(self._said) > _MOST:
            del self._said[next(iter(self._said))]
        return count
