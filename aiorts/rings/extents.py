"""The bytes of a ring that are taken. This file only decides; it holds no descriptor and no memory."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Final

STEP: Final = 64
"""Extents begin at multiples of this: a line of the processor's cache, and enough for every element of an array."""


class Extents:
    """A stretch of bytes, of which parts are taken and given back in any order.

    The lowest place that is long enough is taken, so that what was used a moment ago, and is in the processor's cache
    and mapped, is used again.

    Args:
        size: its bytes, a multiple of `STEP`.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._free: list[tuple[int, int]] = [(0, size)]
        """(start, end) of each free extent, in order; neighbouring extents are merged."""
        self._taken: dict[int, int] = {}
        """The end of each extent, by its start."""

    @property
    def count(self) -> int:
        """Extents that are taken."""
        return len(self._taken)

    def take(self, length: int) -> int | None:
        """Take this many free bytes; returns their start, or None if there is no room."""
        room = max(length + -length % STEP, STEP)
        for place, (start, end) in enumerate(self._free):
            if end - start >= room:
                if end - start == room:
                    del self._free[place]
                else:
                    self._free[place] = (start + room, end)
                self._taken[start] = start + room
                return start
        return None

    def claim(self, start: int, length: int) -> bool:
        """Take these bytes; False: some of them are taken already, or outside the stretch."""
        end = start + max(length + -length % STEP, STEP)
        place = bisect_right(self._free, (start, self.size)) - 1
        if start % STEP or place < 0:
            return False
        left, right = self._free[place]
        if start < left or end > right:
            return False
        self._free[place : place + 1] = [one for one in ((left, start), (end, right)) if one[0] < one[1]]
        self._taken[start] = end
        return True

    def give(self, start: int) -> bool:
        """Give back the extent taken at `start`; False: no extent was taken there."""
        end = self._taken.pop(start, None)
        if end is None:
            return False
        free = self._free
        place = bisect_left(free, (start,))
        if place < len(free) and free[place][0] == end:
            end = free.pop(place)[1]
        if place and free[place - 1][1] == start:
            place -= 1
            start = free.pop(place)[0]
        free.insert(place, (start, end))
        return True
