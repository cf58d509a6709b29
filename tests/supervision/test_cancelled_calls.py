"""Every public coroutine is cancelled at each of its awaits: no task is left, no lock stuck, the kernel goes on."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    StartRule,
)
from aiorts.errors import AiortsError
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from aiorts import SimulatedClock

    Call = Callable[["World"], Coroutine[Any, Any, Any]]


class Part(Component):
    """Every hook waits a little."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0)

    async def _wait(self) -> None:
        await asyncio.sleep(0)
        await self.sleep(0.001)

    async def on_initialize(self) -> None:
        await self._wait()

    async def on_finalize(self) -> None:
        await self._wait()

    async def on_startup(self) -> None:
        await self._wait()

    async def on_shutdown(self) -> None:
        await self._wait()

    async def on_activated(self) -> None:
        await self._wait()

    async def on_deactivated(self) -> None:
        await self._wait()

    async def on_reset(self) -> None:
        await self._wait()

    async def on_rate_changed(self) -> None:
        await self._wait()


class World:
    """A small running system, the same for each cancellation."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel

    async def build(self) -> World:
        kernel = self.kernel
        self.one, self.two = await kernel.create(Part, "one"), await kernel.create(Part, "two")
        self.free = await kernel.create(Part, "free")
        self.context = await kernel.start(PeriodicContext(100.0), self.one, self.two)
        self.connector = await kernel.connect(self.one.out, self.two.inp, length=1, full="block", timeout=None)
        return self


async def _full(world: World) -> None:
    await world.context.activate()
    world.one.out.write_nowait(TimedDouble(0, 1.0))
    await world.one.out.write(TimedDouble(0, 2.0))


FOR_EVER = ("wait_stop_requested", "port.read", "port.write")
"""Nobody gives them what they wait for."""
CALLS: dict[str, Call] = {
    "create": lambda w: w.kernel.create(Part, "new"),
    "add": lambda w: w.kernel.add(Part("new")),
    "remove": lambda w: w.kernel.remove(w.one),
    "connect": lambda w: w.kernel.connect(w.one.out, w.free.inp),
    "disconnect": lambda w: w.kernel.disconnect(w.connector),
    "start": lambda w: w.kernel.start(EventContext(), w.free, activate=True),
    "stop": lambda w: w.kernel.stop(w.context),
    "sleep": lambda w: w.kernel.sleep(0.01),
    "aclose": lambda w: w.kernel.aclose(),
    "wait_stop_requested": lambda w: w.kernel.wait_stop_requested(),
    "wait_ready": lambda w: w.kernel.wait_ready(timeout=0.01),
    "start_in_order": lambda w: w.kernel.start_in_order([StartRule("two"), StartRule("one", "two", wait=0.01)]),
    "stop_in_order": lambda w: _started_and_stopped(w),
    "context.activate": lambda w: w.context.activate(),
    "context.deactivate": lambda w: _activated(w, w.context.deactivate),
    "context.reset": lambda w: _failed(w),
    "context.add": lambda w: w.context.add(w.free),
    "context.remove": lambda w: w.context.remove(w.one),
    "context.set_rate": lambda w: w.context.set_rate(50.0),
    "context.stop": lambda w: w.context.stop(),
    "component.configure": lambda w: w.one.configure(gain=2.0),
    "component.sleep": lambda w: w.one.sleep(0.01),
    "port.read": lambda w: w.free.inp.read(),
    "port.write": _full,
}


async def _started_and_stopped(world: World) -> None:
    await world.kernel.start_in_order([StartRule("two"), StartRule("one")])
    await world.kernel.stop_in_order()


async def _activated(world: World, then: Callable[[], Coroutine[Any, Any, None]]) -> None:
    await world.context.activate()
    await then()


async def _failed(world: World) -> None:
    await world.context.activate(world.one)
    world.context.runner.life.failed(world.context.runner.member(world.one), "on_execute", RuntimeError("told to"))
    await world.kernel.sleep(0.02)
    await world.context.reset(world.one)


async def cancelled_after(turns: int, call: Call, clock: SimulatedClock, kind: type[World] = World) -> bool:
    """Whether the call was still under way after so many turns of the loop; then it was cancelled."""
    before = asyncio.all_tasks()
    async with Kernel() as kernel:
        world = await kind(kernel).build()
        task = asyncio.ensure_future(call(world))
        for turn in range(turns):
            # Hooks wait for the clock, too: it goes on a little now and then.
            await (clock.advance(0.0005) if turn % 4 == 3 else asyncio.sleep(0))
        under_way = not task.done()
        task.cancel()
        await asyncio.wait([task], timeout=10.0)
        assert task.done()
        if not task.cancelled() and (error := task.exception()) is not None:
            assert isinstance(error, AiortsError), error
        if not kernel.closed:
            # The kernel works as before: what the call locked is free again.
            fresh = await kernel.create(Part, "fresh")
            context = await kernel.start(PeriodicContext(100.0), fresh, activate=True)
            assert fresh.state is LifecycleState.ACTIVE
            if "one" in kernel.components and world.context.running and world.one.contexts:
                await world.one.configure(gain=3.0)
            await kernel.stop(context)
            await kernel.remove(fresh)
    assert asyncio.all_tasks() == before
    return under_way


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("G05")
@pytest.mark.parametrize("name", CALLS)
def test_cancelled_at_every_turn_it_leaves_nothing_behind(name: str) -> None:
    at = 0
    while simulate(lambda clock, turns=at: cancelled_after(turns, CALLS[name], clock)):  # type: ignore[misc]
        at += 1
        if at > 100 and name in FOR_EVER:
            return
        assert at < 400
    assert name not in FOR_EVER
    assert at > 0
