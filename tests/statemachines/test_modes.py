"""Modes and participants: the hooks that OpenRTM has as interfaces and never runs are run."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import (
    EventContext,
    Kernel,
    LifecycleState,
    MultiModeComponent,
    Participant,
    PeriodicContext,
    SimulatedClock,
    StateMachineComponent,
    ThreadContext,
)
from aiorts.errors import ComponentError, DeclarationError, StateError, TransitionTimeout
from aiorts.events import MachineChanged, ModeChanged
from aiorts.testing import Rig, simulate, simulated
from statemachines.test_state_machine import Door

pytestmark = [pytest.mark.anyio, pytest.mark.row(18)]


class Arm(MultiModeComponent):
    modes = ("manual", "automatic", "broken")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[Any] = []

    async def on_mode_changed(self) -> None:
        self.seen.append((self.mode, self.state, self.context.name))
        if self.mode == "broken":
            raise RuntimeError("no such gear")


@pytest.mark.parametrize("context", [EventContext, lambda: PeriodicContext(rate=0.001)])
async def test_a_mode_changes_between_cycles_and_the_hook_is_run(context: Any) -> None:
    """OpenRTM never calls on_mode_changed; here neither a tick nor data is waited for."""
    arm = Arm("arm0")
    async with Kernel() as kernel:
        told: list[ModeChanged] = []
        kernel.bus.subscribe(ModeChanged, told.append)
        await kernel.add(arm)
        assert arm.mode == arm.default_mode == "manual"
        loop = await kernel.start(context(), arm, activate=True)
        await arm.set_mode("automatic")
        assert arm.seen == [("automatic", LifecycleState.ACTIVE, loop.name)]
        assert told == [ModeChanged("arm0", loop.name, "manual", "automatic")]
        await arm.set_mode("automatic")
        assert len(arm.seen) == 1
        assert (arm.mode, arm.pending_mode, dict(arm.modes_by_context)) == (
            "automatic",
            None,
            {loop.name: "automatic"},
        )


async def test_a_hook_that_raises_moves_the_component_to_error_and_the_caller_is_told() -> None:
    arm = Arm("arm0")
    async with Kernel() as kernel:
        await kernel.add(arm)
        loop = await kernel.start(EventContext(), arm, activate=True)
        with pytest.raises(ComponentError, match="on_mode_changed raised RuntimeError: no such gear"):
            await arm.set_mode("broken")
        await kernel.sleep(0)
        assert arm.state is LifecycleState.ERROR
        with pytest.raises(StateError, match="reset it first"):
            await arm.set_mode("manual")
        await loop.reset()
        await arm.set_mode("manual")
        assert arm.mode == "manual"


async def test_a_mode_is_changed_in_each_context_for_itself() -> None:
    arm = Arm("arm0")
    async with Kernel() as kernel:
        await kernel.add(arm)
        one = await kernel.start(EventContext(name="one"), arm, activate=True)
        two = await kernel.start(EventContext(name="two"), arm, activate=True)
        await arm.set_mode("automatic")
        assert [(mode, where) for mode, _, where in arm.seen] == [("automatic", "one"), ("automatic", "two")]
        assert dict(arm.modes_by_context) == {one.name: "automatic", two.name: "automatic"}


async def test_a_mode_asked_for_in_a_hook_of_its_own_is_queued() -> None:
    class Eager(Arm):
        async def on_activated(self) -> None:
            await self.set_mode("automatic")
            self.seen.append((self.mode, self.pending_mode))

    async with Rig(Eager("e0"), context=EventContext(name="ec")) as rig:
        await rig.tick()
        eager: Any = rig.components[0]
        assert eager.seen == [("manual", "automatic"), ("automatic", LifecycleState.ACTIVE, "ec")]


async def test_what_is_no_mode_or_no_hook_is_refused() -> None:
    with pytest.raises(StateError, match="no mode 'automatik'; did you mean 'automatic'"):
        await Arm("arm0").set_mode("automatik")
    with pytest.raises(DeclarationError, match="did you mean on_mode_changed"):
        type("Bad", (MultiModeComponent,), {"modes": ("a",), "on_mode_change": lambda self: None})
    with pytest.raises(DeclarationError, match="expected names, each once"):
        type("Twice", (MultiModeComponent,), {"modes": ("a", "a")})
    with pytest.raises(DeclarationError, match="has no modes"):
        MultiModeComponent()
    async with Kernel() as kernel:
        await kernel.add(arm := Arm("arm0"))
        with pytest.raises(StateError, match="on_mode_changed"):
            await kernel.start(ThreadContext(rate=10.0), arm)


class Lamp(Participant):
    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[Any] = []

    def on_action(self, change: MachineChanged) -> None:
        self.seen.append((change.event, change.new, self.context.name))
        if change.new == ("open",):
            raise RuntimeError("bulb")


def test_a_participant_is_told_of_each_change_in_its_own_context() -> None:
    async def main(clock: Any) -> None:
        door, lamp = Door("door0"), Lamp("lamp0")
        async with Kernel() as kernel:
            await kernel.add(door)
            await kernel.add(lamp)
            door.machine.add_participant(lamp)
            await kernel.start(EventContext(name="a"), door, activate=True)
            await kernel.start(EventContext(name="b"), lamp, activate=True)
            door.machine.send("button")
            await kernel.sleep(1.0)
            assert lamp.seen == [("button", ("moving", "opening"), "b")]
            await kernel.sleep(2.0)
            assert lamp.seen[1:] == [("after.opening.1", ("open",), "b")]
            assert lamp.state is LifecycleState.ERROR
            assert door.state is LifecycleState.ACTIVE
            await kernel.sleep(6.0)
            assert len(lamp.seen) == 2

    simulate(main)


def test_a_component_may_have_both() -> None:
    class Both(Arm, StateMachineComponent):
        chart = Door.chart
        lamp_on = lamp_off = motor_on = motor_off = lambda self: None
        is_near = complain = lambda self, sample: None
        dwell = 1.0

    both = Both("both0")
    assert both.mode == "manual"
    assert both.machine.chart is Door.chart


@pytest.mark.row(18)
@simulated
async def test_a_mode_that_nobody_waits_for_any_more_is_not_pending(simulated_clock: SimulatedClock) -> None:
    class Slow(MultiModeComponent):
        modes = ("manual", "automatic", "off")

        async def on_execute(self) -> None:
            await self.sleep(0.05)

    async with Kernel() as kernel:
        slow = await kernel.add(Slow("slow"))
        await kernel.start(PeriodicContext(10.0), slow, activate=True)
        await simulated_clock.advance(0.01)
        asked = asyncio.ensure_future(slow.set_mode("automatic"))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert slow.pending_mode == "automatic"
        asked.cancel()
        await asyncio.wait([asked])
        assert slow.pending_mode is None
        for mode, limits in (("off", (0.001, 5.0)), ("manual", (5.0, 0.001))):
            first, second = [asyncio.ensure_future(slow.set_mode(mode, timeout=limit)) for limit in limits]
            withdrawn, waiting = (first, second) if limits[0] < limits[1] else (second, first)
            await simulated_clock.advance(0.01)
            with pytest.raises(TransitionTimeout):
                await withdrawn
            assert slow.pending_mode == mode  # somebody else asked for it as well
            await waiting
            assert (slow.mode, slow.pending_mode) == (mode, None)
            await simulated_clock.advance(0.06)  # into the next cycle


@simulated
async def test_a_mode_asked_for_later_is_pending_until_it_has_come() -> None:
    class Noting(MultiModeComponent):
        modes = ("manual", "automatic", "off")

        async def on_execute(self) -> None:
            await self.sleep(0.05)

        async def on_mode_changed(self) -> None:
            notes.append((self.mode, self.pending_mode))

    notes: list[tuple[str, str | None]] = []
    async with Kernel() as kernel:
        noting = await kernel.add(Noting("noting"))
        await kernel.start(PeriodicContext(10.0), noting, activate=True)
        await kernel.sleep(0.01)
        asked = [asyncio.create_task(noting.set_mode(mode)) for mode in ("automatic", "off", "manual")]
        await asyncio.gather(*asked)
    assert notes == [("automatic", "manual"), ("off", "manual"), ("manual", None)]
