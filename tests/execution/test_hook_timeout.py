"""A hook that does not return: cancelled once for each grace step, abandoned, and never in anybody's way."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any

import pytest

from aiorts import Component, EventContext, ExternalContext, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.errors import HookAbandoned, HookTimeout, StateError
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from kernel_parts import PlainDiary


class Stuck(Component):
    """Ignores cancellation, and notes when it was cancelled, until it is let go."""

    def __init__(self, name: str = "", where: str = "on_execute") -> None:
        super().__init__(name)
        self.where = where
        self.cancelled_at: list[float] = []
        self.runs = 0
        self.free = asyncio.Event()

    async def _stick(self, hook: str) -> None:
        if hook != self.where:
            return
        self.runs += 1
        while not self.free.is_set():
            try:
                await self.free.wait()
            except asyncio.CancelledError:
                self.cancelled_at.append(asyncio.get_running_loop().time())

    async def on_execute(self) -> None:
        await self._stick("on_execute")

    async def on_activated(self) -> None:
        await self._stick("on_activated")

    async def on_deactivated(self) -> None:
        await self._stick("on_deactivated")

    async def on_finalize(self) -> None:
        await self._stick("on_finalize")


class StuckInFinally(Stuck):
    """Awaits forever in its `finally`."""

    async def _stick(self, hook: str) -> None:
        if hook == self.where:
            try:
                await asyncio.Event().wait()
            finally:
                await super()._stick(hook)


async def let_go(*stuck: Stuck) -> None:
    for one in stuck:
        one.free.set()
    await asyncio.sleep(0.001)


@pytest.mark.fault("A06")
@pytest.mark.fault("A07")
@pytest.mark.parametrize("kind", [Stuck, StuckInFinally])
def test_hook_over_its_deadline_is_cancelled_each_half_second_then_abandoned_and_the_neighbour_runs_on(
    kind: type[Stuck],
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            stuck, healthy = await kernel.add(kind("stuck")), await kernel.add(PlainDiary("healthy"))
            context = await kernel.start(PeriodicContext(10.0, deadline=1.0), stuck, healthy, activate=True)
            other = await kernel.start(PeriodicContext(10.0), await kernel.add(PlainDiary("far")), activate=True)
            await clock.advance(2.9)
            first = 1.0 if kind is Stuck else 1.5
            assert [round(at, 3) for at in stuck.cancelled_at] == [
                first + 0.5 * n for n in range(4 - (kind is not Stuck))
            ]
            assert healthy.count("on_execute") == 0
            assert other.ticks == 30
            await clock.advance(1.1)
            assert context.state(stuck) is LifecycleState.ERROR
            assert isinstance(stuck.last_error, HookAbandoned)
            assert "stuck.on_execute: ignored 4 cancellations" in str(stuck.last_error)
            before = healthy.count("on_execute")
            assert before in (11, 12)
            with pytest.raises(StateError, match="abandoned"):
                await context.reset(stuck)
            await let_go(stuck)
            await clock.advance(1.0)
            assert (stuck.runs, healthy.count("on_execute")) == (1, before + 10)

    simulate(main)


def test_hook_over_its_deadline_that_heeds_its_cancellation_is_in_error_with_the_reason() -> None:
    class Slow(Component):
        async def on_execute(self) -> None:
            await asyncio.sleep(60)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            slow = await kernel.add(Slow("slow"))
            context = await kernel.start(PeriodicContext(10.0, deadline=0.5), slow, activate=True)
            await clock.advance(0.6)
            assert context.state(slow) is LifecycleState.ERROR
            assert isinstance(slow.last_error, HookTimeout)
            assert "slow.on_execute: did not return within 0.5 s" in str(slow.last_error)
            assert isinstance(slow.last_error.__cause__, asyncio.CancelledError)

    simulate(main)


@pytest.mark.fault("A06")
@pytest.mark.parametrize("where", ["on_execute", "on_deactivated", "on_finalize"])
def test_kernel_with_many_stuck_components_in_several_contexts_closes_within_five_seconds(where: str) -> None:
    async def main(clock: SimulatedClock) -> float:
        stuck: list[Stuck] = []
        async with Kernel() as kernel:
            for number in range(4):
                kinds: Any = [PeriodicContext(10.0), EventContext()]
                members = [await kernel.add(Stuck(f"s{number}_{n}", where)) for n in range(12)]
                stuck += members
                await kernel.start(kinds[number % 2], *members, activate=True)
            await clock.advance(0.3)
            began = asyncio.get_running_loop().time()
        took = asyncio.get_running_loop().time() - began
        await let_go(*stuck)
        return took

    assert simulate(main) <= 5.0


def test_neighbour_of_a_stuck_component_has_time_for_its_own_way_out() -> None:
    class Tidy(Component):
        done = False

        async def on_deactivated(self) -> None:
            await asyncio.sleep(0.05)
            self.done = True

    async def main(clock: SimulatedClock) -> bool:
        async with Kernel() as kernel:
            tidy, stuck = await kernel.add(Tidy("tidy")), await kernel.add(Stuck("stuck"))
            await kernel.start(PeriodicContext(10.0), tidy, stuck, activate=True)
            await clock.advance(0.1)
        await let_go(stuck)
        return tidy.done

    assert simulate(main)


@pytest.mark.slow(
    kept_by="test_hook_over_its_deadline_is_cancelled_each_half_second_then_abandoned_and_the_neighbour_runs_on"
)
@pytest.mark.fault("A06")
@pytest.mark.fault("A07")
@pytest.mark.parametrize(("kind", "loop"), [(Stuck, "uvloop"), (StuckInFinally, "asyncio")])
def test_process_goes_on_and_ends_after_a_hook_that_ignores_cancellation(kind: type[Stuck], loop: str) -> None:
    """In real time: the loop is idle meanwhile, the kernel closes in time and `run` returns."""
    import aiorts

    async def main() -> tuple[Stuck, float, float]:
        kernel = await Kernel().open()
        stuck = await kernel.add(kind("stuck"))
        await kernel.start(EventContext(), stuck)
        context = await kernel.start(ExternalContext(), stuck)
        await context.activate(stuck)
        tick = asyncio.create_task(context.tick())
        await asyncio.sleep(0.05)
        began, used = time.monotonic(), time.process_time()
        await kernel.aclose()
        await asyncio.gather(tick, return_exceptions=True)
        return stuck, time.monotonic() - began, time.process_time() - used

    stuck, took, used = aiorts.run(main, loop=loop)
    assert took <= 5.0
    assert used <= 0.1 * took
    assert isinstance(stuck.last_error, HookAbandoned)


def test_abandoned_component_is_never_run_again_anywhere_and_can_be_removed() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            stuck = await kernel.add(Stuck("stuck"))
            one = await kernel.start(PeriodicContext(10.0, deadline=0.1), stuck)
            two = await kernel.start(PeriodicContext(10.0, deadline=0.1), stuck, activate=True)
            await one.activate()
            await clock.advance(3.0)
            assert stuck.runs == 1
            stuck.where = "on_finalize"
            await kernel.remove(stuck)
            assert (one.members, two.members, dict(kernel.components)) == ((), (), {})
            assert stuck.runs == 1
            await let_go(stuck)

    simulate(main)


class Chatter(Component):
    out = OutPort(TimedLong)

    async def on_execute(self) -> None:
        while True:
            await self.out.write(TimedLong(0, 1))


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.fault("A11")
@pytest.mark.parametrize("turns", [5, 25])
async def test_endless_writes_without_another_await_let_everybody_else_run(anyio_backend: Any, turns: int) -> None:
    async with Kernel() as kernel:
        chatter, healthy = await kernel.add(Chatter("chatter")), await kernel.add(PlainDiary("healthy"))
        context = await kernel.start(PeriodicContext(100.0), healthy, activate=True)
        await kernel.start(PeriodicContext(100.0), chatter)
        late = []
        asyncio.get_running_loop().create_task(kernel.contexts["periodic1"].activate())
        for _ in range(turns):
            before = time.monotonic()
            await asyncio.sleep(0.01)
            late.append(time.monotonic() - before - 0.01)
        assert healthy.count("on_execute") >= 0.8 * turns
        assert sorted(late)[-2] <= 0.25
        began = time.monotonic()
        await context.stop()
    assert time.monotonic() - began <= 4.6


@pytest.mark.slow(kept_by="test_host_that_cancels_every_task_gets_them_all_ended")
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_loop_that_ends_with_an_open_kernel_stops_its_contexts_in_order(
    loop: str, caplog: pytest.LogCaptureFixture
) -> None:
    import aiorts

    diary = PlainDiary("pid0")

    class Waiting(Component):
        async def on_execute(self) -> None:
            await asyncio.Event().wait()

    async def main() -> None:
        kernel = await Kernel().open()
        await kernel.add(diary)
        await kernel.start(PeriodicContext(100.0, name="loop"), diary, activate=True)
        await kernel.start(PeriodicContext(100.0, name="busy"), await kernel.add(Waiting("w")), activate=True)
        await asyncio.sleep(0.03)

    began = time.monotonic()
    aiorts.run(main, loop=loop)
    assert time.monotonic() - began < 1.0
    assert diary.ran[-2:] == ["on_deactivated", "on_shutdown"]
    assert diary.last_error is None
    assert "context loop: its task was cancelled by the application" in caplog.text


@pytest.mark.anyio
async def test_host_that_cancels_every_task_gets_them_all_ended(
    anyio_backend: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    diary = PlainDiary("pid0")
    async with Kernel() as kernel:
        await kernel.add(diary)
        context = await kernel.start(PeriodicContext(100.0), diary, activate=True)
        ours: Any = context.runner.driver
        ours.task.cancel()
        await asyncio.wait_for(asyncio.gather(ours.task, return_exceptions=True), 2.0)
        assert not context.running
        assert not kernel.contexts
    assert diary.ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"]
