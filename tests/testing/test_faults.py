"""Components that misbehave: each does what it says, in the hook it was told, and only then."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import ExternalContext, Kernel, LifecycleState
from aiorts.errors import DeclarationError, HookAbandoned, HookTimeout, StateError
from aiorts.model.lifecycle import HOOKS
from aiorts.testing import Rig, current_clock, faults, simulated


@pytest.mark.parametrize("hook", ["on_startup", "on_activated", "on_execute", "on_state_update"])
@simulated
async def test_failing_fails_in_the_hook_it_was_told(hook: str) -> None:
    component = faults.Failing(hook, OSError("told to"), name="f")
    async with Rig(component, activate=False, strict=False) as rig:
        if hook != "on_startup":
            with rig.expect_error(OSError):
                await rig.activate()
                await rig.tick()
        assert [(failure.component, failure.hook) for failure in rig.failures] == [("f", hook)]
        assert rig.context.state(component) is LifecycleState.ERROR


@simulated
async def test_failing_fails_as_often_and_as_late_as_told() -> None:
    component = faults.Failing("on_execute", after=2, times=1)
    async with Rig(component) as rig:
        await rig.tick(2)
        with pytest.raises(RuntimeError, match="on_execute fails as instructed"):
            await rig.tick()
        await rig.reset()
        await rig.activate()
        await rig.tick(2)
    assert (component.calls, component.cycles) == (5, 5)


def test_unknown_hook_is_refused() -> None:
    with pytest.raises(DeclarationError, match="'on_tick' is no hook; there are on_initialize"):
        faults.Failing("on_tick")
    for hook in HOOKS:
        assert faults.Hanging(hook).hook == hook


@simulated
async def test_hanging_ignores_cancellation_until_it_is_left_behind() -> None:
    component = faults.Hanging("on_execute", name="h")
    async with Kernel() as kernel:
        await kernel.add(component)
        context = await kernel.start(ExternalContext(deadline=0.1), component, activate=True)
        await context.tick()
        assert isinstance(component.last_error, HookAbandoned)
        assert component.cancelled == 4
    component.release()
    await asyncio.sleep(0)


@simulated
async def test_cancellable_hanging_ends_at_its_deadline() -> None:
    component = faults.Hanging("on_execute", cancellable=True)
    async with Kernel() as kernel:
        await kernel.add(component)
        context = await kernel.start(ExternalContext(deadline=0.1), component, activate=True)
        await context.tick()
        assert type(component.last_error) is HookTimeout
        assert kernel.clock.monotonic_ns() == 100_000_000


@simulated
async def test_slow_takes_virtual_time() -> None:
    async with Rig(faults.Slow("on_execute", 1.5)) as rig:
        await rig.tick(2)
        assert rig.clock.time() == 3.0


@simulated
async def test_blocking_takes_no_virtual_time() -> None:
    clock = current_clock()
    async with Rig(faults.Blocking("on_execute", 0.001, times=1)) as rig:
        await rig.tick()
        assert rig.clock is clock
        assert rig.clock.time() == 0.0


@simulated
async def test_returning_returns_what_it_was_told() -> None:
    async with Rig(faults.Returning("on_execute", 0)) as rig:
        with pytest.raises(StateError, match="returned int 0"):
            await rig.tick()


@pytest.mark.parametrize("what", ["task", "thread"])
@simulated
async def test_leaking_leaves_something_until_released(what: str) -> None:
    component = faults.Leaking("on_execute", what)
    async with Rig(component) as rig:
        await rig.tick(2)
        left = component.task if what == "task" else component.thread
        assert left is not None
        assert not left.done() if isinstance(left, asyncio.Task) else left.is_alive()
        component.release()
    with pytest.raises(ValueError, match='expected "task" or "thread"'):
        faults.Leaking("on_execute", "file")


@simulated
async def test_flooding_numbers_what_it_writes() -> None:
    async with Rig(faults.Flooding(3)) as rig:
        await rig.tick(2)
        assert rig.values("out") == [1, 2, 3, 4, 5, 6]
