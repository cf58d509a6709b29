"""Computes when the ticks of a rate are due: pure arithmetic on nanoseconds.

Tick n is due at `start + n / rate`, computed with integers from the rate's exact ratio, so that no error accumulates.
A cycle that is not done when the next is due, or within a deadline of its own, is an overrun, and so is one that begins
when the next is due already. The policy "skip" then runs the newest tick that is due and counts the others as skipped;
"catch_up" runs the missed ticks at once if they are at most one second old, and the newest in any case.
"""

from __future__ import annotations

from array import array
from operator import length_hint
from typing import Annotated, Final, Literal

from aiorts.errors import ConfigurationError
from aiorts.model.declared import Option, expected_number
from aiorts.model.lateness import Lateness
from aiorts.model.values import shown

MAX_RATE: Final = 10_000.0
_MIN_RATE: Final = 0.001
_RATE: Final = Option("Cycles per second, up to max_rate.", unit="Hz", low=_MIN_RATE)
Rate = Annotated[float, _RATE]
# A period is at least a nanosecond.
Ceiling = Annotated[float, Option("The highest rate allowed.", unit="Hz", low=_MIN_RATE, high=1e9)]
OverrunPolicy = Annotated[
    Literal["skip", "catch_up"],
    Option("skip leaves missed ticks out; catch_up runs those that are at most 1 s old."),
]
_CATCH_UP_NS: Final = 1_000_000_000
_BATCH: Final = 32
"""Cycles whose lateness is added up at once."""


def check_rate(rate: float, highest: float) -> float:
    """`rate` as a float; ConfigurationError unless it is one, up to `highest`."""
    if what := expected_number(_RATE._replace(high=highest), (float,), rate):
        raise ConfigurationError(f"rate = {shown(rate)}: {what} (max_rate raises the ceiling)")
    return float(rate)


class Schedule:
    """The ticks of one context.

    Args:
        rate: Hz. overrun: "skip" or "catch_up".
    """

    def __init__(self, rate: float, overrun: str = "skip") -> None:
        self.overrun = overrun
        self.rate = rate
        self.due_ns = 0
        """The time at which the next tick is due."""
        self.skipped = self.overruns = 0
        self._late = array("q", bytes(8 * _BATCH))
        """The lateness of the last cycles, as many as `_places` has given out."""
        self._places = iter(range(_BATCH))
        self._lateness = Lateness()
        """The lateness of the cycles before those in `_late`."""
        self.own_ns = 0
        """The total time from the first left-out tick to the tick that ran in its place."""
        self.period_ns = 0
        """The period, rounded down."""
        self.deadline_ns: int | None = None
        """The time after its due moment in which a tick has to be done; None: a period."""
        self._tick = 0
        self._start_ns = 0
        self._over = False
        self._set_ratio()

    def start(self, now_ns: int) -> None:
        """Make tick 0 due now."""
        self._start_ns = self.due_ns = now_ns
        self._tick = 0
        self._over = False

    def begin(self, now_ns: int) -> tuple[int, int] | None:
        """Begin the tick that is due, or a newer one when that was missed.

        Returns:
            None when it is in time; after an overrun the number of ticks left out, and how long the first of them, or
            else the one that begins, has been due, in nanoseconds.
        """
        behind = now_ns - self.due_ns
        # One store for each cycle; what it means is counted for many at once (tests/scale counts the bytecodes).
        try:
            self._late[next(self._places)] = behind
        except StopIteration:
            self._add_up(behind)
        if behind < self.period_ns and not self._over:
            return None
        return self._begin_late(now_ns, behind)

    def _begin_late(self, now_ns: int, behind: int) -> tuple[int, int] | None:
        due_ns = self.due_ns
        skipped = self._leave_out(now_ns) if behind >= self.period_ns else 0
        self.own_ns += self.due_ns - due_ns
        if not skipped and not self._over:
            return None
        self._over = False
        self.overruns += 1
        return skipped, max(0, behind)

    def _add_up(self, behind: int) -> None:
        """Add up the full batch, and begin the next with this one."""
        full = self._late
        self._late, self._places = array("q", bytes(8 * _BATCH)), iter(range(_BATCH))
        self._lateness.add(full)
        self._late[next(self._places)] = behind

    @property
    def lateness(self) -> Lateness:
        """The time for which the tick that waited longest had been due when each cycle began.

        Counted by the tick that is run, a stall of any length would be within a period.
        """
        used = _BATCH - length_hint(self._places)
        return self._lateness.with_these(self._late[:used])

    def end(self, now_ns: int) -> None:
        """End the tick."""
        until = None if self.deadline_ns is None else self.due_ns + self.deadline_ns
        self._tick += 1
        self.due_ns = self._due(self._tick)
        self._over = now_ns > (self.due_ns if until is None else until)

    def _leave_out(self, now_ns: int) -> int:
        """Go on to the tick that runs now; return how many are left out."""
        resume = self._newest(now_ns)
        if self.overrun == "catch_up":
            # The first tick that is not too old to catch up with.
            resume = min(resume, self._newest(now_ns - _CATCH_UP_NS - 1) + 1)
        skipped = max(0, resume - self._tick)
        self.skipped += skipped
        self._tick += skipped
        self.due_ns = self._due(self._tick)
        return skipped

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Change the rate: the next tick is one new period after the last one, or now when that is over."""
        last = self._due(self._tick - 1) if self._tick else now_ns
        self.rate = rate
        self._set_ratio()
        length, divisor = self._period
        # Counted from the last tick on; one that would be due in the past is due now and no overrun.
        self._start_ns = max(last, now_ns - length // divisor)
        self._tick = 1
        self.due_ns = self._due(1)

    def _set_ratio(self) -> None:
        numerator, denominator = self.rate.as_integer_ratio()
        self._period = (1_000_000_000 * denominator, numerator)
        self.period_ns = 1_000_000_000 * denominator // numerator

    def _newest(self, now_ns: int) -> int:
        """The newest tick that is due."""
        length, divisor = self._period
        return (now_ns - self._start_ns) * divisor // length

    def _due(self, tick: int) -> int:
        length, divisor = self._period
        # Rounded up, so that `floor((t - start) / period)` gives the tick back.
        return self._start_ns - (-tick * length // divisor)
