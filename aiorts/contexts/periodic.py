"""A context with a rate: absolute deadlines on the kernel's clock (`schedule.py` says when)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from aiorts.contexts.schedule import MAX_RATE, Ceiling, OverrunPolicy, Rate, Schedule, check_rate
from aiorts.kernel.execution.context import Context, Deadline, Timing
from aiorts.kernel.execution.cycle import Wait
from aiorts.kernel.loop.bus import Overrun, RateChanged
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.model.blame import MissedDeadlines, Overload
from aiorts.model.profile import ContextStatistics

if TYPE_CHECKING:
    from aiorts.kernel.execution.deadline_timer import DeadlineTimer
    from aiorts.kernel.execution.member import Member

_LOG = KernelLog()


class PeriodicContext(Context):
    """Runs its members `rate` times a second.

    Raises:
        ConfigurationError: an option is out of range.
    """

    kind: ClassVar[str] = "periodic"

    def __init__(
        self,
        rate: Rate = 1000.0,
        *,
        overrun: OverrunPolicy = "skip",
        max_rate: Ceiling = MAX_RATE,
        name: str = "",
        deadline: Deadline = None,
        timing: Timing = True,
    ) -> None:
        super().__init__(name=name, deadline=deadline, timing=timing)
        self._check_options(PeriodicContext, overrun=overrun, max_rate=max_rate)
        self._schedule: Schedule | None = Schedule(check_rate(rate, max_rate), overrun)
        self.overrun = overrun
        """The policy for missed ticks: "skip" or "catch_up"."""
        self.max_rate = max_rate
        """The ceiling for its rate, Hz."""
        self._fresh = True
        self._missed: MissedDeadlines | None = None
        self._overload = Overload()
        self._deadline_timer: DeadlineTimer | None = None

    @property
    def rate(self) -> float | None:
        """The rate, Hz."""
        return None if self._schedule is None else self._schedule.rate

    @property
    def due_ns(self) -> int | None:
        """The time at which the present tick was due, on the kernel's clock; between two cycles, that of the next one.

        None before the first cycle, and where there is no rate. `clock.monotonic_ns() - due_ns` is how late a hook is.
        """
        return None if self._schedule is None or self._fresh else self._schedule.due_ns

    @property
    def counts(self) -> ContextStatistics:
        plan = self._schedule
        if plan is None:
            return super().counts
        late = plan.lateness
        p50, p99 = late.percentiles(50, 99)
        return replace(
            super().counts,
            skipped=plan.skipped,
            overruns=plan.overruns,
            lateness_max_ns=late.max_ns,
            lateness_total_ns=late.total_ns - plan.own_ns,
            policy=plan.overrun,
            missed={} if self._missed is None else self._missed.counts,
            last_blame=None if self._missed is None else self._missed.last,
            lateness_stdev_ns=late.stdev_ns,
            lateness_p50_ns=p50,
            lateness_p99_ns=p99,
            lateness_histogram=late.histogram,
        )

    async def set_rate(self, rate: float, *, timeout: float | None = 5.0) -> None:
        """Change the rate: the next tick is one new period after the last; members get `on_rate_changed`.

        Raises:
            ConfigurationError: the rate is out of range; the old one stays.
        """
        self.runner.check("set_rate")
        checked = check_rate(rate, self.max_rate)
        await self.runner.ask([(f"set rate {checked} Hz", partial(self.runner.life.change_rate, checked))], timeout)

    def _life_began(self) -> None:
        self._fresh = True
        self._look_out()
        super()._life_began()

    def _life_ended(self, error: BaseException | None) -> None:
        try:
            if self._deadline_timer is not None:
                self._deadline_timer.close()
                self._deadline_timer = None
        finally:
            super()._life_ended(error)

    def _look_out(self) -> None:
        """Monitor missed deadlines of this rate; called in the thread that runs the hooks."""
        plan = self._schedule
        if plan is None:
            return
        if self._deadline_timer is None:
            self._deadline_timer = self.runner.kernel.monitor_deadlines(self)
        if self._deadline_timer is not None:
            self._deadline_timer.period(plan.period_ns)

    def _next_cause(self) -> Wait | None:
        plan = self._schedule
        if plan is None:
            return None
        now = self._now_ns()
        if self._fresh:
            # Only now: requests made at the start, such as a long activation, have been carried out.
            self._fresh = False
            plan.start(now)
        if now >= plan.due_ns:
            return None
        return Wait(plan.due_ns)

    def _begin_cycle(self) -> Sequence[Member]:
        plan, timer = self._schedule, self._deadline_timer
        if plan is not None:
            now_ns = self._now_ns()
            missed = plan.begin(now_ns)
            if missed is not None:
                self._report_overrun(missed, now_ns)
            if timer is not None:
                timer.arm(plan.due_ns + plan.period_ns)
        return super()._begin_cycle()

    def _report_overrun(self, missed: tuple[int, int], now_ns: int) -> None:
        """Count, publish and log what made this cycle late."""
        plan, timer = self._schedule, self._deadline_timer
        blame = None if timer is None else timer.blame(now_ns, now_ns - missed[1])
        policy = "skip" if plan is None else plan.overrun
        if self._missed is None:
            self._missed = MissedDeadlines()
        if blame is not None and (times := self._missed.add(blame, now_ns)):
            # Information only: a missed deadline is counted, and many systems miss some without harm.
            missed_now = "1 deadline" if times == 1 else f"{times} deadlines"
            _LOG.info("%s: %s missed: %s", self.name, missed_now, blame)
        self.runner.publish(Overrun(self.name, *missed, policy, blame))
        # Delays by the machine are not the system's fault: on a loaded machine the log would never be silent.
        ours = blame is not None and blame.kind in ("hook", "loop")
        if plan is None or blame is None or not ours or 2 * blame.held_ns < plan.period_ns:
            return
        most = self._overload.add(now_ns, self.ticks, self.ticks + plan.skipped)
        if most is not None:
            late, cycles, length = most
            what = (
                f"misses most deadlines: {late} of {cycles} cycles overran in {length / 1e9:.1f} s at {plan.rate:g} Hz"
            )
            _LOG.warning("%s: %s; %s", self.name, what, blame)

    def _end_cycle(self, members: Sequence[Member]) -> None:
        if self._schedule is not None:
            self._schedule.end(self._now_ns())

    def _set_rate_now(self, rate: float) -> None:
        if self._schedule is not None:
            self._schedule.set_rate(rate, self._now_ns())
            self._look_out()
            if self._deadline_timer is not None:
                self._deadline_timer.arm(self._schedule.due_ns)
        self.runner.publish(RateChanged(self.name, rate))
