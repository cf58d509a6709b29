"""Spans of time of the last n sends and reads of a connector, its counters, and rates of counted events.

No clock is asked. A field that is added to a row (a NamedTuple, sent as its values in order) goes to its end and has a
default, so kernels and clients of other releases read the fields that both know.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass

R = TypeVar("R")


def row_of(kind: type[R], values: Sequence[Any]) -> R:
    """The row of this kind with these values; values for the fields of a newer release are left out."""
    row: Any = kind
    made: R = row(*values[: len(row._fields)])
    return made


class ConnectorCounters(NamedTuple):
    """The counters of a connector at one moment, sent as a list of these values."""

    written: int
    """Samples that the writer sent."""
    delivered: int
    """Samples that the reader read; at the writer's end of a link those that were acknowledged."""
    buffered: int
    """Samples that wait to be read."""
    dropped: Mapping[str, int]
    """Samples that were lost, by reason."""
    measure: int
    """The option `measure`: sends and reads over which latency and age are taken; 0 is none."""

    @classmethod
    def of(cls, row: Sequence[Any]) -> Self:
        """The counters in a row of an answer; fields of a newer kernel are left out."""
        return row_of(cls, row)

    @property
    def lost(self) -> int:
        """Samples that were lost, for whatever reason."""
        return sum(self.dropped.values())


class SpanFigures(NamedTuple):
    """The figures of some spans of time, sent as a list of these values."""

    samples: int
    p50_ns: int
    p99_ns: int
    max_ns: int


class Size(NamedTuple):
    """The size of the sample that was written last, sent as a list of these values."""

    bytes: int | None
    """The size of the encoded sample; None where it is not known."""
    why: str
    """The reason why the size is not known; "" where it is."""


@dataclass(frozen=True, slots=True)
class Spans:
    """Count, minimum, maximum, mean, deviation and percentiles of some spans of time; all zero when there is none."""

    count: int = 0
    min_ns: int = 0
    max_ns: int = 0
    mean_ns: float = 0.0
    stdev_ns: float = 0.0
    """The standard deviation of the population."""
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
        """The figures of these spans."""
        if not spans:
            return cls()
        ordered = sorted(spans)
        mean = sum(ordered) / len(ordered)
        variance = sum((span - mean) ** 2 for span in ordered) / len(ordered)
        p50, p99 = percentile(ordered, 50), percentile(ordered, 99)
        return cls(len(ordered), ordered[0], ordered[-1], mean, math.sqrt(variance), p50, p99)


def percentile(ordered: Sequence[int], percent: int) -> int:
    """The smallest value that at least so many percent of these do not exceed; they are sorted, and at least one."""
    return ordered[-(-percent * len(ordered) // 100) - 1]


@dataclass(frozen=True, slots=True)
class PublisherTiming:
    """The times of a connector's last sends.

    Attributes:
        exec: the duration of a send: handing samples to the reader's buffer and waking the reader.
        period: the time from the beginning of one send to the beginning of the next.
    """

    exec: Spans
    period: Spans


class ConnectorTimes:
    """The last `length` sends and reads of a connector."""

    __slots__ = ("_execs", "_last_ns", "_periods", "ages", "before", "latencies", "since_ns")

    def __init__(self, length: int, since_ns: int = 0, before: int = 0) -> None:
        self.since_ns = since_ns
        """The time at which counting began: when the connector was made, or later."""
        self.before = before
        """Samples that were written before `since_ns`."""
        self.ages: deque[int] = deque(maxlen=length)
        """The ages of samples at their read, by their stamps."""
        self.latencies: deque[int] = deque(maxlen=length)
        """The times from write to read."""
        self._execs: deque[int] = deque(maxlen=length)
        self._periods: deque[int] = deque(maxlen=length)
        self._last_ns: int | None = None

    def add(self, began_ns: int, ended_ns: int) -> None:
        """Add a send; sends come in the order in which they began."""
        self._execs.append(ended_ns - began_ns)
        if self._last_ns is not None:
            self._periods.append(began_ns - self._last_ns)
        self._last_ns = began_ns

    @property
    def timing(self) -> PublisherTiming:
        """The figures of the last sends."""
        return PublisherTiming(Spans.of(tuple(self._execs)), Spans.of(tuple(self._periods)))


class Counted:
    """Statistics with a count and the time at which they were taken. See `rate_since`."""

    __slots__ = ()
    counted: ClassVar[str]
    """The field that has the count."""
    at_ns: int

    def rate_since(self, earlier: Self) -> float:
        """The count per second since the earlier statistics of the same thing, by the kernel's clock.

        Raises:
            ConfigurationError: the other statistics are not earlier, or are of something else.
        """
        kind = type(self).__name__
        if type(earlier) is not type(self):
            raise ConfigurationError(f"rate_since: {type(earlier).__name__}: expected earlier {kind}")
        span_ns = self.at_ns - earlier.at_ns
        more: int = getattr(self, self.counted) - getattr(earlier, self.counted)
        if span_ns == 0:
            raise ConfigurationError("rate_since: both statistics are of one moment; take the later ones later")
        if span_ns < 0:
            raise ConfigurationError(
                f"rate_since: the other statistics are {-span_ns / 1e9:g} s later; write later.rate_since(earlier)"
            )
        if more < 0:
            raise ConfigurationError(
                f"rate_since: {self.counted} was {-more} more in the earlier statistics; they are of something else"
            )
        return more * 1e9 / span_ns


def mean_rate(count: int, since_ns: int, at_ns: int) -> float:
    """The count per second from one moment to the other; 0 where there is no time between them."""
    return count * 1e9 / (at_ns - since_ns) if at_ns > since_ns else 0.0
