"""The lateness of a context's cycles: statistics over all of them, and the last ones themselves. No clock is asked."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Mapping
from copy import copy
from operator import mul
from typing import Final

from aiorts.model.timing import percentile

KEPT: Final = 1000
"""The number of last cycles that are kept, over which percentiles are exact."""


class Lateness:
    """The lateness of the cycles added so far, in nanoseconds."""

    __slots__ = ("_buckets", "_count", "_last", "_squares", "max_ns", "total_ns")

    def __init__(self) -> None:
        self.total_ns = self.max_ns = 0
        self._count = self._squares = 0
        self._last = array("q")
        self._buckets: Counter[int] = Counter()

    def add(self, cycles: array[int]) -> None:
        """Add the lateness of further cycles. The work for each of them is done outside Python code."""
        if cycles:
            self._count += len(cycles)
            self.total_ns += sum(cycles)
            self.max_ns = max(self.max_ns, max(cycles))
            self._squares += sum(map(mul, cycles, cycles))
            self._buckets.update(map(int.bit_length, cycles))
            self._last.extend(cycles)
            del self._last[:-KEPT]

    def with_these(self, cycles: array[int]) -> Lateness:
        """A copy with further cycles; this one stays as it is."""
        made = copy(self)
        made._last, made._buckets = copy(self._last), copy(self._buckets)
        made.add(cycles)
        return made

    @property
    def stdev_ns(self) -> float:
        """The standard deviation over all cycles."""
        count = self._count
        return math.sqrt(count * self._squares - self.total_ns**2) / count if count else 0.0

    def percentiles(self, *percents: int) -> tuple[int, ...]:
        """The lateness that so many percent of the last cycles did not exceed; 0 without cycles."""
        ordered = sorted(self._last) or [0]
        return tuple(percentile(ordered, percent) for percent in percents)

    @property
    def histogram(self) -> Mapping[int, int]:
        """The number of cycles by the smallest power of two above their lateness."""
        return {1 << bits: self._buckets[bits] for bits in sorted(self._buckets)}
