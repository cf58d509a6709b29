"""When a system has ended of itself, also when its source was faster than who waits for the end."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from typing import ClassVar

import pytest

from aiorts import (
    Component,
    Composite,
    Connector,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    Required,
    Supervision,
    ThreadContext,
)
from aiorts.errors import ComponentError
from aiorts.events import RestartLimitReached
from aiorts.system import Ending, ended_in_error, wait_finished
from aiorts.testing import simulated
from aiorts.types import TimedLong
from services.goal_parts import Car, Driving


class Brief(Component):
    """A source that has nothing to say."""

    out = OutPort(TimedLong)

    def on_activated(self) -> None:
        self.finish()


class Sink(Component):
    inp = InPort(TimedLong)

    def on_execute(self) -> None:
        self.inp.drain()


class Relay(Component):
    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.out.write_nowait(sample)


@simulated
async def test_a_source_that_finished_before_anybody_looked_has_finished() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Brief), await kernel.create(Sink)
        await kernel.connect(source.out, sink.inp)
        assert not source.has_finished
        context = await kernel.start(EventContext(), source, activate=True)
        await kernel.sleep(1.0)
        assert source.has_finished
        assert await wait_finished(kernel) == ()
        await context.activate(source)
        await kernel.sleep(1.0)
        assert source.has_finished  # said once more


@simulated
async def test_samples_of_foreign_threads_that_wait_are_still_on_their_way() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Brief), await kernel.create(Sink)
        connector = await kernel.connect(source.out, sink.inp, length=1000)
        await kernel.start(EventContext(), source, sink, activate=True)
        for number in range(600):
            assert source.out.write_from_thread(TimedLong(0, number))
        counts = kernel.profile().components["brief0"].thread_writes["out"]
        assert (counts.waiting, counts) == (600, source.out.thread_writes)
        assert "out" not in kernel.profile().structure().components["brief0"].thread_writes
        assert await wait_finished(kernel) == ()
        assert (connector.statistics.written, connector.statistics.delivered) == (600, 600)


class GoingBrief(Brief):
    """It gives a goal up as soon as it has finished."""

    car = Required[Driving]()


@pytest.mark.parametrize("ends", [True, False])
@simulated
async def test_a_goal_that_was_given_up_has_the_time_to_end_in_order(ends: bool) -> None:
    async with Kernel() as kernel:
        source, car = await kernel.create(GoingBrief), await kernel.create(Car)
        await kernel.connect(source.car, car.service)
        given_up, going = [await source.car.proxy.drive(1) for _ in range(2)]
        given_up.cancel()
        kernel.call_later(1.0, lambda: car.goals[0].cancelled() if ends else None)  # type: ignore[arg-type]
        await kernel.start(EventContext(), source, activate=True)
        begun = kernel.clock.time()
        assert await wait_finished(kernel) == ()
        # Its time to cancel is 2 s; a source that finishes gives its own goals up, too.
        assert kernel.clock.time() - begun == pytest.approx(2.0, abs=0.1)
        assert given_up.state == ("cancelled" if ends else "failed")
        assert going.state == "failed"


@simulated
async def test_a_source_that_was_deactivated_by_others_has_not_finished() -> None:
    class Endless(Brief):
        def on_activated(self) -> None:
            """Go on."""

    async with Kernel() as kernel:
        source = await kernel.create(Endless)
        context = await kernel.start(EventContext(), source, activate=True)
        await context.deactivate()
        assert not source.has_finished


# -- what is not active has not finished -------------------------------------------------------------------------------


class Numbers(Component):
    """Sends `count` numbers; its first run fails at the third, and what comes to be of it takes two seconds."""

    out = OutPort(TimedLong)
    count = Param(5)
    fails = Param(3)
    failures: ClassVar[list[str]] = []
    n = 0

    async def on_activated(self) -> None:
        if self.failures:
            await self.sleep(2.0)

    def on_execute(self) -> None:
        self.n += 1
        if self.n == self.fails and not self.failures:
            self.failures.append(self.name)
            raise ValueError("no luck")
        self.out.write_nowait(TimedLong(0, self.n))
        if self.n == self.count:
            self.finish()


class Broken(Numbers):
    """Fails whenever it is activated."""

    async def on_activated(self) -> None:
        raise ValueError("no device")


class Gone(Numbers):
    """Can be made once."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        if self.failures:
            raise ValueError("no second one")


class Boss(Component):
    """Switches the source off for half a second, or for good."""

    again = Param(True)

    async def on_execute(self) -> None:
        source = self.kernel.components["source"]
        (context,) = source.contexts
        if source.state is LifecycleState.ACTIVE and getattr(source, "n", 0) == 2:
            await context.deactivate(source)
            if self.again:
                await self.sleep(0.5)
                await context.activate(source)


@pytest.fixture(autouse=True)
def _no_failures() -> None:
    Numbers.failures.clear()


async def chain(kernel: Kernel, kind: type[Numbers], policy: Supervision | None = None) -> Numbers:
    """A source at 10 Hz, what passes its numbers on, and who takes them."""
    source, sink = await kernel.create(kind, "source"), await kernel.create(Sink, "sink")
    relay = await kernel.create(Relay, "relay")
    await kernel.connect(source.out, relay.inp)
    await kernel.connect(relay.out, sink.inp)
    if policy is not None:
        kernel.supervise(source, policy)
    await kernel.start(EventContext(), sink, relay, activate=True)
    with contextlib.suppress(ComponentError):
        await kernel.start(PeriodicContext(10.0), source, activate=True)
    return source


async def seconds_until_the_end(kernel: Kernel, most: float = 100.0) -> float | None:
    """How long the system runs from now on; None for longer than `most`."""
    begun = kernel.clock.monotonic_ns()
    ending = asyncio.ensure_future(wait_finished(kernel))
    late = asyncio.ensure_future(kernel.sleep(most))
    await asyncio.wait({ending, late}, return_when=asyncio.FIRST_COMPLETED)
    done = ending.done()
    for task in (ending, late):
        task.cancel()
    await asyncio.wait({ending, late})
    return (kernel.clock.monotonic_ns() - begun) / 1e9 if done else None


@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_a_source_that_waits_to_be_helped_has_not_finished(action: str) -> None:
    async with Kernel() as kernel:
        await chain(kernel, Numbers, Supervision(action, backoff=3.0))
        took = await seconds_until_the_end(kernel)
        source = kernel.components["source"]
        assert took is not None
        assert took > 5.0  # the wait for the help, and its activation
        assert source.has_finished
        assert source.state is LifecycleState.INACTIVE


@pytest.mark.slow(kept_by="test_a_source_that_has_finished_stays_so_wherever_it_goes")
@pytest.mark.anyio
async def test_a_source_in_a_thread_is_asked_for_in_the_same_way() -> None:
    class Polled(Component):
        out = OutPort(TimedLong)
        n = 0

        def on_execute(self) -> None:
            self.n += 1
            if self.n == 3:
                raise ValueError("no luck")
            if self.n == 10:
                self.finish()

    async with Kernel() as kernel:
        source = await kernel.create(Polled, "source")
        kernel.supervise(source, Supervision("reset", backoff=0.2))
        await kernel.start(ThreadContext(rate=100.0), source, activate=True)
        assert await asyncio.wait_for(wait_finished(kernel), 30.0) == ()
        assert (source.has_finished, source.n) == (True, 10)


@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_a_source_that_is_not_helped_any_more_is_done(action: str) -> None:
    async with Kernel() as kernel:
        given_up: list[RestartLimitReached] = []
        kernel.bus.subscribe(RestartLimitReached, given_up.append)
        await chain(kernel, Broken, Supervision(action, backoff=1.0, budget=3))
        assert await seconds_until_the_end(kernel) == pytest.approx(7.0, abs=0.2)  # 1 + 2 + 4
        assert len(given_up) == 1


@simulated
async def test_a_source_that_cannot_be_made_anew_is_done_when_it_is_given_up() -> None:
    async with Kernel() as kernel:
        await chain(kernel, Gone, Supervision("restart", backoff=1.0, budget=3))
        assert await seconds_until_the_end(kernel) == pytest.approx(7.2, abs=0.3)
        assert "source" not in kernel.components


@simulated
async def test_one_that_is_given_up_and_no_source_ends_nothing() -> None:
    class Busy(Component):
        def __init__(self, name: str = "") -> None:
            super().__init__(name)
            if Numbers.failures:
                raise ValueError("no second one")

        def on_execute(self) -> None:
            if self.name == "one":
                Numbers.failures.append(self.name)
                raise ValueError("no luck")

    async with Kernel() as kernel:
        one, two = await kernel.create(Busy, "one"), await kernel.create(Busy, "two")
        kernel.supervise(one, Supervision("restart", budget=1))
        await kernel.start(PeriodicContext(10.0), one, two, activate=True)
        assert await seconds_until_the_end(kernel) is None
        assert list(kernel.components) == ["two"]
        assert list(ended_in_error(kernel)) == ["one"]


@simulated
async def test_a_source_that_never_became_active_does_not_keep_those_who_wait_for_it() -> None:
    async with Kernel() as kernel:
        await chain(kernel, Broken)
        assert await seconds_until_the_end(kernel) == pytest.approx(0.0, abs=0.1)


@simulated
async def test_a_source_in_error_leaves_the_others_their_time() -> None:
    async with Kernel() as kernel:
        await chain(kernel, Broken)
        other = await kernel.create(Numbers, "other", count=50, fails=0)
        await kernel.start(PeriodicContext(10.0), other, activate=True)
        assert await seconds_until_the_end(kernel) == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("again", [True, False])
@simulated
async def test_a_source_that_another_component_switches_off_has_not_finished(again: bool) -> None:
    async with Kernel() as kernel:
        source = await chain(kernel, Numbers)
        await source.configure(fails=0)
        boss = await kernel.create(Boss, "boss", again=again)
        await kernel.start(PeriodicContext(10.0), boss, activate=True)
        took = await seconds_until_the_end(kernel)
        assert (took is not None) is again
        assert source.has_finished is again


@simulated
async def test_who_switches_a_source_off_for_good_takes_it_away() -> None:
    async with Kernel() as kernel:
        source = await chain(kernel, Numbers)
        other = await kernel.create(Numbers, "other", fails=0)
        await kernel.start(PeriodicContext(10.0), other, activate=True)
        await source.context.deactivate(source)
        ending = asyncio.ensure_future(wait_finished(kernel))
        await kernel.sleep(5.0)
        assert not ending.done()
        await kernel.remove(source)  # whom it fed is no source for that
        await asyncio.wait_for(ending, 1.0)


@simulated
async def test_without_a_source_it_ends_when_nobody_goes_on() -> None:
    class Alone(Component):
        fails = Param(False)

        def on_execute(self) -> None:
            if self.fails:
                raise ValueError("no luck")
            self.finish()

    async with Kernel() as kernel:
        one, two = await kernel.create(Alone, "one"), await kernel.create(Alone, "two", fails=True)
        kernel.supervise(two, Supervision("reset", backoff=2.0, budget=2))
        await kernel.start(PeriodicContext(10.0), one, two, activate=True)
        assert await seconds_until_the_end(kernel) == pytest.approx(6.0, abs=0.5)
        assert (one.state, two.state) == (LifecycleState.INACTIVE, LifecycleState.ERROR)


@pytest.mark.parametrize("helped", [True, False])
@simulated
async def test_a_source_that_stopped_with_its_composite_waits_as_long_as_that_is_helped(helped: bool) -> None:
    async with Kernel() as kernel:
        source = await kernel.create(Numbers, "source", count=20, fails=0)
        other = await kernel.create(Numbers, "other")
        whole = await kernel.add(Composite("whole", source, other, errors="stop"))
        if helped:
            kernel.supervise(other, Supervision("reset", backoff=3.0))
        await kernel.start(PeriodicContext(10.0), whole, activate=True)
        took = await seconds_until_the_end(kernel)
        assert took is not None
        assert (took > 5.0) is helped
        assert source.has_finished is helped


@simulated
async def test_a_source_that_has_finished_stays_so_wherever_it_goes() -> None:
    async with Kernel() as kernel:
        source = await chain(kernel, Numbers)
        await source.configure(fails=0)
        other = await kernel.create(Numbers, "other", count=30, fails=0)
        await kernel.start(PeriodicContext(10.0), other, activate=True)
        ending = asyncio.ensure_future(wait_finished(kernel))
        await kernel.sleep(1.0)
        assert source.has_finished
        (context,) = source.contexts
        await context.remove(source)
        await kernel.start(PeriodicContext(10.0), source)
        await asyncio.wait_for(ending, 5.0)


@pytest.mark.slow
@simulated
async def test_a_source_that_is_switched_on_again_while_the_rest_is_taken_is_waited_for() -> None:
    class Slow(Sink):
        async def on_execute(self) -> None:
            for _ in self.inp.drain():
                await self.sleep(1.0)

    async with Kernel() as kernel:
        source, sink = await kernel.create(Numbers, "source", count=3, fails=0), await kernel.create(Slow, "sink")
        await kernel.connect(source.out, sink.inp)
        await kernel.start(EventContext(), sink, activate=True)
        context = await kernel.start(PeriodicContext(10.0), source, activate=True)
        ending = asyncio.ensure_future(wait_finished(kernel))
        await kernel.sleep(1.0)
        assert source.has_finished
        await source.configure(count=80)
        source.n = 0
        await context.activate(source)
        await kernel.sleep(6.0)
        assert not ending.done()
        assert await asyncio.wait_for(ending, 200.0) == ()
        assert source.n == 80


@simulated
async def test_the_failure_of_the_last_sample_is_known_at_the_end() -> None:
    class Judge(Sink):
        def on_execute(self) -> None:
            if any(sample.data == 5 for sample in self.inp.drain()):
                raise ValueError("the last one")

    async with Kernel() as kernel:
        source, sink = await kernel.create(Numbers, "source", fails=0), await kernel.create(Judge, "sink")
        await kernel.connect(source.out, sink.inp)
        await kernel.start(EventContext(), sink, activate=True)
        await kernel.start(PeriodicContext(10.0), source, activate=True)
        assert await wait_finished(kernel) == ()
        assert sink.state is LifecycleState.ERROR


@simulated
async def test_a_source_in_two_contexts_is_done_when_it_goes_on_in_neither() -> None:
    class Both(Component):
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            if self.context.ticks == 10:
                self.finish()

    async with Kernel() as kernel:
        source = await kernel.create(Both, "source")
        for rate in (10.0, 2.0):
            await kernel.start(PeriodicContext(rate), source, activate=True)
        assert await seconds_until_the_end(kernel) == pytest.approx(4.5, abs=0.6)


# -- who is removed, or whose context stops, is off for good -----------------------------------------------------------


class Hand(Component):
    """After half a second it does what it was made for."""

    what = Param("")

    async def on_execute(self) -> None:
        if self.context.ticks == 6:
            kernel = self.kernel
            if self.what == "remove":
                await kernel.remove(kernel.components["source"])
            elif self.what == "remove all":
                for name in ("source", "sink", "hand"):
                    await kernel.remove(kernel.components[name])
            elif self.what == "stop":
                await kernel.stop(kernel.contexts["first"])
            elif self.what == "stop all":
                for context in tuple(kernel.contexts.values()):
                    await kernel.stop(context)
            elif self.what == "fault":
                _break(kernel.components["source"].context)
            elif self.what == "move":
                source = kernel.components["source"]
                await source.context.remove(source)
                await self.sleep(1.0)
                await kernel.start(PeriodicContext(10.0), source, activate=True)


def _break(context: object) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("a fault of aiorts, for good")

    context._end_cycle = fail  # type: ignore[attr-defined]


async def three(kernel: Kernel, what: str, *, together: bool = True) -> None:
    """A source and its reader, in one context or in two, and who does something to them."""
    source = await kernel.create(Numbers, "source", count=200, fails=0)
    sink, hand = await kernel.create(Sink, "sink"), await kernel.create(Hand, "hand", what=what)
    await kernel.connect(source.out, sink.inp)
    await kernel.start(PeriodicContext(10.0, name="second"), *(() if together else (sink,)), hand, activate=True)
    await kernel.start(PeriodicContext(10.0, name="first"), source, *((sink,) if together else ()), activate=True)


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("what", ["remove", "remove all", "stop", "stop all", "fault"])
@simulated
async def test_it_ends_when_its_only_source_is_gone_for_good(what: str, together: bool) -> None:
    async with Kernel() as kernel:
        await three(kernel, what, together=together)
        took = await seconds_until_the_end(kernel)
        assert took is not None
        assert took < 2.0
        assert kernel.exit_status == int(what == "fault")


@simulated
async def test_a_source_that_goes_from_one_context_to_another_is_waited_for() -> None:
    async with Kernel() as kernel:
        await three(kernel, "move")
        assert await seconds_until_the_end(kernel) == pytest.approx(21.0, abs=1.0)
        assert kernel.components["source"].has_finished


@simulated
async def test_another_source_is_waited_for_when_the_context_of_one_stops() -> None:
    async with Kernel() as kernel:
        await three(kernel, "fault")
        other = await kernel.create(Numbers, "other", count=50, fails=0)
        await kernel.start(PeriodicContext(10.0), other, activate=True)
        assert await seconds_until_the_end(kernel) == pytest.approx(5.0, abs=0.3)
        assert kernel.exit_status == 1


@simulated
async def test_what_was_sent_to_a_reader_that_was_stopped_is_not_waited_for() -> None:
    async with Kernel() as kernel:
        await three(kernel, "stop", together=False)
        ending = asyncio.ensure_future(wait_finished(kernel))
        await kernel.sleep(0.2)
        await kernel.stop(kernel.contexts["second"])
        assert not ending.done()
        source = kernel.components["source"]
        await source.configure(count=5)
        assert await asyncio.wait_for(ending, 1.5) == ()
        assert source.has_finished


@simulated
async def test_what_stops_before_anybody_waits_is_known_to_who_has_listened() -> None:
    async with Kernel() as kernel:
        ending = Ending(kernel)
        await three(kernel, "")
        await kernel.sleep(1.0)
        await kernel.remove(kernel.components["source"])
        assert await asyncio.wait_for(ending.wait(), 1.0) == ()
        ending.close()
        assert not kernel.bus.observers


class Slow(Component):
    """A reader that takes a quarter of a second for a sample."""

    inp = InPort(TimedLong)

    async def on_execute(self) -> None:
        self.inp.read_nowait()
        await asyncio.sleep(0.25)


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.parametrize(("longest", "cut"), [(None, False), (60.0, False), (0.5, True)])
async def test_a_slow_reader_is_told_of_once_and_waited_for_as_long_as_that_says(
    longest: float | None, cut: bool
) -> None:
    told: list[int] = []

    def slow(waiting: Sequence[Connector]) -> float | None:
        told.extend(connector.statistics.buffered for connector in waiting)
        return longest

    async with Kernel() as kernel:
        source, reader = await kernel.create(Brief), await kernel.create(Slow)
        connector = await kernel.connect(source.out, reader.inp, length=100)
        ending = Ending(kernel, slow)
        await kernel.start(EventContext(), reader, activate=True)
        for number in range(12):
            source.out.write_nowait(TimedLong(0, number))
        await kernel.start(EventContext(), source, activate=True)
        unread = await asyncio.wait_for(ending.wait(), 60.0)
        ending.close()
        assert len(told) == 1
        assert 0 < told[0] < 12
        assert unread == ((connector,) if cut else ())
        assert (connector.statistics.buffered > 0) is cut
