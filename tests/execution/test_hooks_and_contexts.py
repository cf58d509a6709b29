"""Things that once went wrong where a hook, its own tasks and its context meet."""

from __future__ import annotations

import asyncio

import anyio
import pytest

from aiorts import Component, Kernel, LifecycleState, PeriodicContext, SimulatedClock
from aiorts.errors import ConfigurationError, StateError
from aiorts.testing.simulation import simulate


class Waits(Component):
    scope: anyio.CancelScope | None = None

    async def on_execute(self) -> None:
        with anyio.CancelScope() as self.scope:
            await anyio.sleep(100.0)


def test_a_cancel_scope_that_ends_a_hook_from_outside_does_not_stop_its_context() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            waits = await kernel.add(Waits("waits"))
            context = await kernel.start(PeriodicContext(100.0), waits, activate=True)
            await asyncio.sleep(0.1)
            assert waits.scope is not None
            waits.scope.cancel()
            await asyncio.sleep(0.1)
            assert context.running
            assert waits.state is LifecycleState.ACTIVE

    simulate(main)


def test_a_request_of_a_hook_through_a_task_of_its_own_is_queued_and_waits_for_nothing() -> None:
    async def main(clock: SimulatedClock) -> None:
        took: list[float] = []

        class Asks(Component):
            async def on_execute(self) -> None:
                began = clock.time()
                await asyncio.wait_for(self.context.deactivate(self), 10.0)
                took.append(clock.time() - began)

        async with Kernel() as kernel:
            asks = await kernel.add(Asks("asks"))
            await kernel.start(PeriodicContext(100.0), asks, activate=True)
            await asyncio.sleep(1.0)
            assert took == [0.0]
            assert asks.state is LifecycleState.INACTIVE

    simulate(main)


def test_a_component_that_still_comes_in_or_goes_is_started_by_nobody() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Slow(Component):
            async def on_initialize(self) -> None:
                await self.sleep(1.0)

        async with Kernel() as kernel:
            slow = Slow("slow")
            adding = asyncio.ensure_future(kernel.add(slow))
            await asyncio.sleep(0.5)
            with pytest.raises(StateError, match="on_initialize still runs"):
                await kernel.start(PeriodicContext(100.0), slow)
            await adding

    simulate(main)


def test_a_context_that_named_itself_starts_again_beside_another_of_its_kind() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            first = await kernel.start(PeriodicContext(10.0))
            await first.stop()
            second = await kernel.start(PeriodicContext(10.0))
            await kernel.start(first)
            assert {first.name, second.name} == set(kernel.contexts)

    simulate(main)


@pytest.mark.parametrize("deadline", [0.0, -1.0, float("nan"), float("inf"), "2"])
def test_a_deadline_that_is_no_time_is_refused(deadline: float) -> None:
    with pytest.raises(ConfigurationError, match="deadline"):
        PeriodicContext(10.0, deadline=deadline)


def test_time_that_is_advanced_waits_for_a_cycle_whose_hooks_give_turns() -> None:
    async def main() -> None:
        clock = SimulatedClock()
        ran = 0

        class Yielding(Component):
            async def on_execute(self) -> None:
                nonlocal ran
                await asyncio.sleep(0)
                ran += 1

        async with Kernel(clock=clock) as kernel:
            members = [await kernel.create(Yielding) for _ in range(100)]
            await kernel.start(PeriodicContext(10.0), *members, activate=True)
            await clock.advance(0.05)
            ran = 0
            await clock.advance(0.1)
            assert ran == 100

    asyncio.run(main())
