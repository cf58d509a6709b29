"""Who a composite stopped for the error of a member comes back when supervision has helped that member."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from aiorts import Component, Composite, Context, Kernel, LifecycleState, PeriodicContext, SimulatedClock, Supervision
from aiorts.testing import simulated

A, E, I = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE  # noqa: E741


class Part(Component):
    """Fails in its next cycle when told so, and when it is activated as often as told."""

    raises = False
    refuses = 0
    activated: list[str]

    def on_activated(self) -> None:
        if self.refuses:
            self.refuses -= 1
            raise ValueError("not yet")
        self.activated.append(self.name)

    def on_execute(self) -> None:
        if self.raises:
            self.raises = False
            raise ValueError("told to")


class Broken(Part):
    """Fails in every cycle."""

    def on_execute(self) -> None:
        raise ValueError("always")


class Parts:
    """A kernel's parts by name, whichever instance there is now."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel, self.activated = kernel, list[str]()

    async def make(self, *names: str, kind: type[Part] = Part) -> list[Any]:
        made = [await self.kernel.create(kind, name) for name in names]
        kind.activated = self.activated
        return made

    def fail(self, *names: str) -> None:
        for name in names:
            one: Any = self.kernel.components[name]
            one.raises = True

    def states(self, names: str) -> dict[str, LifecycleState | None]:
        return {name: self.kernel.components[name].state for name in names.split()}


@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_the_others_come_back_in_order_when_the_one_that_failed_was_helped(
    action: str, simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "aiorts.kernel")
    async with Kernel() as kernel:
        parts = Parts(kernel)
        whole = await kernel.add(Composite("whole", *await parts.make("first", "one", "last")))
        kernel.supervise(kernel.components["one"], Supervision(action, backoff=1.0))
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        for number in range(1, 3):
            parts.activated.clear()
            parts.fail("one")
            await simulated_clock.advance(0.1)
            assert parts.states("first one last whole") == {"first": I, "one": E, "last": I, "whole": E}
            await simulated_clock.advance(9.0)
            assert parts.states("first one last whole") == {"first": A, "one": A, "last": A, "whole": A}
            assert parts.activated == ["one", "first", "last"]
            how = f"one: was {'reset' if action == 'reset' else 'restarted'}; active again with it: first, last"
            assert [r.getMessage() for r in caplog.records if r.levelno == logging.INFO].count(how) == number


@pytest.mark.parametrize("inner_errors", ["stop", "report", "isolate"])
@simulated
async def test_what_runs_in_composites_round_it_comes_back_too(
    inner_errors: str, simulated_clock: SimulatedClock
) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, beside, before, within = await parts.make("one", "beside", "before", "within")
        inner = Composite("inner", one, beside, errors=inner_errors)
        outer = await kernel.add(Composite("outer", before, inner, Composite("other", within)))
        kernel.supervise(one, Supervision("reset"))
        await kernel.start(PeriodicContext(100.0), outer, activate=True)
        parts.fail("one")
        await simulated_clock.advance(0.05)
        assert parts.states("before within") == (
            {"before": A, "within": A} if inner_errors == "isolate" else {"before": I, "within": I}
        )
        await simulated_clock.advance(2.0)
        everybody = "one beside before within inner other outer"
        assert set(parts.states(everybody).values()) == {A}


@simulated
async def test_a_composite_that_is_supervised_brings_back_those_round_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, beside, before = await parts.make("one", "beside", "before")
        inner = Composite("inner", one, beside)
        outer = await kernel.add(Composite("outer", before, inner))
        kernel.supervise(inner, Supervision("reset"))
        await kernel.start(PeriodicContext(100.0), outer, activate=True)
        parts.fail("one")
        await simulated_clock.advance(2.0)
        assert parts.states("one beside before outer") == {"one": A, "beside": A, "before": A, "outer": A}


@pytest.mark.slow
@simulated
async def test_who_was_deactivated_on_purpose_stays_off(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, off, last = await parts.make("one", "off", "last")
        whole = await kernel.add(Composite("whole", one, off, last))
        kernel.supervise(one, Supervision("reset", backoff=1.0))
        context: Context = await kernel.start(PeriodicContext(100.0), whole, activate=True)
        await context.deactivate(off)
        parts.fail("one")
        await simulated_clock.advance(3.0)
        assert parts.states("one off last") == {"one": A, "off": I, "last": A}
        await context.activate(off)
        parts.fail("one")
        await simulated_clock.advance(0.5)
        assert off.state is I
        await context.activate(off)
        await context.deactivate(off)  # somebody wants it off, while it would have been anyway
        await simulated_clock.advance(9.0)
        assert parts.states("one off last") == {"one": A, "off": I, "last": A}
        parts.fail("one")
        await simulated_clock.advance(0.1)
        await whole.deactivate()
        await simulated_clock.advance(9.0)
        assert parts.states("one off last") == {"one": A, "off": I, "last": I}


@simulated
async def test_they_come_back_when_the_last_of_several_that_failed_was_helped(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, two, last = await parts.make("one", "two", "last")
        whole = await kernel.add(Composite("whole", one, two, last))
        kernel.supervise(one, Supervision("reset", backoff=1.0))
        kernel.supervise(two, Supervision("reset", backoff=2.5))
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        parts.fail("one", "two")
        await simulated_clock.advance(2.0)
        assert parts.states("one two last whole") == {"one": A, "two": E, "last": I, "whole": E}
        await simulated_clock.advance(2.0)
        assert parts.states("one two last whole") == {"one": A, "two": A, "last": A, "whole": A}


@simulated
async def test_one_that_cannot_be_activated_with_the_others_is_helped_itself(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, two, last = await parts.make("one", "two", "last")
        whole = await kernel.add(Composite("whole", one, two, last))
        handles = [kernel.supervise(part, Supervision("reset")) for part in (one, two)]
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        two.refuses = 1
        parts.fail("one")
        await simulated_clock.advance(5.0)
        assert [handle.attempts for handle in handles] == [1, 1]
        assert parts.states("one two last whole") == {"one": A, "two": A, "last": A, "whole": A}


@simulated
async def test_one_that_is_helped_by_hand_leaves_the_others_to_who_did_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        one, two, last = await parts.make("one", "two", "last")
        whole = await kernel.add(Composite("whole", one, two, last))
        kernel.supervise(two, Supervision("reset"))
        context = await kernel.start(PeriodicContext(100.0), whole, activate=True)
        parts.fail("one")
        await simulated_clock.advance(0.1)
        await context.reset(one)
        await context.activate(one, two)
        parts.fail("two")
        await simulated_clock.advance(3.0)
        assert parts.states("one two last") == {"one": A, "two": A, "last": I}


@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_one_that_cannot_be_helped_says_that_its_composite_stays_stopped(
    action: str, simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        (one,) = await parts.make("one", kind=Broken)
        (last,) = await parts.make("last")
        await kernel.add(Composite("outer", Composite("inner", one), last))
        kernel.supervise(one, Supervision(action, budget=2, window=1000.0))
        await kernel.start(PeriodicContext(100.0), kernel.components["outer"], activate=True)
        await simulated_clock.advance(20.0)
        assert parts.states("one last outer") == {"one": E, "last": I, "outer": E}
        (line,) = [record.getMessage() for record in caplog.records if "is left alone" in record.getMessage()]
        assert line == (
            f"one: {action} 2 times within 1000 s did not help; it stays in error, its composite outer stays stopped, "
            "and is left alone: ValueError: always"
        )


@pytest.mark.slow
@simulated
async def test_one_that_fails_alone_stops_nobody_and_says_nothing_of_a_composite(
    simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        parts = Parts(kernel)
        (one,) = await parts.make("one", kind=Broken)
        (last,) = await parts.make("last")
        whole = await kernel.add(Composite("whole", one, last, errors="report"))
        kernel.supervise(one, Supervision("reset", budget=1, window=1000.0))
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        await simulated_clock.advance(20.0)
        assert last.state is A
        (line,) = [record.getMessage() for record in caplog.records if "is left alone" in record.getMessage()]
        assert "stopped" not in line
