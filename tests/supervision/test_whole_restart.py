"""A restart brings everything back that the old instance stood for, whatever its constructor and exceptions do."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    Composite,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    Participant,
    PeriodicContext,
    SimulatedClock,
    StateMachineComponent,
    Supervision,
)
from aiorts.errors import DeclarationError, TransitionTimeout
from aiorts.events import MachineChanged
from aiorts.statechart import Chart, On, State
from aiorts.testing import simulated
from aiorts.types import TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable

A, E, I = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE  # noqa: E741


class Unprintable(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


class Part(Component):
    """Fails in its next cycle when told so."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0)
    configurations = {"soft": {"gain": 0.5}}  # noqa: RUF012
    raises: BaseException | None = None
    ran = 0

    def on_execute(self) -> None:
        if self.raises is not None:
            error, self.raises = self.raises, None
            raise error
        self.ran += 1


@pytest.mark.row(17)
@pytest.mark.fault("A18")
@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_a_component_whose_exception_has_no_text_is_helped_as_any(
    action: str, simulated_clock: SimulatedClock
) -> None:
    async with Kernel() as kernel:
        one = await kernel.create(Part, "one")
        handle = kernel.supervise(one, Supervision(action, backoff=1.0))
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        one.raises = Unprintable()
        await simulated_clock.advance(0.1)
        assert one.state is E
        with pytest.raises(TransitionTimeout, match=r"one is error in \S+ \(Unprintable: \(its text cannot be had\)\)"):
            await kernel.wait_ready("one", timeout=0.1)
        assert kernel.profile().components["one"].last_error == "Unprintable: (its text cannot be had)"
        assert one.profile.last_error == "Unprintable: (its text cannot be had)"
        await simulated_clock.advance(3.0)
        assert kernel.components["one"].state is A
        assert handle.attempts == 1


@pytest.mark.fault("A18")
@pytest.mark.parametrize(
    "error", [SystemExit(3), asyncio.CancelledError(), GeneratorExit(), BaseExceptionGroup("all", [SystemExit(3)])]
)
@simulated
async def test_a_constructor_that_ends_the_process_ends_nothing_but_its_attempt(
    error: BaseException, simulated_clock: SimulatedClock
) -> None:
    made = 0

    class Late(Part):
        def __init__(self, name: str = "") -> None:
            super().__init__(name)
            nonlocal made
            made += 1
            if made == 2:
                raise error

    async with Kernel() as kernel:
        one, other = await kernel.create(Late, "one"), await kernel.create(Part, "other")
        handle = kernel.supervise(one, Supervision("restart"))
        await kernel.start(PeriodicContext(100.0), one, other, activate=True)
        one.raises = ValueError("first")
        await simulated_clock.advance(2.0)
        assert made == 3
        assert handle.attempts == 2
        assert kernel.components["one"].state is A
        assert other.ran >= 199


def _no_component(name: str) -> Any:
    return name


@pytest.mark.parametrize("factory", [_no_component, lambda name: Component.__new__(Part)])
@simulated
async def test_a_factory_that_makes_no_component_uses_the_budget_and_says_so(
    factory: Callable[[str], Any], simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        one = await kernel.create(Part, "one")
        handle = kernel.supervise(one, Supervision("restart", budget=2), factory=factory)
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        one.raises = ValueError("first")
        await simulated_clock.advance(10.0)
        assert handle.exhausted
        assert "expected a component of that name" in caplog.text


@pytest.mark.row(17)
@simulated
async def test_sets_the_active_one_and_added_parameters_are_as_they_were(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        one = await kernel.create(Part, "one")
        kernel.supervise(one, Supervision("restart"))
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        await one.add_param("speed", Param(2.0, ge=0.0))
        await one.configuration.add("stiff", {"gain": 9.0})
        await one.configuration.activate("soft")
        await one.configure(speed=7.0)
        before = one.configuration.profile
        one.raises = ValueError("first")
        await simulated_clock.advance(1.0)
        now: Any = kernel.components["one"]
        assert now is not one
        assert now.state is A
        assert now.configuration.profile == before
        assert (now.gain, now.speed, now.configuration.active) == (0.5, 7.0, "soft")
        await now.configuration.activate("default")
        assert (now.gain, now.speed) == (1.0, 2.0)
        await now.remove_param("speed")


@pytest.mark.row(17, 98, 100)
@pytest.mark.parametrize("errors", ["stop", "isolate"])
@pytest.mark.parametrize("groups", ["", "first,one|last"])
@simulated
async def test_a_member_made_anew_is_a_member_in_its_place(
    errors: str, groups: str, simulated_clock: SimulatedClock
) -> None:
    async with Kernel() as kernel:
        first, one, last, aside = [await kernel.create(Part, name) for name in ("first", "one", "last", "aside")]
        home = await kernel.start(PeriodicContext(10.0), one)
        inner = await kernel.connect(first.out, one.inp, name="inner")
        await kernel.connect(one.out, aside.inp, name="known")  # before the composite shows the port
        whole = await kernel.add(
            Composite("whole", first, one, last, exported=["one.out"], errors=errors, groups=groups)
        )
        outer = await kernel.connect(whole.ports["out"], aside.inp, name="outer", allow_duplicate=True)
        kernel.supervise(one, Supervision("restart"))
        context = await kernel.start(PeriodicContext(100.0), whole, activate=True)
        one.raises = ValueError("first")
        await simulated_clock.advance(1.0)
        now: Any = kernel.components["one"]
        assert now is not one
        assert (inner.closed, outer.closed) == (True, True)
        assert whole.members == (first, now, last)
        assert whole.groups == ((("first", "one"), ("last",)) if groups else ())
        assert context.members == (first, now, last)
        assert whole.ports["out"] is now.out
        assert set(kernel.connectors) == {"inner", "known", "outer"}
        assert now.state is A
        assert now.ran > 10
        await whole.remove_members(now)
        assert set(kernel.connectors) == {
            "inner",
            "known",
        }  # outer came by way of the composite
        assert home.members == (now,)


@pytest.mark.row(17, 100)
@simulated
async def test_a_composite_is_supervised_as_one(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        one, two = await kernel.create(Part, "one"), await kernel.create(Part, "two")
        whole = await kernel.add(Composite("whole", one, two))
        handle = kernel.supervise(whole, Supervision("reset"))
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        one.raises = ValueError("first")
        await simulated_clock.advance(0.05)
        assert (whole.state, one.state, two.state) == (E, E, I)
        await simulated_clock.advance(1.0)
        assert (whole.state, one.state, two.state) == (A, A, A)
        assert handle.attempts == 1
        with pytest.raises(DeclarationError, match="cannot be made anew; supervise its members"):
            kernel.supervise(whole, Supervision("restart"))
        with pytest.raises(DeclarationError, match="runs no hooks of its own; supervise its members"):
            kernel.supervise(whole, Supervision("reset", deadline=1.0))


class Door(StateMachineComponent):
    chart = Chart(State("shut", On("go", to="open"), initial=True), State("open", On("go", to="shut")))
    raises = False

    async def on_state_update(self) -> None:
        if self.raises:
            raise ValueError("told to")


class Watcher(Participant):
    raises = False

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[tuple[str, ...]] = []

    def on_action(self, change: MachineChanged) -> None:
        self.seen.append(change.new)
        if self.raises:
            raise ValueError("told to")


@pytest.mark.row(17, 18)
@simulated
async def test_machines_and_participants_made_anew_find_each_other(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        door, watcher = await kernel.add(Door("door")), await kernel.add(Watcher("watcher"))
        for one in (door, watcher):
            kernel.supervise(one, Supervision("restart"))
        door.machine.add_participant(watcher)
        with pytest.raises(DeclarationError, match="door: expected a Participant, got"):
            door.machine.add_participant(door)  # type: ignore[arg-type]
        await kernel.start(PeriodicContext(100.0), watcher, activate=True)
        await kernel.start(PeriodicContext(100.0), door, activate=True)
        watcher.raises = True
        door.machine.send("go")
        await simulated_clock.advance(1.0)
        second: Any = kernel.components["watcher"]
        assert second is not watcher
        door.raises = True
        await simulated_clock.advance(1.0)
        another: Any = kernel.components["door"]
        assert another is not door
        second.seen.clear()
        another.machine.send("go")
        await simulated_clock.advance(0.1)
        assert second.seen == [("open",)]
        assert another.machine._participants == (second,)
        await kernel.remove(second)
        assert another.machine._participants == ()  # a machine holds nobody that has gone


@pytest.mark.row(17)
@simulated
async def test_two_that_fail_together_are_connected_as_before_and_not_twice(
    simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        one, two = await kernel.create(Part, "one"), await kernel.create(Part, "two")
        await kernel.connect(one.out, two.inp, name="there", length=3)
        await kernel.connect(two.out, one.inp, name="back")
        profiles = {name: connector.profile for name, connector in kernel.connectors.items()}
        for component in (one, two):
            kernel.supervise(component, Supervision("restart"))
        await kernel.start(PeriodicContext(100.0), one, two, activate=True)
        for _ in range(3):
            for name in ("one", "two"):
                kernel.components[name].raises = ValueError("both")  # type: ignore[attr-defined]
            await simulated_clock.advance(10.0)
            assert {name: connector.profile for name, connector in kernel.connectors.items()} == profiles
            now: Any = kernel.components
            assert now["one"].state is now["two"].state is A
            now["one"].out.write_nowait(TimedDouble(0, 7.0))
            assert [sample.data for sample in now["two"].inp.drain()] == [7.0]
        assert now["one"] is not one
        assert "not connected again" not in caplog.text


@pytest.mark.row(17)
@pytest.mark.parametrize("after", range(0, 24, 2))
@simulated
async def test_nor_does_a_connector_get_lost_when_one_fails_while_the_other_is_made_anew(
    after: int, simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    class Slow(Part):
        async def on_initialize(self) -> None:
            await self.sleep(0.03)

        async def on_finalize(self) -> None:
            await self.sleep(0.03)

    async with Kernel() as kernel:
        one, two = await kernel.create(Slow, "one"), await kernel.create(Slow, "two")
        await kernel.connect(one.out, two.inp, name="there")
        await kernel.connect(two.out, one.inp, name="back")
        for component in (one, two):
            kernel.supervise(component, Supervision("restart"))
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        await kernel.start(PeriodicContext(100.0), two, activate=True)
        one.raises = ValueError("first")
        await simulated_clock.advance(0.01 * after)
        two.raises = ValueError("second")
        await simulated_clock.advance(5.0)
        now: Any = kernel.components
        assert now["one"] is not one
        assert now["two"] is not two
        assert set(kernel.connectors) == {"there", "back"}
        now["one"].out.write_nowait(TimedDouble(0, 7.0))
        assert [sample.data for sample in now["two"].inp.drain()] == [7.0]
        assert "not connected again" not in caplog.text
