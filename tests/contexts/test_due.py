"""When the tick that runs now was due, as a periodic context says it to its members."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import Component, EventContext, ExternalContext, Kernel, PeriodicContext, SimulatedClock
from aiorts.testing.simulation import simulate
from contexts.parts import MS


class Due(Component):
    """Notes for each execution when it began and when it was due; its executions take so many milliseconds."""

    def __init__(self, *takes: int) -> None:
        super().__init__("due")
        self.takes = list(takes)
        self.seen: list[tuple[int, int | None]] = []

    async def on_execute(self) -> None:
        context = self.context
        assert isinstance(context, PeriodicContext)
        began, due = self.clock.monotonic_ns(), context.due_ns
        self.seen.append((began // MS, None if due is None else due // MS))
        if self.takes:
            await self.sleep(self.takes.pop(0) / 1000)
        assert context.due_ns == due  # all through a cycle


def seen(overrun: str, *takes: int) -> list[tuple[int, int | None]]:
    async def main(clock: SimulatedClock) -> list[tuple[int, int | None]]:
        async with Kernel() as kernel:
            component = await kernel.add(Due(*takes))
            context = PeriodicContext(100.0, overrun=overrun)
            assert context.due_ns is None
            await kernel.start(context, component, activate=True)
            await asyncio.sleep(0.075)
            return component.seen

    return simulate(main)


@pytest.mark.row(24)
def test_a_late_tick_knows_when_it_was_due_and_a_skipped_one_is_nobodys() -> None:
    assert seen("skip", 0, 13, 0, 24) == [(0, 0), (10, 10), (23, 20), (30, 30), (54, 50), (60, 60), (70, 70)]


@pytest.mark.row(24)
def test_a_tick_that_is_caught_up_with_knows_when_it_was_due() -> None:
    assert seen("catch_up", 0, 35) == [(0, 0), (10, 10), (45, 20), (45, 30), (45, 40), (50, 50), (60, 60), (70, 70)]


def test_between_two_cycles_it_is_the_next_tick_and_without_a_rate_there_is_none() -> None:
    async def main(clock: SimulatedClock) -> tuple[int | None, ...]:
        async with Kernel() as kernel:
            context = await kernel.start(PeriodicContext(100.0), await kernel.add(Due()), activate=True)
            await asyncio.sleep(0.015)
            return (context.due_ns, *(getattr(kind(), "due_ns", None) for kind in (EventContext, ExternalContext)))

    assert simulate(main) == (20 * MS, None, None)
