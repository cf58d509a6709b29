"""State machines in a system: the conformance suite, deadlines, determinism, threads, ports added while running."""

from __future__ import annotations

import asyncio
import itertools
import logging
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import (
    EventContext,
    EventPort,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    StateMachineComponent,
    ThreadContext,
)
from aiorts.errors import HookTimeout
from aiorts.statechart import After, Chart, On, State
from aiorts.testing import Rig, check_component, simulate
from aiorts.types import TimedDouble, TimedLong
from statemachines.test_state_machine import Buttons, Door, Player, Sorter, Told


@pytest.mark.slow(kept_by="first")
def test_a_machine_passes_the_suite_that_every_component_passes() -> None:
    check_component(Door)
    check_component(Player)


@pytest.mark.row(102)
def test_an_action_over_its_deadline_is_cancelled_and_what_was_entered_is_left() -> None:
    class Stuck(Told):
        go = EventPort(TimedLong)
        chart = Chart(
            State("a", On("go", to="b"), initial=True),
            State("b", entry="wait", exit="tell"),
        )

        async def wait(self) -> None:
            self.told.append("waits")
            await asyncio.sleep(3600)

    async def main(clock: Any) -> None:
        async with Kernel() as kernel:
            stuck, buttons = await kernel.add(Stuck("s0")), await kernel.add(Buttons("b0"))
            await kernel.connect(buttons.out, stuck.go)
            context = await kernel.start(EventContext(deadline=0.2), stuck, activate=True)
            buttons.out.write_nowait(TimedLong(0, 1))
            await kernel.sleep(1.0)
            assert stuck.state is LifecycleState.ERROR
            assert isinstance(stuck.last_error, HookTimeout)
            assert stuck.told[0] == "waits"
            assert len(stuck.told) == 2
            assert stuck.machine.configuration == ()
            assert context.running

    simulate(main)


moves = st.lists(st.tuples(st.sampled_from(["button", "obstacle"]), st.floats(0.0, 3.0)), max_size=15)


@pytest.mark.slow
@pytest.mark.row(103)
@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(moves)
def test_the_same_events_give_the_same_course_to_the_nanosecond(played: list[tuple[str, float]]) -> None:
    def run() -> list[Any]:
        course: list[Any] = []

        async def main(clock: Any) -> None:
            from aiorts.events import MachineChanged

            async with Kernel() as kernel:
                door = await kernel.add(Door("door0"))
                kernel.bus.subscribe(MachineChanged, lambda e: course.append((clock.monotonic_ns(), e)))
                await kernel.start(EventContext(), door, activate=True)
                for event, pause in played:
                    door.machine.send(event, TimedDouble(0, pause / 3))
                    await kernel.sleep(pause)
                await kernel.sleep(20.0)

        simulate(main)
        return course

    first = run()
    assert run() == first
    # Every stay in a state that only a timer ends is as long as the timer, exactly.
    for (entered, change), (left, following) in itertools.pairwise(first):
        if following.event == "after.opening.1":
            assert left - entered == 2_000_000_000
            assert "opening" in change.new


@pytest.mark.anyio
@pytest.mark.row(102)
async def test_an_event_port_is_added_while_the_machine_runs() -> None:
    sorter = Sorter("s0")
    async with Rig(sorter, context=PeriodicContext(rate=10.0)) as rig:
        sorter.add_event_port("halt", EventPort(TimedLong, event="stop"))
        rig.feed("halt", 7)
        await rig.tick()
        assert sorter.told == [("stop", 7)]
        sorter.remove_port("halt")
        rig.feed("a", 1)
        await rig.tick()
        assert sorter.told[1:] == [("a", 1)]


@pytest.mark.anyio
async def test_an_event_of_a_connector_that_no_transition_is_for_is_said_once(caplog: Any) -> None:
    sorter, buttons = Sorter("s0"), Buttons("b0")
    async with Rig(buttons, sorter, context=EventContext()) as rig:
        rig.connect("b0.out", "s0.a", fsm_event_name="stpo")
        with caplog.at_level(logging.WARNING):
            for number in range(3):
                buttons.out.write_nowait(TimedLong(0, number))
            await rig.tick()
        assert sorter.machine.ignored == 3
    assert [r.getMessage() for r in caplog.records] == ["a: no transition is for event 'stpo'; did you mean 'stop'?"]


@pytest.mark.anyio
@pytest.mark.row(103)
async def test_timers_and_events_work_in_a_thread_without_a_rate() -> None:
    class Blink(StateMachineComponent):
        out = OutPort(TimedLong)
        chart = Chart(
            State("on", After(0.01, to="off"), entry="beat", initial=True), State("off", After(0.01, to="on"))
        )
        beats = 0

        def beat(self) -> None:
            self.beats += 1

    async with Kernel() as kernel:
        blink = await kernel.add(Blink("b0"))
        await kernel.start(ThreadContext(), blink, activate=True)
        for _ in range(500):
            if blink.beats >= 3:
                break
            await kernel.sleep(0.01)
        assert blink.beats >= 3


class PlainDoor(Told):
    button = EventPort(TimedLong)
    chart = Chart(
        State("closed", On("button", to="opening"), initial=True),
        State("opening", entry="motor_on", exit="motor_off"),
    )

    def motor_on(self) -> None:
        self.told.append("motor on")

    def motor_off(self) -> None:
        self.told.append("motor off")


@pytest.mark.anyio
@pytest.mark.parametrize("kind", [Door, PlainDoor])
async def test_a_machine_in_two_contexts_is_one_machine(kind: Any) -> None:
    door = kind("door0")
    async with Kernel() as kernel:
        await kernel.add(door)
        one = await kernel.start(EventContext(name="one"), door, activate=True)
        door.machine.send("button")
        await kernel.sleep(0.01)
        assert door.machine.is_in("opening")
        two = await kernel.start(EventContext(name="two"), door, activate=True)
        await one.deactivate()
        assert door.machine.is_in("opening")
        assert door.told == ["motor on"]
        await two.deactivate()
        assert door.machine.configuration == ()
        assert door.told == ["motor on", "motor off"]


@pytest.mark.slow(kept_by="statemachines/test_state_machine.py::test_a_machine_of_plain_actions_runs_in_a_thread")
@pytest.mark.anyio
@pytest.mark.row(103)
async def test_a_machine_of_plain_actions_runs_in_a_real_time_thread() -> None:
    class Pulse(StateMachineComponent):
        go = EventPort(TimedLong)
        out = OutPort(TimedLong)
        chart = Chart(
            State("idle", On("go", to="high"), initial=True), State("high", After(0.01, to="idle"), entry="beat")
        )
        beats = 0

        def beat(self) -> None:
            self.beats += 1

    async with Kernel() as kernel:
        pulse, buttons = await kernel.add(Pulse("p0")), await kernel.add(Buttons("b0"))
        await kernel.connect(buttons.out, pulse.go)
        await kernel.start(RealtimeContext(rate=200.0, priority=None, lock_memory=False), pulse, activate=True)
        for wanted in (1, 2):
            buttons.out.write_nowait(TimedLong(0, wanted))
            for _ in range(500):
                if pulse.beats == wanted and pulse.machine.configuration == ("idle",):
                    break
                await kernel.sleep(0.01)
            assert pulse.beats == wanted
