"""Spans of time of the last n sends of a publisher: how long each took, how far apart they began. It asks no clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from typing import Self

from aiorts.late import dataclass


@dataclass(frozen=True, slots=True)
class Spans:
    """Count, minimum, maximum, mean and deviation of some spans of time; all zero when there is none."""

    count: int = 0
    min_ns: int = 0
    max_ns: int = 0
    mean_ns: float = 0.0
    stdev_ns: float = 0.0
    """Of the population."""

    @classmethod
    def of(cls, spans: Collection[int]) -> Self:
        """What these spans have in common."""
        if not spans:
            return cls()
        mean = sum(spans) / len(spans)
        variance = sum((span - mean) ** 2 for span in spans) / len(spans)
        return cls(len(spans), min(spans), max(spans), mean, math.sqrt(variance))


@dataclass(frozen=True, slots=True)
class PublisherTiming:
    """When a connector sent, over its last sends.

    Attributes:
        exec: how long a send took: handing samples to the reader's buffer and waking the reader.
        period: from the beginning of one send to the beginning of the next.
    """

    exec: Spans
    period: Spans


class SendTimes:
    """The last `length` sends."""

    __slots__ = ("_execs", "_last_ns", "_periods")

    def __init__(self, length: int) -> None:
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
