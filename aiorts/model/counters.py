"""Rows of counters, which are sent as values in order, and read by name.

A field that is added to a row goes to its end and has a default, so kernels and clients of other releases read what
both know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self


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
