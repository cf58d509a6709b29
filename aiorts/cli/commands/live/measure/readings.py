"""Repeated readings of a kernel's counters, and the rates between two readings, by the kernel's own clock."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator, Mapping
from math import sqrt
from typing import Any

from aiorts.model.timing import ConnectorCounters
from aiorts.sessions import Client

Counters = Mapping[str, Any]
"""The answer of the operation `statistics`, with its rows by name."""


def counters_in(answer: Mapping[str, Any]) -> Counters:
    """The counters in an answer of the operation `statistics`."""
    rows: Mapping[str, Any] = answer["connectors"]
    return {**answer, "connectors": {name: ConnectorCounters.of(row) for name, row in rows.items()}}


def readings(client: Client, interval: float, **chosen: object) -> Iterator[Counters]:
    """Read the counters, `interval` real seconds apart.

    Raises:
        ClosedError: the kernel has ended.
    """
    due = time.monotonic()
    while True:
        yield counters_in(client.call("statistics", **chosen))
        due = max(due + interval, time.monotonic())
        rest(client, due)


def rest(client: Client, until: float) -> None:
    """Wait until a moment of `time.monotonic()`.

    Raises:
        ClosedError: the kernel has ended meanwhile.
    """
    while (left := until - time.monotonic()) > 0:
        if select.select([client], [], [], left)[0]:
            client.read()


def rate_of(now: Counters, before: Counters, name: str) -> float | None:
    """Samples a second that were written to a connector between two readings; None where it is not known."""
    new, old = now["connectors"].get(name), before["connectors"].get(name)
    return None if new is None or old is None else per_second(new.written - old.written, now, before)


def per_second(more: int, now: Counters, before: Counters) -> float | None:
    """A count per second of the kernel's clock; None where a new thing of this name began at 0, or the clock stood."""
    span_ns = now["at_ns"] - before["at_ns"]
    return None if span_ns <= 0 or more < 0 else more * 1e9 / span_ns


class Rates:
    """The rates of one connector over the windows between readings, and over all of them."""

    def __init__(self) -> None:
        self.windows: list[float] = []
        self._first: tuple[int, int] | None = None
        self._last: tuple[int, int] | None = None

    def add(self, at_ns: int, written: int) -> bool:
        """Add a reading; returns whether it ends a window."""
        before, self._last = self._last, (at_ns, written)
        if before is None or written < before[1]:
            self._first = self._last  # a new connector has the name
            return False
        if at_ns <= before[0]:
            self._last = before
            return False
        self.windows.append((written - before[1]) * 1e9 / (at_ns - before[0]))
        return True

    @property
    def mean(self) -> float:
        """The rate from the first reading to the last."""
        assert self._first is not None and self._last is not None  # noqa: S101, PT018 - a window has ended
        return (self._last[1] - self._first[1]) * 1e9 / (self._last[0] - self._first[0])

    def summary(self) -> dict[str, float]:
        """Rate, minimum, maximum and standard deviation of the windows, and their number."""
        count = len(self.windows)
        mean = sum(self.windows) / count
        deviation = sqrt(sum((one - mean) ** 2 for one in self.windows) / count)
        spread = {"min": min(self.windows), "max": max(self.windows), "stdev": deviation}
        return {"rate": self.mean, "window": self.windows[-1], **spread, "windows": count}
