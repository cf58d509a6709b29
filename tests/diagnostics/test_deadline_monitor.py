"""A hook that waits forever is detected within twice its limit, per component and per hook; the others go on."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from aiorts import Component, EventContext, Kernel, LifecycleState, PeriodicContext, Supervision
from aiorts.errors import ComponentError, HookTimeout
from aiorts.events import HookFailed
from aiorts.kernel.execution.cell import cell
from aiorts.testing import simulated

if TYPE_CHECKING:
    from aiorts import SimulatedClock

LIMIT = 0.5


class Stuck(Component):
    """Waits forever in one hook."""

    def __init__(self, name: str = "", where: str = "on_execute") -> None:
        super().__init__(name)
        self.where = where
        self.ran = 0

    async def _maybe(self, hook: str) -> None:
        if self.where == hook:
            await asyncio.Event().wait()

    async def on_activated(self) -> None:
        await self._maybe("on_activated")

    async def on_execute(self) -> None:
        await self._maybe("on_execute")
        self.ran += 1

    async def on_deactivated(self) -> None:
        await self._maybe("on_deactivated")

    async def on_state_update(self) -> None:
        await self._maybe("on_state_update")


class Neighbour(Component):
    """Counts its cycles."""

    ran = 0

    def on_execute(self) -> None:
        self.ran += 1


@pytest.mark.anyio
@pytest.mark.parametrize("ages", [1e300, 10**300, 10**400], ids=["1e300", "300 digits", "400 digits"])
@pytest.mark.parametrize("kind", [EventContext, PeriodicContext])
async def test_a_limit_of_ages_is_a_limit_that_never_comes(
    ages: float, kind: type[EventContext | PeriodicContext]
) -> None:
    async with Kernel() as kernel:
        context = await kernel.start(kind(deadline=ages), neighbour := await kernel.create(Neighbour))
        kernel.supervise(neighbour, Supervision(restart="reset", window=ages, deadline=ages, backoff_max=ages))
        await context.activate()
        assert kernel.watch_loop(ages) in (True, False)
        async with asyncio.timeout(30.0):
            while not neighbour.ran:
                context.trigger() if isinstance(context, EventContext) else None
                await kernel.sleep(0.01)
        assert neighbour.last_error is None


@pytest.mark.fault("A08")
@pytest.mark.row(16)
@pytest.mark.parametrize("where", ["on_activated", "on_execute", "on_state_update"])
@pytest.mark.parametrize("how", ["component", "hook", "context"])
@pytest.mark.parametrize("kind", ["periodic", "shared"])
@simulated
async def test_waiting_for_ever_is_detected_within_twice_the_limit(
    where: str, how: str, kind: str, simulated_clock: SimulatedClock
) -> None:
    failed: list[tuple[float, HookFailed]] = []
    async with Kernel() as kernel:
        kernel.bus.subscribe(HookFailed, lambda event: failed.append((simulated_clock.monotonic_ns() / 1e9, event)))
        stuck, other, aside = Stuck("stuck", where), Neighbour("other"), Neighbour("aside")
        for component in (stuck, other, aside):
            await kernel.add(component)
        limits = {
            "component": Supervision(deadline=LIMIT),
            "hook": Supervision(deadline=100.0, deadlines={where: LIMIT}),
            "context": Supervision(),
        }
        kernel.supervise(stuck, limits[how])
        context = await kernel.start(PeriodicContext(100.0, deadline=LIMIT if how == "context" else None), stuck, other)
        await kernel.start(PeriodicContext(100.0), aside, activate=True)
        if kind == "shared":
            await kernel.start(EventContext(), stuck)
        await context.activate(other)
        begun = simulated_clock.monotonic_ns() / 1e9
        try:
            await context.activate(stuck)
        except ComponentError:
            assert where == "on_activated"
        await simulated_clock.advance(2.0)
        assert len(failed) == 1
        at, event = failed[0]
        assert at - begun <= 2 * LIMIT
        assert at - begun >= LIMIT
        assert (event.component, event.hook) == ("stuck", where)
        assert isinstance(event.error, HookTimeout)
        assert f"stuck.{where}" in str(event.error)
        assert f"{LIMIT} s" in str(event.error)
        assert context.state(stuck) is LifecycleState.ERROR
        assert aside.ran >= 190  # never held up
        assert other.ran >= 100  # held up for one limit only


@simulated
async def test_hooks_without_a_limit_of_their_own_are_left_to_the_context(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        stuck = await kernel.add(Stuck("stuck", "on_execute"))
        kernel.supervise(stuck, Supervision(deadlines={"on_activated": 0.1}))
        context = await kernel.start(PeriodicContext(100.0), stuck, activate=True)
        await simulated_clock.advance(100.0)
        assert context.state(stuck) is LifecycleState.ACTIVE
        kernel.supervise(stuck, Supervision())
        assert cell(stuck).deadlines is None


@simulated
async def test_what_returns_in_time_is_nobodys_affair(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        one = await kernel.add(Stuck("one", ""))
        context = await kernel.start(PeriodicContext(100.0), one, activate=True)
        kernel.supervise(one, Supervision(deadline=0.001))
        await simulated_clock.advance(1.0)
        assert context.state(one) is LifecycleState.ACTIVE
        assert one.ran >= 99
        kernel.supervise(one, Supervision())
        await simulated_clock.advance(1.0)
        assert one.ran >= 198


@simulated
async def test_the_limit_goes_with_the_place_to_a_new_instance(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        stuck = await kernel.add(Stuck("stuck", "on_execute"))
        policy = Supervision("restart", budget=2, deadline=LIMIT)
        handle = kernel.supervise(stuck, policy, factory=lambda name: Stuck(name, "on_execute"))
        await kernel.start(PeriodicContext(100.0), stuck, activate=True)
        await simulated_clock.advance(10.0)
        now = kernel.components["stuck"]
        assert now is not stuck
        assert isinstance(now.last_error, HookTimeout)
        assert handle.attempts == 2
        assert handle.exhausted
