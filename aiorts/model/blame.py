"""The causes of late cycles, as values: a blame, counts of missed deadlines by blame, pauses of the garbage collector.

This file names and counts; `aiorts.diagnostics.blame` judges and `aiorts.diagnostics.stack_sampler` looks.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from aiorts.late import dataclass

OTHERS: Final = "others"
"""The key under which missed deadlines are counted once there are too many places."""
_PLACES: Final = 32
_REPORT_EVERY_NS: Final = 5_000_000_000
"""Each place has at most one line of the log in this time."""
_REPORT_FROM_NS: Final = 10_000_000
"""Shorter holds are counted, published and not logged."""
_OVERLOAD_NS: Final = 1_000_000_000
_OVERLOAD_TICKS: Final = 10
_OVERLOAD_CYCLES: Final = 3
"""An overload: in at least this time and so many ticks, most cycles overran, and at least so many did."""


@dataclass(frozen=True, slots=True)
class Blame:
    """The cause that held up a context when a deadline was missed; `str` gives it as one sentence."""

    kind: str
    """"hook": one of the context's own; "loop": other code on the event loop (a hook of another context, a task that a
    component started, code of the application); "gc": a garbage collection; "machine": no code of this process ran;
    "unknown": the hold was over before it could be sampled."""
    component: str = ""
    """Empty for the application's code, "gc", "machine" and "unknown"."""
    hook: str = ""
    """Empty for a task that the component started."""
    file: str = ""
    line: int = 0
    """The line that ran; the first line of the hook where no sample was taken in time."""
    function: str = ""
    held_ns: int = 0
    """The duration of the hold, as far as it is known, in nanoseconds."""
    generation: int | None = None
    """The generation of a garbage collection; else None."""
    held: str = "the loop"
    """The thing that was held: "the loop", "its thread", or "its context" by a hook that waited."""

    @property
    def place(self) -> str:
        """The text without the duration: the key by which missed deadlines are counted."""
        if self.kind == "gc":
            return f"garbage collection of generation {self.generation}"
        if self.kind == "machine":
            return "the machine: this process did not run"
        if self.kind == "unknown":
            return "unknown: other code on the loop, or the machine"
        where = f"{os.path.basename(self.file)}:{self.line}" if self.file else ""
        if self.component and self.hook:
            who = f"{self.component}.{self.hook}"
        elif self.component:
            who = f"{self.component}, in a task of its own"
        else:
            return f"{self.function or 'code of the application'} ({where or 'line unknown'})"
        inside = f" in {self.function}" if self.function and self.function != self.hook else ""
        return f"{who} ({where}{inside})" if where else who

    def __str__(self) -> str:
        held = f"{self.held_ns / 1e6:.3g}" if self.held_ns < 10_000_000 else f"{self.held_ns / 1e6:.0f}"
        if self.kind in ("machine", "unknown"):
            return f"{self.place}, for {held} ms"
        return f"{self.place} held {self.held} for {held} ms"


@dataclass(frozen=True, slots=True)
class GcPauses:
    """Collections of one generation while a context with a rate ran; nothing else runs meanwhile. Nanoseconds."""

    count: int = 0
    total_ns: int = 0
    max_ns: int = 0
    last_ns: int = 0


class MissedDeadlines:
    """Missed deadlines of one context, counted by the place that is to blame; bounded, whatever happens."""

    def __init__(self) -> None:
        self.last: Blame | None = None
        self._counts: dict[str, int] = {}
        self._reported: dict[str, tuple[int, int]] = {}

    @property
    def counts(self) -> Mapping[str, int]:
        """The counts by `Blame.place`; the 33rd place and all after it are "others"."""
        return MappingProxyType(self._counts.copy())

    def add(self, blame: Blame, now_ns: int) -> int:
        """Count a blame. When a report is due, returns the number of unreported blames of its place; else 0."""
        self.last = blame
        counts, place = self._counts, blame.place
        if place not in counts and len(counts) >= _PLACES:
            place = OTHERS
        counts[place] = count = counts.get(place, 0) + 1
        if blame.held_ns < _REPORT_FROM_NS:
            return 0
        reported_ns, reported = self._reported.get(place, (now_ns - _REPORT_EVERY_NS, 0))
        if now_ns - reported_ns < _REPORT_EVERY_NS:
            return 0
        self._reported[place] = (now_ns, count)
        return count - reported


class Overload:
    """Finds a context that misses most of its deadlines, once; an occasional overrun is no overload."""

    def __init__(self) -> None:
        self._since: tuple[int, int, int] | None = None
        """Time, cycles and ticks at the start of the present examination."""
        self._late = 0
        self._reported = False

    def add(self, now_ns: int, cycles: int, ticks: int) -> tuple[int, int, int] | None:
        """Count an overrun, after so many cycles and ticks of the schedule.

        Returns overruns, cycles and nanoseconds when it is time to report, else None.
        """
        if self._reported:
            return None
        if self._since is None:
            self._since = now_ns, cycles, ticks
        self._late += 1
        began_ns, began_cycles, began_ticks = self._since
        length, ran = now_ns - began_ns, cycles - began_cycles
        if length < _OVERLOAD_NS or ticks - began_ticks < _OVERLOAD_TICKS:
            return None
        late = self._late - 1  # the first one is where the time began
        if 2 * late <= ran:
            self._since, self._late = (now_ns, cycles, ticks), 1
        elif late >= _OVERLOAD_CYCLES:
            self._reported = True
            return late, ran, length
        return None
