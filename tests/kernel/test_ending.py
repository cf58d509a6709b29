"""The end of a kernel: a correct system ends without an error, and nothing that was sent is lost without a word."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import permutations
from typing import Any, Protocol

import pytest

from aiorts import (
    Component,
    Context,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    Provided,
    Required,
    ThreadContext,
)
from aiorts.testing import simulate
from aiorts.types import TimedLong

pytestmark = pytest.mark.anyio


class Brake(Protocol):
    async def brake(self) -> int: ...


class Motor(Component):
    """Brakes when it is asked to."""

    s = Provided[Brake]()
    braked = 0

    async def brake(self) -> int:
        self.braked += 1
        return self.braked


class Driver(Component):
    """Asks for the brake in each cycle, and when it ends."""

    r = Required[Brake]()
    asked = 0

    async def on_execute(self) -> None:
        for _ in range(9):
            await self.r.proxy.brake()
            self.asked += 1
            await asyncio.sleep(0)

    async def on_deactivated(self) -> None:
        await self.r.proxy.brake()
        self.asked += 1


class Last(Component):
    """Sends a number in each cycle, and -1 when it ends."""

    out = OutPort(TimedLong)
    sent = 0

    def on_execute(self) -> None:
        self.sent += 1
        self.out.write_nowait(TimedLong(0, self.sent))

    def on_deactivated(self) -> None:
        self.out.write_nowait(TimedLong(0, -1))


class Keeper(Component):
    """Keeps what comes, one sample in a cycle."""

    inp = InPort(TimedLong, length=1000)
    out = OutPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.kept: list[int] = []

    def on_execute(self) -> None:
        sample = self.inp.read_nowait()
        self.kept.append(sample.data)
        self.out.write_nowait(sample)


class Waiter(Component):
    """Waits for a sample in its hook, whatever its context does."""

    inp = InPort(TimedLong)
    read = 0

    async def on_execute(self) -> None:
        await self.inp.read()
        self.read += 1


class Both(Component):
    """Answers, and asks another one in its last hook."""

    s = Provided[Brake](concurrent=True)
    r = Required[Brake]()

    async def brake(self) -> int:
        await asyncio.sleep(0)
        return 1

    async def on_deactivated(self) -> None:
        await self.r.proxy.brake()


async def circle(kernel: Kernel, one: Any, other: Any) -> None:
    """Add two components that ask one another."""
    await kernel.add(one)
    await kernel.add(other)
    await kernel.connect(one.r, other.s)
    await kernel.connect(other.r, one.s)


def in_error(*components: Component) -> list[Any]:
    return [one.last_error for one in components if one.last_error is not None]


@pytest.mark.parametrize("turns", range(0, 40, 3))
@pytest.mark.parametrize("together", [True, False])
def test_a_cycle_that_calls_is_finished_and_the_last_hook_may_call_too(turns: int, together: bool) -> None:
    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            motor, driver = await kernel.add(Motor("motor")), await kernel.add(Driver("driver"))
            await kernel.connect(driver.r, motor.s)
            members: tuple[tuple[Component, ...], ...] = ((motor, driver),) if together else ((driver,), (motor,))
            for those in members:
                await kernel.start(PeriodicContext(100.0), *those, activate=True)
            for _ in range(turns):
                await asyncio.sleep(0)
        assert in_error(motor, driver) == []
        assert driver.asked == motor.braked
        assert driver.asked % 9 == 1

    simulate(main)


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize("kind", [EventContext, PeriodicContext])
def test_what_is_sent_last_arrives_whatever_the_order_of_the_contexts_is(
    order: tuple[int, ...], kind: Callable[[], Context]
) -> None:
    """A source, a relay and a keeper in contexts of their own; those that read run for their data."""

    async def main(_clock: Any) -> tuple[list[int], list[int], int]:
        async with Kernel() as kernel:
            source, relay, keeper = Last("source"), Keeper("relay"), Keeper("keeper")
            parts: list[tuple[Component, Context]] = [
                (source, PeriodicContext(100.0) if kind is PeriodicContext else EventContext(every=0.01)),
                (relay, EventContext()),
                (keeper, EventContext()),
            ]
            for index in order:
                await kernel.add(parts[index][0])
            await kernel.connect(source.out, relay.inp)
            await kernel.connect(relay.out, keeper.inp)
            for index in order:
                component, context = parts[index]
                await kernel.start(context, component)
            for component, context in reversed(parts):
                await context.activate(component)
            await kernel.sleep(0.095)
        assert in_error(source, relay, keeper) == []
        return relay.kept, keeper.kept, source.sent

    relayed, kept, sent = simulate(main)
    assert relayed == kept == [*range(1, sent + 1), -1]


@pytest.mark.parametrize("seconds", [0.0, 0.002, 0.02])
def test_a_reader_that_is_behind_reads_all_that_is_unread_one_sample_in_a_cycle(seconds: float) -> None:
    class Slow(Keeper):
        async def on_execute(self) -> None:  # type: ignore[override]
            super().on_execute()
            await self.sleep(0.001)

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            source, slow = await kernel.add(Last("source")), await kernel.add(Slow("slow"))
            await kernel.connect(source.out, slow.inp)
            await kernel.start(EventContext(), slow, activate=True)
            for number in range(100):
                source.out.write_nowait(TimedLong(0, number))
            await kernel.sleep(seconds)
        assert in_error(slow) == []
        assert slow.kept == [*range(100)]

    simulate(main)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("kind", [EventContext, lambda: PeriodicContext(50.0)])
def test_a_hook_that_waits_for_a_sample_is_no_error_at_the_end(
    order: tuple[int, ...], kind: Callable[[], Context]
) -> None:
    async def main(clock: Any) -> None:
        async with Kernel() as kernel:
            parts: list[tuple[Component, Context]] = [
                (source := Last("source"), PeriodicContext(2.0)),
                (waiter := Waiter("waiter"), kind()),
            ]
            for component, _ in parts:
                await kernel.add(component)
            await kernel.connect(source.out, waiter.inp)
            for index in order:
                component, context = parts[index]
                await kernel.start(context, component, activate=True)
            await kernel.sleep(0.3)
            began = clock.monotonic_ns()
        assert in_error(source, waiter) == []
        assert waiter.read >= 1
        assert clock.monotonic_ns() - began < 1_000_000_000  # it has waited for no hook to be cancelled

    simulate(main)


@pytest.mark.parametrize("turns", range(0, 30, 3))
def test_a_circle_of_calls_ends_in_the_reverse_order_of_the_start_and_may_still_call(turns: int) -> None:
    ended: list[str] = []

    class Busy(Both):
        async def on_execute(self) -> None:
            for _ in range(5):
                await self.r.proxy.brake()

        async def on_deactivated(self) -> None:
            await super().on_deactivated()
            ended.append(self.name)

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            one, other = Busy("one"), Busy("other")
            await circle(kernel, one, other)
            await kernel.start(PeriodicContext(100.0), one, activate=True)
            await kernel.start(PeriodicContext(70.0), other, activate=True)
            await kernel.sleep(0.1)
            for _ in range(turns):
                await asyncio.sleep(0)
        assert in_error(one, other) == []

    simulate(main)
    assert ended == ["other", "one"]


def test_a_cycle_in_a_circle_of_calls_is_over_before_another_one_calls_for_the_last_time() -> None:
    class Slow(Component):
        """Does not answer while it waits for an answer itself."""

        s = Provided[Brake]()
        r = Required[Brake]()

        async def brake(self) -> int:
            await self.sleep(0.001)
            return 1

    class Cycles(Slow):
        async def on_execute(self) -> None:
            for _ in range(5):
                await self.r.proxy.brake()

    class Ends(Slow):
        async def on_deactivated(self) -> None:
            await self.r.proxy.brake()

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            cycles, ends = Cycles("cycles"), Ends("ends")
            await circle(kernel, cycles, ends)
            for component in (cycles, ends):
                await kernel.start(PeriodicContext(100.0), component, activate=True)
            await kernel.sleep(0.1)
        assert in_error(cycles, ends) == []

    simulate(main)


def test_each_member_of_one_context_in_a_circle_of_calls_may_still_call() -> None:
    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            one, other = Both("one"), Both("other")
            await circle(kernel, one, other)
            await kernel.start(PeriodicContext(100.0), one, other, activate=True)
            await kernel.sleep(0.1)
        assert in_error(one, other) == []

    simulate(main)


def test_others_in_the_contexts_of_a_circle_of_calls_run_on_until_their_own_end() -> None:
    class Ticks(Component):
        def on_initialize(self) -> None:
            self.next = asyncio.Event()

        def on_execute(self) -> None:
            self.next.set()

    class Waits(Component):
        """Waits in its last hook for a cycle of another one."""

        ticks: Ticks

        async def on_deactivated(self) -> None:
            self.ticks.next.clear()
            await self.ticks.next.wait()

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            ticks, waits = await kernel.add(Ticks("ticks")), await kernel.add(Waits("waits"))
            waits.ticks, one, other = ticks, Both("one"), Both("other")
            await circle(kernel, one, other)
            for members in ((ticks, one), (waits,), (other,)):
                await kernel.start(PeriodicContext(100.0), *members, activate=True)
            await kernel.sleep(0.1)
        assert in_error(ticks, waits, one, other) == []

    simulate(main)


def test_a_hook_over_its_deadline_does_not_hold_up_the_order() -> None:
    ended: list[str] = []

    class Stuck(Component):
        out = OutPort(TimedLong)

        async def on_execute(self) -> None:
            while True:
                try:
                    await asyncio.sleep(30.0)
                except asyncio.CancelledError:
                    ended.append("cancelled")

    class Sink(Component):
        inp = InPort(TimedLong)

        def on_deactivated(self) -> None:
            ended.append("sink")

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            stuck, sink = await kernel.add(Stuck("stuck")), await kernel.add(Sink("sink"))
            await kernel.connect(stuck.out, sink.inp)
            await kernel.start(PeriodicContext(100.0), stuck, activate=True)
            await kernel.start(EventContext(), sink, activate=True)
            await kernel.sleep(0.1)

    simulate(main)
    assert ended.index("sink") <= 1  # after the first cancellation, and not after the fourth


async def test_a_thread_that_answers_works_until_those_that_call_have_ended() -> None:
    class Slow(Component):
        s = Provided[Brake]()

        def brake(self) -> int:
            return 1

        def on_execute(self) -> None:
            pass

    async with Kernel() as kernel:
        slow, driver = await kernel.add(Slow("slow")), await kernel.add(Driver("driver"))
        await kernel.connect(driver.r, slow.s)
        context = await kernel.start(PeriodicContext(200.0), driver)  # the last started would end first, but for calls
        await kernel.start(ThreadContext(200.0), slow, activate=True)
        await context.activate()
        await asyncio.sleep(0.1)
    assert in_error(slow, driver) == []
    assert driver.asked % 9 == 1
