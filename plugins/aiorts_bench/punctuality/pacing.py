"""Computes the figures of a series of ticks: lateness, period error, rate error, skips. Pure arithmetic on nanoseconds.

A tick is the pair (when it was due, when its code ran). All figures of a clock or a context are computed here from such
pairs, the same way for aiorts, for the bare loops in Python and for the one in C.

The rate is right when every tick due from the first to the last that ran either ran or was counted as skipped
(`complete`, exact), and the moments at which ticks number n ran lie on a line whose slope is the nominal period
(`rate_error`). Dividing by the time between two single ticks would measure how late those two were. The moments that a
context calls due are compared with the first tick that ran: a context whose due times drift is found out.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

BEST: Final = 0.99
"""The share of the periods, nearest to the nominal one, whose deviation is compared: on a shared computer any loop
loses the processor now and then, and one such loss outweighs a thousand ticks."""


@dataclass(frozen=True, slots=True)
class Ticks:
    """One series of ticks.

    Attributes:
        period_ns: the nominal period.
        due_ns, ran_ns: when each tick that ran was due, and when its code ran, by one clock.
        skipped: ticks left out, as the loop or the context counted them.
        overruns: cycles that were not done when the next cycle was due.
        cpu_ns: processor time of the process meanwhile; 0 when unknown.
        counted: ticks that ran, as the context counted them; None for a bare loop.
    """

    period_ns: int
    due_ns: Sequence[int]
    ran_ns: Sequence[int]
    skipped: int = 0
    overruns: int = 0
    cpu_ns: int = 0
    counted: int | None = None

    @property
    def lateness_ns(self) -> list[int]:
        """The lateness of each tick that ran."""
        return [ran - due for ran, due in zip(self.ran_ns, self.due_ns, strict=True)]

    @property
    def periods_ns(self) -> list[int]:
        """The times from each tick to the next, where no tick was left out between them."""
        return [
            later - earlier
            for (first, second, earlier, later) in zip(
                self.due_ns, self.due_ns[1:], self.ran_ns, self.ran_ns[1:], strict=False
            )
            if second - first < 1.5 * self.period_ns
        ]

    @property
    def intervals_ns(self) -> list[int]:
        """The times from each tick to the next that ran, with the ticks left out between them."""
        return [later - earlier for earlier, later in zip(self.ran_ns, self.ran_ns[1:], strict=False)]

    @property
    def numbers(self) -> list[int]:
        """The number of each tick that ran; ticks left out have numbers as well."""
        start = self.due_ns[0]
        return [round((due - start) / self.period_ns) for due in self.due_ns]

    @property
    def complete(self) -> bool:
        """Whether ticks run + ticks skipped are all the ticks that were due from the first to the last."""
        return len(self.due_ns) + self.skipped == self.numbers[-1] + 1

    @property
    def rate_error(self) -> float:
        """The error of (ticks run + skipped) / elapsed: 1e-4 is 0.01 % above the rate. 0 for fewer than eight ticks.

        The time elapsed is from the median of the first quarter of the ticks to that of the last: one late tick at an
        end would otherwise look like a drift.
        """
        quarter = len(self.ran_ns) // 4
        if quarter < 2:
            return 0.0
        numbers = self.numbers
        off = [ran - self.ran_ns[0] - n * self.period_ns for ran, n in zip(self.ran_ns, numbers, strict=True)]
        drift = statistics.median(off[-quarter:]) - statistics.median(off[:quarter])
        nominal = (statistics.median(numbers[-quarter:]) - statistics.median(numbers[:quarter])) * self.period_ns
        return nominal / (nominal + drift) - 1.0


@dataclass(frozen=True, slots=True)
class Timing:
    """The figures of a series, in nanoseconds unless stated otherwise."""

    period_mean: float
    period_deviation: float
    """Standard deviation of all periods."""
    period_deviation_best: float
    """Standard deviation of the `BEST` share of the periods that is nearest to the nominal one."""
    rate_error: float
    """Error of the rate, as a share of it."""
    cpu_share: float
    """Processor time as a share of the time that passed."""
    executed: float
    """Ticks that ran in a second."""

    @classmethod
    def of(cls, ticks: Ticks) -> Timing:
        """The figures of one series.

        A loop that skips all the time has no two whole periods: then the deviations of all intervals from the nominal
        period count.

        Raises:
            ValueError: fewer than three ticks.
        """
        count, periods = len(ticks.ran_ns), ticks.periods_ns
        if count < 3:
            raise ValueError(f"{count} ticks: at least 3 are needed")
        around = None if len(periods) >= 2 else float(ticks.period_ns)
        periods = periods if around is None else ticks.intervals_ns
        elapsed = ticks.ran_ns[-1] - ticks.ran_ns[0]
        return cls(
            statistics.fmean(periods),
            statistics.pstdev(periods, around),
            best_deviation(periods, ticks.period_ns, around=around),
            ticks.rate_error,
            ticks.cpu_ns / elapsed,
            (count - 1) * 1e9 / elapsed,
        )


def best_deviation(
    periods_ns: Sequence[int], nominal_ns: int, share: float = BEST, *, around: float | None = None
) -> float:
    """Standard deviation of the `share` of the periods that is nearest to the nominal one, at least two of them.

    The deviation is counted from their mean, or from `around`.
    """
    nearest = sorted(periods_ns, key=lambda period: abs(period - nominal_ns))
    return statistics.pstdev(nearest[: max(2, math.floor(len(nearest) * share))], around)
