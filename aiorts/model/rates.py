"""How often something happened a second, and rows of counters, which are sent as values in order, and read by name.

A field that is added to a row goes to its end and has a default, so kernels and clients of other releases read what
both know. Nothing here asks a clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

from aiorts.errors import ConfigurationError


class Counted:
    """Statistics with a count and the moment they were taken at. See `rate_since`."""

    __slots__ = ()
    counted: ClassVar[str]
    """The field that has the count."""
    at_ns: int

    def rate_since(self, earlier: Self) -> float:
        """How often a second it was counted since the earlier statistics of the same thing, by the kernel's clock.

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
    """How often a second from one moment to the other; 0 where there is no time between them."""
    return count * 1e9 / (at_ns - since_ns) if at_ns > since_ns else 0.0


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
        return cls(*row[: len(cls._fields)])

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
    """Encoded; None where it is not known."""
    why: str
    """The reason why it is not; "" where it is."""
