"""A context with a rate: absolute deadlines on the kernel's clock (`schedule.py` says when)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from aiorts.contexts.schedule import MAX_RATE, Schedule, check_rate
from aiorts.kernel.bus import Overrun, RateChanged
from aiorts.kernel.context import Context
from aiorts.kernel.life import Wait
from aiorts.model.profile import ContextStatistics

if TYPE_CHECKING:
    from aiorts.kernel.member import Member

__all__ = ("PeriodicContext",)


class PeriodicContext(Context):
    """Runs its members `rate` times a second.

    Args:
        rate: Hz, 0.001 to `max_rate`.
        overrun: "skip" leaves missed ticks out, "catch_up" runs them as far as they are at most 1 s old.
        max_rate: the highest rate that may be asked for, Hz.
        name, deadline, timing: see `Context`; execution times are taken by default.

    Raises:
        ConfigurationError: rate or policy out of range.
    """

    kind: ClassVar[str] = "periodic"

    def __init__(
        self,
        rate: float = 1000.0,
        *,
        overrun: str = "skip",
        max_rate: float = MAX_RATE,
        name: str = "",
        deadline: float | None = None,
        timing: bool = True,
    ) -> None:
        super().__init__(name=name, deadline=deadline, timing=timing)
        self._schedule: Schedule | None = Schedule(rate, overrun, max_rate)
        self._fresh = True

    @property
    def rate(self) -> float | None:
        """Hz."""
        return None if self._schedule is None else self._schedule.rate

    @property
    def statistics(self) -> ContextStatistics:
        plan = self._schedule
        if plan is None:
            return super().statistics
        return ContextStatistics(
            self.ticks,
            plan.skipped,
            plan.overruns,
            plan.lateness_max_ns,
            plan.lateness_total_ns,
            self._hook_statistics(),
        )

    async def set_rate(self, rate: float, *, timeout: float | None = 5.0) -> None:
        """Another rate from now on: the next tick is one new period after the last; members get `on_rate_changed`.

        Raises:
            ConfigurationError: the rate is out of range; the old one stays.
        """
        self._check("set_rate")
        checked = check_rate(rate, self._max_rate())
        await self._ask([(f"set rate {checked} Hz", partial(self._life.change_rate, checked))], timeout)

    def _max_rate(self) -> float:
        return MAX_RATE if self._schedule is None else self._schedule.max_rate

    def _life_began(self) -> None:
        self._fresh = True
        super()._life_began()

    def _next_cause(self) -> Wait | None:
        plan = self._schedule
        if plan is None:
            return None
        now = self._now_ns()
        if self._fresh:
            # Only now: what was asked for at the start, an activation that takes long, has been done.
            self._fresh = False
            plan.start(now)
        if now >= plan.due_ns:
            return None
        return Wait(plan.due_ns)

    def _begin_cycle(self) -> Sequence[Member]:
        if self._schedule is not None:
            missed = self._schedule.begin(self._now_ns())
            if missed is not None:
                self._publish(Overrun(self.name, *missed))
        return super()._begin_cycle()

    def _end_cycle(self, members: Sequence[Member]) -> None:
        if self._schedule is not None:
            self._schedule.end(self._now_ns())

    def _set_rate_now(self, rate: float) -> None:
        if self._schedule is not None:
            self._schedule.set_rate(rate, self._now_ns())
        self._publish(RateChanged(self.name, rate))
