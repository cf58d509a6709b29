"""Limits repeated log lines of one kind: the first at once, the next at growing intervals, with the number left out."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

from aiorts.kernel.loop import distances

_NS: Final = 1_000_000_000
_MOST: Final = 256
"""The most kinds that are remembered; beyond, the kind that was asked about longest ago is forgotten."""


class Rarely:
    """Decides when a repeated line is logged. Times are nanoseconds of any clock that never goes back."""

    def __init__(self) -> None:
        self._said: dict[Hashable, tuple[int, int, int]] = {}
        """By kind of line: when it was logged last, the seconds to the next time, and how many were left out since."""

    def left_out(self, what: Hashable, now_ns: int) -> int | None:
        """Decide on a line: returns how often it was left out before, if it is to be logged now; None: leave it out.

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
