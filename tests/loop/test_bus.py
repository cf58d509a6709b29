"""Observers: numbered events for all, and no observer can slow or harm the system beyond its own share."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from typing import Any

import pytest

from aiorts import (
    Bus,
    Component,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.events import (
    ComponentAdded,
    ComponentRemoved,
    Event,
    HookAfter,
    HookBefore,
    HookFailed,
    PortAdded,
    PortRemoved,
    StateChanged,
)
from aiorts.model.lifecycle import HOOKS
from aiorts.testing import simulate, simulated
from aiorts.types import TimedDouble
from kernel_parts import PlainDiary, raising


class Part(Component):
    pass


@pytest.mark.row(84)
def test_events_are_numbered_without_gaps() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[Event] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(Event, heard.append)
            for number in range(3):
                part = await kernel.add(Part(f"part{number}"))
                await kernel.start(ExternalContext(), part, activate=True)
            assert [event.sequence for event in heard] == list(range(1, len(heard) + 1))
            assert kernel.bus.sequence == kernel.profile().sequence == len(heard)
        assert [event.sequence for event in heard] == list(range(1, len(heard) + 1))

    simulate(main)


@pytest.mark.row(84, 105)
def test_a_stuck_observer_holds_nobody_up_and_what_it_misses_is_counted(caplog: pytest.LogCaptureFixture) -> None:
    """In OpenRTM an observer that does not answer freezes the component that tells it (OpenRTM-aist#286)."""

    async def main(clock: SimulatedClock) -> None:
        heard: list[Event] = []
        others: list[Event] = []

        async def stuck(event: Event) -> None:
            heard.append(event)
            await asyncio.Event().wait()

        async with Kernel() as kernel:
            kernel.bus.subscribe(StateChanged, stuck, length=4)
            kernel.bus.subscribe(StateChanged, others.append)
            part = await kernel.add(Part("part"))
            context = await kernel.start(ExternalContext(), part)
            for _ in range(10):
                await context.activate(part)
                await context.deactivate(part)
            statistics = kernel.bus.observers[0]
            assert (statistics.calls, statistics.waiting, statistics.dropped) == (1, 4, 15)
            assert len(heard) == 1
            assert len(others) == 20
            began = clock.monotonic_ns()
        assert clock.monotonic_ns() - began <= 2_000_000_000

    with caplog.at_level(logging.WARNING, "aiorts"):
        simulate(main)
    assert len([r for r in caplog.records if "too slow" in r.getMessage()]) == 1


@pytest.mark.row(84)
def test_a_slow_observer_hears_everything_in_order_also_the_end() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[Any] = []

        async def slow(event: ComponentAdded | ComponentRemoved) -> None:
            await asyncio.sleep(0.01)
            heard.append((type(event), event.component))

        async with Kernel() as kernel:
            kernel.bus.subscribe(ComponentAdded, slow)
            kernel.bus.subscribe(ComponentRemoved, slow)
            for number in range(5):
                await kernel.add(Part(f"p{number}"))
        assert [name for kind, name in heard if kind is ComponentAdded] == ["p0", "p1", "p2", "p3", "p4"]
        assert [name for kind, name in heard if kind is ComponentRemoved] == ["p4", "p3", "p2", "p1", "p0"]

    simulate(main)


@pytest.mark.parametrize("asynchronous", [False, True])
def test_an_observer_that_raises_is_counted_and_told_once(asynchronous: bool, caplog: pytest.LogCaptureFixture) -> None:
    async def main(clock: SimulatedClock) -> None:
        def bad(event: Event) -> None:
            raise RuntimeError("mine")

        async def async_bad(event: Event) -> None:
            raise RuntimeError("mine")

        heard: list[Event] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(StateChanged, async_bad if asynchronous else bad)
            kernel.bus.subscribe(StateChanged, heard.append)
            part = await kernel.add(Part("part"))
            context = await kernel.start(ExternalContext(), part)
            for _ in range(10):
                await context.activate(part)
                await context.deactivate(part)
            await asyncio.sleep(1.0)
            assert kernel.bus.observers[0].errors == 20
            assert len(heard) == 20
            assert part.last_error is None

    with caplog.at_level(logging.ERROR, "aiorts"):
        simulate(main)
    (record,) = [r for r in caplog.records if "observer" in r.getMessage()]
    assert record.exc_info is not None


@pytest.mark.slow
def test_an_observer_that_holds_the_loop_is_named(caplog: pytest.LogCaptureFixture) -> None:
    def hog(event: Event) -> None:
        time.sleep(0.06)

    bus = Bus()
    bus.subscribe(ComponentAdded, hog)
    with caplog.at_level(logging.INFO, "aiorts"):
        bus.publish(ComponentAdded("x"))
        bus.publish(ComponentAdded("y"))
    (statistics,) = bus.observers
    assert statistics.slow == 2
    assert statistics.max_ns >= 60_000_000
    (record,) = caplog.records
    assert "hog held the loop" in record.getMessage()


@pytest.mark.slow
def test_in_virtual_time_what_the_wall_clock_says_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    def hog(event: Event) -> None:
        time.sleep(0.06)
        raise ValueError

    async def main(clock: SimulatedClock) -> None:
        bus = Bus()
        bus.subscribe(ComponentAdded, hog)
        bus.publish(ComponentAdded("x"))
        await asyncio.sleep(4.9)
        bus.publish(ComponentAdded("y"))
        await asyncio.sleep(0.2)
        bus.publish(ComponentAdded("z"))  # five seconds of simulated time: told again
        assert bus.observers[0].slow == 3

    with caplog.at_level(logging.INFO, "aiorts"):
        simulate(main)
    assert [record.getMessage().split(" at ")[0].split(" failed")[1] for record in caplog.records] == ["", ""]


def test_an_observer_can_end_itself_and_others() -> None:
    bus = Bus()
    heard: list[str] = []

    def first(event: Event) -> None:
        heard.append("first")
        stop_first()

    stop_first = bus.subscribe(ComponentAdded, first)
    bus.subscribe(ComponentAdded, lambda event: heard.append("second"))
    bus.publish(ComponentAdded("x"))
    bus.publish(ComponentAdded("x"))
    assert heard == ["first", "second", "second"]
    stop_first()


class Silent(Component):
    """Has no hooks of its own."""


class Updating(Component):
    """Has one hook of its own."""

    def on_state_update(self) -> None:
        """Nothing to do."""


@pytest.mark.row(20)
@pytest.mark.parametrize("order", ["observer first", "observer later", "member later"])
@pytest.mark.parametrize("kind", [PeriodicContext, ExternalContext, EventContext, ThreadContext, RealtimeContext])
def test_a_hook_that_nobody_wrote_is_announced_as_the_others_are(kind: type[Context], order: str) -> None:
    context = kind(rate=100.0) if issubclass(kind, PeriodicContext) else kind()

    async def cycles(kernel: Kernel) -> None:
        if isinstance(context, ExternalContext):
            await context.tick(3)
        elif isinstance(context, EventContext):
            for _ in range(3):
                context.trigger()
                await kernel.sleep(0.01)
        else:
            await kernel.sleep(0.05)

    async def main(clock: SimulatedClock) -> None:
        heard: list[HookBefore] = []
        async with Kernel() as kernel:
            silent, updating = await kernel.create(Silent, "silent"), await kernel.create(Updating, "updating")
            stop = kernel.bus.subscribe(HookBefore, heard.append) if order == "observer first" else None
            await kernel.start(context, silent, *([updating] if order != "member later" else []), activate=True)
            if stop is None:
                await cycles(kernel)
                stop = kernel.bus.subscribe(HookBefore, heard.append)
            if order == "member later":
                await context.add(updating)
                await context.activate(updating)
            heard.clear()
            await cycles(kernel)
            await context.deactivate()
            told = list(heard)
            stop()
            await context.activate()
            await cycles(kernel)
            assert len(heard) == len(told), "an observer that has gone hears nothing"
            assert context._updating == 1, "and the second pass is again for who wrote an on_state_update"
        for name in ("silent", "updating"):
            ran = [event.hook for event in told if event.component == name]
            if ran[0] == "on_state_update":
                del ran[0]  # of a cycle that a thread was in the middle of
            assert ran[:-1].count("on_execute") == ran[:-1].count("on_state_update") >= 3
            assert ran[-1] == "on_deactivated"

    simulate(main)


@pytest.mark.row(20)
def test_every_hook_is_told_before_and_after_with_its_outcome() -> None:
    """OpenRTM's post-listeners are told a return code; here it is the exception itself."""

    async def main(clock: SimulatedClock) -> None:
        heard: list[HookBefore | HookAfter] = []
        error = ValueError("hot")
        async with Kernel() as kernel:
            kernel.bus.subscribe(HookBefore, heard.append)
            kernel.bus.subscribe(HookAfter, heard.append)
            diary = await kernel.add(PlainDiary("part"))
            context = await kernel.start(ExternalContext(name="loop"), diary, activate=True)
            await context.tick()
            await context.deactivate(diary)
            await context.activate(diary)
            diary.plan["on_execute"] = raising(error)
            await context.tick()
            await context.tick()
            await context.reset(diary)
        ran = [event.hook for event in heard if isinstance(event, HookBefore)]
        assert ran == [event.hook for event in heard if isinstance(event, HookAfter)] == diary.ran
        assert set(ran) == set(HOOKS) - {"on_rate_changed"}
        failed = [event.hook for event in heard if isinstance(event, HookAfter) and event.error is error]
        assert failed == ["on_execute"]

    simulate(main)


@pytest.mark.row(84, 105)
@simulated
async def test_what_an_observer_causes_is_told_after_what_it_follows_from() -> None:
    """Whatever observers do, each of them hears of everything in the order in which it happened."""
    heard: dict[str, list[Event]] = {"early": [], "late": []}
    async with Kernel() as kernel:
        part = await kernel.add(Part("part"))
        joined: list[Event] = []

        def answers(event: StateChanged) -> None:
            if not part.ports:
                part.add_port("more", InPort(TimedDouble))
                kernel.bus.subscribe(Event, joined.append)

        kernel.bus.subscribe(Event, heard["early"].append)
        kernel.bus.subscribe(StateChanged, answers)
        kernel.bus.subscribe(Event, heard["late"].append)
        async with kernel.changes() as watch:
            fresh = await anext(watch)
            await kernel.start(ExternalContext(), part, activate=True)
            told = [change.sequence for change in [await anext(watch) for _ in range(3)]]
        kinds = ["ContextStarted", "StateChanged", "PortAdded"]
        for name in ("early", "late"):
            assert [type(event).__name__ for event in heard[name]] == kinds
            assert [event.sequence for event in heard[name]] == told
        assert told == list(range(fresh.sequence + 1, fresh.sequence + 4))
        assert joined == []  # what had happened before it was there is not told


@pytest.mark.row(105)
@simulated
async def test_who_was_unsubscribed_hears_nothing_more() -> None:
    heard: list[Event] = []
    async with Kernel() as kernel:
        part = await kernel.add(Part("part"))
        kernel.bus.subscribe(StateChanged, lambda event: off())
        off = kernel.bus.subscribe(StateChanged, heard.append)
        await kernel.start(ExternalContext(), part, activate=True)
        assert heard == []


@pytest.mark.slow
@pytest.mark.row(105)
@simulated
async def test_observers_that_answer_for_ever_do_not_hold_the_loop() -> None:
    async with Kernel() as kernel:
        part = await kernel.add(Part("part"))
        heard: list[int] = []

        def undo(event: PortAdded) -> None:
            part.remove_port("more")

        def again(event: PortRemoved) -> None:
            part.add_port("more", InPort(TimedDouble))

        ways = kernel.bus.subscribe(PortAdded, undo), kernel.bus.subscribe(PortRemoved, again)
        kernel.bus.subscribe(Event, lambda event: heard.append(event.sequence))
        part.add_port("more", InPort(TimedDouble))
        assert len(heard) <= 1001
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert len(heard) > 1001
        await kernel.add(Part("other"))  # what happens meanwhile is told when its turn comes
        for unsubscribe in ways:
            unsubscribe()
        await asyncio.sleep(0)
        assert heard == list(range(heard[0], kernel.bus.sequence + 1))


@pytest.mark.row(105)
@simulated
async def test_an_observer_that_raises_cancelled_error_of_its_own_goes_on_being_called(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """As when it awaits a task that somebody else has cancelled."""
    heard: list[str] = []

    async def awaits_what_was_cancelled(event: ComponentAdded) -> None:
        heard.append(event.component)
        gone = asyncio.get_running_loop().create_future()
        gone.cancel()
        await gone

    async with Kernel() as kernel:
        kernel.bus.subscribe(ComponentAdded, awaits_what_was_cancelled)
        for number in range(3):
            await kernel.add(Part(f"part{number}"))
        await asyncio.sleep(0.1)
        assert heard == ["part0", "part1", "part2"]
        statistics = kernel.bus.observers[0]
        assert (statistics.calls, statistics.errors, statistics.waiting) == (3, 3, 0)
    assert "awaits_what_was_cancelled failed" in caplog.text


@pytest.mark.row(105)
@simulated
async def test_an_observer_that_is_unsubscribed_while_it_waits_is_cancelled() -> None:
    ended: list[str] = []

    async def waits(event: ComponentAdded) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            ended.append(event.component)
            raise

    async with Kernel() as kernel:
        off = kernel.bus.subscribe(ComponentAdded, waits)
        await kernel.add(Part("part0"))
        await kernel.add(Part("part1"))
        await asyncio.sleep(0)
        off()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert ended == ["part0"]
        assert kernel.bus.observers == ()


class Deaf(Component):
    async def on_execute(self) -> None:
        await deaf()


async def deaf() -> None:
    while not FREE.is_set():
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            continue


FREE = threading.Event()


@pytest.mark.row(92, 105)
@pytest.mark.parametrize("hooks", [0, 3])
def test_observers_that_ignore_cancellation_do_not_delay_the_end_beyond_five_seconds(
    hooks: int, caplog: pytest.LogCaptureFixture
) -> None:
    FREE.clear()

    async def ignores(event: Event) -> None:
        await deaf()

    async def main(clock: SimulatedClock) -> float:
        async with Kernel() as kernel:
            for _ in range(hooks):
                await kernel.start(PeriodicContext(100.0), await kernel.create(Deaf), activate=True)
            kernel.bus.subscribe(ComponentAdded, ignores)
            await kernel.add(Part("part"))
            await clock.advance(0.1)
            began = clock.monotonic_ns()
        return (clock.monotonic_ns() - began) / 1e9

    took = simulate(main)  # it ends, and so would asyncio.run
    assert took <= (5.0 if hooks else 1.2)
    assert "ignores ignored 4 cancellations and was abandoned" in caplog.text


@pytest.mark.row(105)
@simulated
async def test_an_observer_that_fails_at_an_event_that_cannot_be_printed_is_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Unprintable(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no text")

        __repr__ = __str__

    class Fails(Component):
        def on_execute(self) -> None:
            raise Unprintable

    def careless(event: HookFailed) -> None:
        raise ValueError("told to")

    async with Kernel() as kernel:
        kernel.bus.subscribe(HookFailed, careless)
        loop = await kernel.start(ExternalContext(), await kernel.create(Fails), activate=True)
        await loop.tick()
    assert "careless failed at <HookFailed that cannot be shown> (1 times so far)" in caplog.text
