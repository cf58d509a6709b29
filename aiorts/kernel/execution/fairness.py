"""Tells whether the cycles of a context hold their thread, so that others wait for whole cycles at every turn.

Time in which the thread was ready and did not run counts for nothing: a preempted cycle is not a long one, and a reader
that rested for it would fall behind its writers. Nothing is measured before the loop turns slowly.
"""

from __future__ import annotations

import os
import time
from typing import Final

LONG_NS: Final = 10_000_000
"""Nanoseconds from which a cycle is long."""
_TWICE: Final = 2
"""One long cycle is an event, and over; what is long twice in a row goes on so."""
_KEPT_FROM_RUNNING: Final = "/proc/thread-self/schedstat"
"""A file of Linux: nanoseconds that this thread ran, nanoseconds that it was ready and waited, and how often it ran."""


class Held:
    """How long each of the cycles that follow one another without a wait held this thread."""

    __slots__ = ("_began", "_long")

    def __init__(self) -> None:
        self._began = (0, 0)
        self._long = 0

    def begin(self) -> None:
        """A cycle begins."""
        self._began = time.monotonic_ns(), _kept_from_running_ns()

    def end(self) -> None:
        """The cycle is over."""
        took_ns = time.monotonic_ns() - self._began[0] - (_kept_from_running_ns() - self._began[1])
        self._long = self._long + 1 if took_ns >= LONG_NS else 0

    @property
    def on_and_on(self) -> bool:
        """Whether the last cycles were all long."""
        return self._long >= _TWICE


def _kept_from_running_ns() -> int:
    try:
        file = os.open(_KEPT_FROM_RUNNING, os.O_RDONLY)
        try:
            return int(os.read(file, 100).split()[1])
        finally:
            os.close(file)
    except (OSError, IndexError, ValueError):
        # Not to be had: then only what it ran counts, and a hook that sleeps is none that holds.
        return time.monotonic_ns() - time.thread_time_ns()
