"""A component that fails is reset or made anew in its place, as its policy says; a crash loop ends and says so once."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

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
    SimulatedClock,
    Supervision,
    ThreadContext,
)
from aiorts.errors import StateError
from aiorts.events import ComponentRecovered, RestartLimitReached
from aiorts.testing import simulated
from aiorts.types import TimedDouble

A, E, I = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE  # noqa: E741


class Crasher(Component):
    """Fails in the first cycle after each activation, as often as told."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0)
    crashes = 10**9
    made = 0
    resets = 0

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        type(self).made += 1
        self.ran = 0

    def on_execute(self) -> None:
        cls = type(self)
        if cls.crashes > 0:
            cls.crashes -= 1
            raise RuntimeError(f"crash of {self.name}")
        self.ran += 1

    def on_reset(self) -> None:
        type(self).resets += 1


def crasher(crashes: int) -> type[Crasher]:
    return type("Crasher", (Crasher,), {"crashes": crashes, "made": 0, "resets": 0})


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("A18")
@pytest.mark.row(17)
@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_crash_loop_is_helped_exactly_five_times_and_ends_in_one_line(
    action: str, simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    kind, helped, ended = crasher(10**9), [], []
    async with Kernel() as kernel:
        kernel.bus.subscribe(ComponentRecovered, helped.append)
        kernel.bus.subscribe(RestartLimitReached, ended.append)
        one = await kernel.create(kind, "one")
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        handle = kernel.supervise(one, Supervision(action))
        await simulated_clock.advance(300.0)
        assert (kind.made - 1 if action == "restart" else kind.resets) == 5
        assert handle.attempts == len(helped) == 5
        assert handle.exhausted
        assert kernel.components["one"].state is E
        assert len(ended) == 1
        assert ended[0].attempts == 5
        assert len(caplog.records) <= 10
        last = [record.getMessage() for record in caplog.records if "left alone" in record.getMessage()]
        assert len(last) == 1
        assert "one: " in last[0]
        assert "5 times within 30 s" in last[0]
        assert "RuntimeError: crash of one" in last[0]


@pytest.mark.row(17)
@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_what_recovers_goes_on_and_its_neighbour_never_stopped(
    action: str, simulated_clock: SimulatedClock
) -> None:
    kind, other = crasher(3), crasher(0)
    async with Kernel() as kernel:
        one, two = await kernel.create(kind, "one"), await kernel.create(other, "two")
        await kernel.start(PeriodicContext(100.0), one, two, activate=True)
        handle = kernel.supervise(one, Supervision(action))
        await simulated_clock.advance(2.0)
        now = kernel.components["one"]
        assert isinstance(now, Crasher)
        assert (now is one) is (action == "reset")
        assert handle.component is now
        assert handle.attempts == 3
        assert now.state is A
        assert now.ran > 100
        assert two.ran == pytest.approx(200, abs=2)


@simulated
async def test_restart_keeps_parameters_order_contexts_and_connectors(simulated_clock: SimulatedClock) -> None:
    kind, other = crasher(1), crasher(0)
    async with Kernel() as kernel:
        first, one, last = (
            await kernel.create(other, "first"),
            await kernel.create(kind, "one", gain=3.0),
            await kernel.create(other, "last"),
        )
        before = await kernel.connect(first.out, one.inp, length=5, full="reject", name="in")
        await kernel.connect(one.out, last.inp)
        await kernel.connect(one.out, one.inp)
        profiles = {name: connector.profile for name, connector in kernel.connectors.items()}
        context = await kernel.start(PeriodicContext(100.0), first, one, last, activate=True)
        aside = await kernel.start(EventContext(), one)
        kernel.supervise(one, Supervision("restart"))
        await one.configure(gain=4.0)
        await simulated_clock.advance(1.0)
        now: Any = kernel.components["one"]
        assert now is not one
        assert now.gain == 4.0
        assert context.members == (first, now, last)
        assert now.states == {context.name: A, aside.name: I}
        assert before.closed
        assert {name: c.profile for name, c in kernel.connectors.items()} == profiles
        first.out.write_nowait(TimedDouble(0, 7.0))
        now.out.write_nowait(TimedDouble(0, 8.0))
        assert [sample.data for sample in now.inp.drain()] == [7.0, 8.0]
        assert [sample.data for sample in last.inp.drain()] == [8.0]


@pytest.mark.slow(kept_by="supervision/test_restart_policy.py::test_never_is_never")
@simulated
async def test_in_the_old_world_a_component_in_error_stays_there(simulated_clock: SimulatedClock) -> None:
    kind = crasher(1)
    async with Kernel() as kernel:
        one = await kernel.create(kind, "one")
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        kernel.supervise(one, Supervision())
        await simulated_clock.advance(300.0)
        assert one.state is E
        kernel.supervise(one, Supervision("reset"))
        await simulated_clock.advance(0.2)
        assert one.state is A


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("fails_in", ["__init__", "on_initialize", "on_activated", "factory name"])
@simulated
async def test_a_new_instance_that_cannot_come_up_uses_the_budget_too(
    fails_in: str, simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    made = 0

    class Late(Component):
        def __init__(self, name: str = "") -> None:
            super().__init__(name)
            nonlocal made
            made += 1
            if made > 1 and fails_in == "__init__":
                raise ValueError("not again")

        def on_initialize(self) -> None:
            if made > 1 and fails_in == "on_initialize":
                raise ValueError("not again")

        def on_activated(self) -> None:
            if made > 1 and fails_in == "on_activated":
                raise ValueError("not again")

        def on_execute(self) -> None:
            raise RuntimeError("first")

    async with Kernel() as kernel:
        one = await kernel.create(Late, "one")
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        wrong = (lambda name: Late(name + "x")) if fails_in == "factory name" else None
        handle = kernel.supervise(one, Supervision("restart"), factory=wrong)
        await simulated_clock.advance(100.0)
        assert handle.exhausted
        assert made == 6
        assert caplog.text.count("left alone") == 1
        assert ("one" in kernel.components) is (fails_in == "on_activated")


@simulated
async def test_closing_removing_and_replacing_the_policy_end_what_is_under_way(
    simulated_clock: SimulatedClock,
) -> None:
    kind = crasher(10**9)
    async with Kernel() as kernel:
        one = await kernel.create(kind, "one")
        context = await kernel.start(PeriodicContext(100.0), one, activate=True)
        kernel.supervise(one, Supervision("restart", backoff=10.0))
        await simulated_clock.advance(1.0)
        kernel.supervise(one, Supervision("reset", backoff=5.0))
        await simulated_clock.advance(6.0)
        assert (kind.made, kind.resets) == (1, 1)
        await kernel.remove(one)
        assert not kernel.supervised
        with pytest.raises(StateError):
            kernel.supervise(one, Supervision("reset"))
        two = await kernel.create(kind, "two")
        await context.add(two)
        kernel.supervise(two, Supervision("restart", backoff=10.0))
        await context.activate(two)
        await simulated_clock.advance(1.0)
    assert kind.made == 2


@pytest.mark.slow
@simulated
async def test_a_hook_left_behind_cannot_be_reset_but_restarted(
    simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    made: list[Component] = []

    class Deaf(Component):
        def __init__(self, name: str = "") -> None:
            super().__init__(name)
            made.append(self)

        async def on_execute(self) -> None:
            while made.index(self) == 0:
                try:
                    await asyncio.Event().wait()
                except asyncio.CancelledError:
                    continue

    for action in ("reset", "restart"):
        made.clear()
        caplog.clear()
        async with Kernel() as kernel:
            one = await kernel.create(Deaf, "one")
            kernel.supervise(one, Supervision(action, deadline=0.1))
            await kernel.start(PeriodicContext(100.0), one, activate=True)
            await simulated_clock.advance(10.0)
            assert kernel.components["one"].state is (E if action == "reset" else A)
            assert caplog.text.count("left alone") == (1 if action == "reset" else 0)
            assert len(made) == (1 if action == "reset" else 2)


@pytest.mark.anyio
async def test_restart_in_a_thread_context() -> None:
    kind = crasher(2)
    async with Kernel() as kernel:
        one = await kernel.create(kind, "one")
        helped: list[ComponentRecovered] = []
        kernel.bus.subscribe(ComponentRecovered, helped.append)
        kernel.supervise(one, Supervision("restart", backoff=0.01))
        await kernel.start(ThreadContext(100.0), one, activate=True)
        now: Any = one
        async with asyncio.timeout(20.0):
            # The thread may have crashed it anew before the loop looks: then one ComponentRecovered tells of both.
            while kind.made < 3 or now.state is not A or now.ran == 0:  # type: ignore[attr-defined]
                await asyncio.sleep(0.01)
                now = kernel.components.get("one", one)
        assert helped[-1].attempt == 2
        assert now.ran > 0
