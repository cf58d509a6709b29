"""What a context whose hooks take too long leaves to others, and that it says so once without being asked."""

from __future__ import annotations

import asyncio
import logging
import re
import threading
import time

import pytest

from aiorts import Component, EventContext, Kernel, PeriodicContext
from aiorts.diagnostics.deadline_monitor import ContextTimer
from aiorts.kernel.execution.fairness import LONG_NS, Held
from aiorts.model.blame import Blame, Overload
from aiorts.testing import simulate, simulated

SECOND = 1_000_000_000


class Blocking(Component):
    """Holds the loop longer than a period."""

    runs = 0

    def on_execute(self) -> None:
        self.runs += 1
        time.sleep(0.05)


class Slow(Component):
    """Waits longer than a period, in cycles from `first` to `last`."""

    first, last = 0, 1_000_000
    runs = 0

    async def on_execute(self) -> None:  # type: ignore[override] # a hook may be either
        self.runs += 1
        if self.first <= self.runs <= self.last:
            await self.sleep(0.25)


class Refusing(Component):
    def on_execute(self) -> None:
        raise ValueError("no")


class Again(Blocking):
    """Gives itself the next cause: there is never a wait between two cycles."""

    def on_execute(self) -> None:
        super().on_execute()
        for context in self.contexts:
            assert isinstance(context, EventContext)
            context.trigger(self)


async def start_blocking(kernel: Kernel) -> list[Blocking]:
    """One in a context with a rate that it cannot keep, and one that triggers itself."""
    blocking, again = await kernel.create(Blocking, "blocking"), await kernel.create(Again, "again")
    await kernel.start(PeriodicContext(100.0), blocking, activate=True)
    context = await kernel.start(EventContext(), again, activate=True)
    context.trigger(again)
    await asyncio.sleep(0.2)
    return [blocking, again]


@pytest.mark.slow
@pytest.mark.anyio
async def test_others_have_a_turn_after_each_cycle_and_timers_too() -> None:
    async with Kernel() as kernel:
        both = await start_blocking(kernel)
        before = [one.runs for one in both]
        for _ in range(4):
            await asyncio.sleep(0)
        assert [one.runs - earlier <= 5 for one, earlier in zip(both, before, strict=True)] == [True, True]
        before = [one.runs for one in both]
        await kernel.sleep(0.01)
        assert [one.runs - earlier <= 3 for one, earlier in zip(both, before, strict=True)] == [True, True]


@pytest.mark.slow
@pytest.mark.anyio
async def test_what_takes_several_turns_costs_few_cycles_where_each_is_long() -> None:
    """A start, a request and a timer take up to eight turns of the loop; none may cost so many whole cycles."""
    async with Kernel() as kernel:
        both = await start_blocking(kernel)
        while min(one.runs for one in both) < 4:  # until it is known that they go on so
            await asyncio.sleep(0)
        before = [one.runs for one in both]
        await kernel.start(EventContext(), await kernel.create(Component, "other"), activate=True)
        assert [one.runs - earlier <= 4 for one, earlier in zip(both, before, strict=True)] == [True, True]


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize("asked", ["by the owner", "by request_stop", "from a thread"])
async def test_a_stop_is_answered_within_two_cycles(asked: str) -> None:
    """Every turn of the loop costs whole cycles, and a stop takes many turns."""
    before: list[int] = []
    async with Kernel() as kernel:
        both = await start_blocking(kernel)

        def ask() -> None:
            before.extend(one.runs for one in both)
            kernel.request_stop()

        if asked == "by request_stop":
            asyncio.get_running_loop().call_soon(ask)
        elif asked == "from a thread":
            timer = threading.Timer(0.02, ask)
            timer.start()
        else:
            ask()
        await asyncio.wait_for(kernel.wait_stop_requested(), 60.0)
    assert [one.runs - earlier <= 2 for one, earlier in zip(both, before, strict=True)] == [True, True]


def warnings_of(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


@simulated
async def test_missing_most_deadlines_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        slow = await kernel.create(Slow, "slow")
        await kernel.start(PeriodicContext(5.0, name="loop"), slow, activate=True)
        await kernel.sleep(20.0)
    (said,) = warnings_of(caplog)
    assert said.startswith("loop: misses most deadlines: ")
    assert "cycles overran in" in said
    assert " at 5 Hz; " in said


@simulated
async def test_cycles_many_periods_long_are_said_though_they_are_few(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        slow = await kernel.create(Slow, "slow")
        await kernel.start(PeriodicContext(100.0, name="loop"), slow, activate=True)
        await kernel.sleep(3.0)
    assert len(warnings_of(caplog)) == 1


@pytest.mark.slow
@simulated
async def test_overruns_now_and_then_are_not_said(caplog: pytest.LogCaptureFixture) -> None:
    """A burst of late cycles, and one cycle in ten that is late: neither is worth a word."""
    async with Kernel() as kernel:
        burst, often = await kernel.create(Slow, "burst"), await kernel.create(Slow, "often")
        burst.first, burst.last = 20, 22

        async def sometimes() -> None:
            often.runs += 1
            if often.runs % 10 == 0:
                await often.sleep(0.25)

        often.on_execute = sometimes  # type: ignore[method-assign, assignment]
        await kernel.start(PeriodicContext(100.0), burst, activate=True)
        context = await kernel.start(PeriodicContext(5.0), often, activate=True)
        await kernel.sleep(60.0)
        assert context.statistics.overruns > 20
    assert warnings_of(caplog) == []


@pytest.mark.slow
def test_overload_needs_time_ticks_and_a_majority() -> None:
    fast = Overload()
    assert not any(fast.add(tick * 1000, tick, tick) for tick in range(900_000))  # 0.9 s at 1 MHz
    rare = Overload()
    assert not any(rare.add(tick * SECOND, 2 * tick, 2 * tick) for tick in range(100))
    few = Overload()
    assert few.add(0, 0, 0) is few.add(SECOND, 1, 50) is few.add(2 * SECOND, 2, 100) is None
    assert few.add(3 * SECOND, 3, 150) == (3, 3, 3 * SECOND)
    assert not any(few.add(tick * SECOND, tick, 50 * tick) for tick in range(4, 100))


@pytest.mark.anyio
async def test_a_failure_names_its_component_in_the_message(caplog: pytest.LogCaptureFixture) -> None:
    """Python's logging prints the message alone where nothing is configured."""
    async with Kernel() as kernel:
        refusing = await kernel.create(Refusing, "refusing")
        await kernel.start(PeriodicContext(100.0), refusing, activate=True)
        await asyncio.sleep(0.05)
    (said,) = warnings_of(caplog)
    assert re.fullmatch(r"refusing\.on_execute failed: ValueError: no \(.*test_fairness\.py:\d+\)", said)


@pytest.mark.parametrize(
    ("blame", "told"),
    [
        (Blame("machine", held_ns=SECOND), False),
        (Blame("unknown", held_ns=SECOND), False),
        (Blame("gc", held_ns=SECOND, generation=2), False),
        (Blame("loop", held_ns=1000), False),
        (Blame("hook", "slow", "on_execute", held_ns=SECOND), True),
    ],
)
def test_what_the_machine_or_a_short_hold_does_is_not_said(
    blame: Blame, told: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A loaded machine makes half of all cycles late, and no system says so of itself."""
    monkeypatch.setattr(ContextTimer, "blame", lambda *_: blame)

    async def main() -> int:
        async with Kernel() as kernel:
            slow = await kernel.create(Slow, "slow")
            context = await kernel.start(PeriodicContext(5.0, name="loop"), slow, activate=True)
            await kernel.sleep(10.0)
            return context.statistics.overruns

    assert simulate(main()) > 10
    assert [said.endswith(f"; {blame}") for said in warnings_of(caplog)] == [True] * told


def test_two_long_cycles_in_a_row_hold_the_thread_and_one_does_not() -> None:
    held = Held()
    found = []
    for seconds in (2 * LONG_NS / SECOND, 0.0, 2 * LONG_NS / SECOND, 2 * LONG_NS / SECOND, 0.0):
        held.begin()
        until = time.thread_time() + seconds
        while time.thread_time() < until:
            pass
        held.end()
        found.append(held.on_and_on)
    assert found == [False, False, False, True, False]
