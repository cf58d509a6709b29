"""Which number comes next behind a stem, the lowest that is free; it asks who has a name and gives none away itself.

Ten thousand "event0", "event1", ... must not be counted through for each new one, and a number that became free is
used again. So all numbers below `_Stem.top` are in use or stand in a heap of those that were given up.
"""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush


class _Stem:
    """What is known about the numbers behind one stem."""

    __slots__ = ("first", "free", "heap", "top")

    def __init__(self, first: int) -> None:
        self.first = self.top = first
        self.free: set[int] = set()
        """Numbers below `top` that were given up; who took one since by its very name is not known here."""
        self.heap: list[int] = []
        """The same numbers, lowest first, and some that are in the set no more."""


class Numbering:
    """The lowest free number behind each stem, in about constant time.

    `taken` says whether a name is in use; whoever gives one up says so to `free`.
    """

    __slots__ = ("_stems", "_taken")

    def __init__(self, taken: Callable[[str], bool]) -> None:
        self._taken = taken
        self._stems: dict[str, _Stem] = {}

    def lowest(self, stem: str, first: int = 0) -> str:
        """`stem` with the lowest number, from `first` on, that makes a free name."""
        numbers = self._stems.get(stem)
        if numbers is None:
            numbers = self._stems[stem] = _Stem(first)
        heap, free = numbers.heap, numbers.free
        while heap:
            name = f"{stem}{heap[0]}"
            if heap[0] in free and not self._taken(name):
                return name
            free.discard(heappop(heap))
        while self._taken(name := f"{stem}{numbers.top}"):
            numbers.top += 1
        return name

    def free(self, name: str) -> None:
        """Nobody has this name any more."""
        digits = len(name) - len(name.rstrip("0123456789"))
        # "n10" is number 10 of "n" and number 0 of "n1".
        for count in range(1, digits + 1):
            text = name[-count:]
            if text[0] == "0" and count > 1:
                continue
            stem = name[:-count]
            numbers = self._stems.get(stem)
            if numbers is not None:
                self._give_up(stem, numbers, int(text))

    def _give_up(self, stem: str, numbers: _Stem, number: int) -> None:
        free = numbers.free
        if not numbers.first <= number < numbers.top or number in free:
            return
        if number < numbers.top - 1:
            heappush(numbers.heap, number)
            free.add(number)
            return
        numbers.top -= 1
        while numbers.top - 1 in free and not self._taken(f"{stem}{numbers.top - 1}"):
            numbers.top -= 1
            free.discard(numbers.top)
        if numbers.top == numbers.first:
            del self._stems[stem]
