"""Spans of time of the last n sends and reads of a connector: how long, how far apart, how old. It asks no clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Sequence
from typing import Self

from aiorts.late import dataclass
from aiorts.model.rates import SpanFigures


@dataclass(frozen=True, slots=True)
class Spans:
    """Count, minimum, maximum, mean, deviation and percentiles of some spans of time; all zero when there is none."""

    count: int = 0
    min_ns: int = 0
    max_ns: int = 0
    mean_ns: float = 0.0
    stdev_ns: float = 0.0
    """Of the population."""
    p50_ns: int = 0
    """The smallest of these spans that at least half of them do not exceed."""
    p99_ns: int = 0
    """The smallest of these spans that at least 99 % of them do not exceed."""

    @property
    def figures(self) -> SpanFigures:
        """Count, median, 99th percentile and maximum."""
        return SpanFigures(self.count, self.p50_ns, self.p99_ns, self.max_ns)

    @classmethod
    def of(cls, spans: Collection[int]) -> Self:
        """What these spans have in common."""
        if not spans:
            return cls()
        ordered = sorted(spans)
        mean = sum(ordered) / len(ordered)
        variance = sum((span - mean) ** 2 for span in ordered) / len(ordered)
        p50, p99 = percentile(ordered, 50), percentile(ordered, 99)
        return cls(len(ordered), ordered[0], ordered[-1], mean, math.sqrt(variance), p50, p99)


def percentile(ordered: Sequence[int], percent: int) -> int:
    """The smallest that at least so many percent of these do not exceed; they are in order and there is one."""
    return ordered[-(-percent * len(ordered) // 100) - 1]


@dataclass(frozen=True, slots=True)
class PublisherTiming:
    """When a connector sent, over its last sends.

    Attributes:
        exec: how long a send took: handing samples to the reader's buffer and waking the reader.
        period: from the beginning of one send to the beginning of the next.
    """

    exec: Spans
    period: Spans


class ConnectorTimes:
    """The last `length` sends and reads of a connector."""

    __slots__ = ("_execs", "_last_ns", "_periods", "ages", "before", "latencies", "since_ns")

    def __init__(self, length: int, since_ns: int = 0, before: int = 0) -> None:
        self.since_ns = since_ns
        """When this began: when the connector was made, or later."""
        self.before = before
        """Samples that were written before."""
        self.ages: deque[int] = deque(maxlen=length)
        """Of samples as they were read, by their stamps."""
        self.latencies: deque[int] = deque(maxlen=length)
        """From write to read."""
        self._execs: deque[int] = deque(maxlen=length)
        self._periods: deque[int] = deque(maxlen=length)
        self._last_ns: int | None = None

    def add(self, began_ns: int, ended_ns: int) -> None:
        """One more send; sends come in the order in which they began."""
        self._execs.append(ended_ns - began_ns)
        if self._last_ns is not None:
            self._periods.append(began_ns - self._last_ns)
        self._last_ns = began_ns

    @property
    def timing(self) -> PublisherTiming:
        """What they have in common."""
        return PublisherTiming(Spans.of(tuple(self._execs)), Spans.of(tuple(self._periods)))
