"""Execution contexts that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from aiorts import ExternalContext, LifecycleState, PeriodicContext
from aiorts.kernel.execution.cycle import Call

if TYPE_CHECKING:
    from aiorts.kernel.execution.member import Member
    from aiorts.model.profile import ContextStatistics


class LosesTicks(ExternalContext):
    """One cycle answers everybody who waits for a tick."""

    def _begin_cycle(self) -> Sequence[Member]:
        members = super()._begin_cycle()
        self._over.extend(self._requested)
        self._requested.clear()
        return members


class LosesTheTenthTick(PeriodicContext):
    """Leaves out every tenth tick."""

    def _end_cycle(self, members: Sequence[Member]) -> None:
        super()._end_cycle(members)
        if self.ticks % 10 == 0:
            assert self._schedule is not None
            self._schedule.end(self._now_ns())


class ObeysInTheMiddle(ExternalContext):
    """Carries out a request while a cycle runs."""

    _in_cycle = False

    def _begin_cycle(self) -> Sequence[Member]:
        self._in_cycle = True
        return super()._begin_cycle()

    def _end_cycle(self, members: Sequence[Member]) -> None:
        self._in_cycle = False
        super()._end_cycle(members)

    def _request_came(self) -> None:
        for step in self.runner.next_action().steps() if self._in_cycle else ():
            if isinstance(step, Call):
                step.member.hook_of(step.hook)[1](*step.args)


class Reenters(ExternalContext):
    """Runs each tick in the task of its caller, whoever else is inside."""

    async def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.ticks += 1
            for hook in ("on_execute", "on_state_update"):
                for member in self._members:
                    if member.state is LifecycleState.ACTIVE:
                        result: Any = member.hook_of(hook)[1]()
                        if result is not None:
                            await result


class EndsInOrder(ExternalContext):
    """Shuts the first member down first."""

    async def stop(self) -> None:
        self._members.reverse()
        await super().stop()


class Flatters(ExternalContext):
    """Says that it did twice as much."""

    @property
    def statistics(self) -> ContextStatistics:
        from dataclasses import replace

        return replace(super().statistics, cycles=2 * self.ticks)
