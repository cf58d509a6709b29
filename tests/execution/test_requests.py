"""Requests: at once between cycles, awaited, with a deadline, queued from hooks; members that come and go; restart."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from aiorts import Context, EventContext, ExternalContext, Kernel, LifecycleState, PeriodicContext, SimulatedClock
from aiorts.contexts.thread import ThreadContext
from aiorts.errors import ClosedError, ComponentError, StateError, TransitionTimeout
from aiorts.testing.simulation import simulate
from contexts.parts import MS, Diary, Doer, Idle, S, Ticker

ACTIVE, INACTIVE, ERROR = LifecycleState.ACTIVE, LifecycleState.INACTIVE, LifecycleState.ERROR

KINDS: dict[str, Callable[[], Context]] = {
    "slow periodic": lambda: PeriodicContext(0.001),
    "event": EventContext,
    "external": ExternalContext,
    "thread": ThreadContext,
    "slow thread": lambda: ThreadContext(0.001),
}


@pytest.mark.row(10, 27)
@pytest.mark.parametrize("kind", KINDS)
def test_in_every_kind_of_context_a_transition_needs_no_data_no_tick_and_no_period(kind: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            idle = await kernel.add(Idle("idle"))
            context = await kernel.start(KINDS[kind](), idle)
            if context.rate is not None:
                await asyncio.sleep(1.0)  # the first tick is over, the next is 999 s away
            before = clock.monotonic_ns()
            await context.activate(idle)
            assert context.state(idle) is ACTIVE
            await context.deactivate()
            assert context.state(idle) is INACTIVE
            late = await kernel.add(Idle("late"))
            await context.add(late)
            await context.activate(late)
            await context.remove(late)
            assert clock.monotonic_ns() == before
            assert context.members == (idle,)

    simulate(main)


@pytest.mark.row(34)
def test_a_transition_that_fails_says_so_with_its_cause() -> None:
    async def fail() -> None:
        raise ValueError("no device")

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            broken = await kernel.add(Doer("broken", activated=fail, reset=fail))
            context = await kernel.start(EventContext(name="loop"), broken)
            with pytest.raises(ComponentError, match="on_activated raised ValueError: no device") as caught:
                await context.activate(broken)
            assert isinstance(caught.value.__cause__, ValueError)
            assert context.state(broken) is ERROR
            with pytest.raises(StateError, match="broken in loop: cannot activate from error: reset it first"):
                await context.activate(broken)
            with pytest.raises(ComponentError, match="on_reset"):
                await context.reset()
            assert context.state(broken) is ERROR

    simulate(main)


@pytest.mark.row(34)
def test_a_request_that_does_not_begin_in_time_is_withdrawn_and_says_so() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            blocker = await kernel.add(Ticker("blocker", 10.0))
            quiet = await kernel.add(Idle("quiet"))
            context = await kernel.start(PeriodicContext(100.0, name="loop"), blocker, quiet)
            await context.activate(blocker)
            await asyncio.sleep(0.1)  # blocker is in its hook
            with pytest.raises(TransitionTimeout, match=r"loop: activate quiet .* within 2\.0 s; it was withdrawn"):
                await context.activate(quiet, timeout=2.0)
            assert clock.monotonic_ns() == 2 * S + 100 * MS
            await asyncio.sleep(30.0)
            assert context.state(quiet) is INACTIVE

    simulate(main)


@pytest.mark.row(34)
def test_a_request_that_began_and_did_not_end_in_time_is_told_apart() -> None:
    async def slow() -> None:
        await asyncio.sleep(10.0)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            doer = await kernel.add(Doer("doer", activated=slow))
            context = await kernel.start(EventContext(name="loop"), doer)
            with pytest.raises(TransitionTimeout, match="it has begun and may still end"):
                await context.activate(doer, timeout=1.0)
            await asyncio.sleep(9.5)
            assert context.state(doer) is ACTIVE

    simulate(main)


@pytest.mark.slow(kept_by="test_a_request_that_does_not_begin_in_time_is_withdrawn_and_says_so")
@pytest.mark.row(34)
@pytest.mark.anyio
async def test_the_deadline_of_a_request_goes_by_the_kernels_clock() -> None:
    clock = SimulatedClock()
    async with Kernel(clock=clock) as kernel:
        takes = iter([100.0] + [0.0] * 10_000)
        blocker, quiet = await kernel.add(Ticker("blocker", lambda: next(takes))), await kernel.add(Idle("quiet"))
        context = await kernel.start(PeriodicContext(100.0), blocker, quiet)
        await context.activate(blocker)
        await clock.advance(0.1)
        asked = asyncio.create_task(context.activate(quiet, timeout=60.0))
        await clock.advance(59.9)
        assert not asked.done()
        await clock.advance(0.2)
        with pytest.raises(TransitionTimeout):
            await asked
        await clock.advance(60.0)


@pytest.mark.row(34)
def test_a_cancelled_request_is_withdrawn() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            blocker, quiet = await kernel.add(Ticker("blocker", 10.0)), await kernel.add(Idle("quiet"))
            context = await kernel.start(PeriodicContext(100.0), blocker, quiet)
            await context.activate(blocker)
            await asyncio.sleep(0.1)
            asked = asyncio.create_task(context.activate(quiet))
            await asyncio.sleep(1.0)
            asked.cancel()
            await asyncio.sleep(30.0)
            assert context.state(quiet) is INACTIVE

    simulate(main)


def test_a_request_from_a_hook_of_the_same_context_is_queued() -> None:
    async def main(clock: SimulatedClock) -> None:
        states: list[LifecycleState] = []

        async def ask() -> None:
            await context.activate(mate)
            await context.deactivate(doer)
            await context.set_rate(20.0)
            states.append(context.state(mate))

        async with Kernel() as kernel:
            doer, mate = await kernel.add(Doer("doer", execute=ask)), await kernel.add(Ticker("mate"))
            context = await kernel.start(PeriodicContext(10.0), doer, mate)
            await context.activate(doer)
            await asyncio.sleep(0.225)
            assert states == [INACTIVE]
            assert (context.state(mate), context.state(doer), context.rate) == (ACTIVE, INACTIVE, 20.0)
            assert mate.begun == [150 * MS, 200 * MS]

    simulate(main)


def test_a_queued_request_that_fails_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def main(clock: SimulatedClock) -> None:
        async def ask() -> None:
            await context.reset(doer)

        async with Kernel() as kernel:
            doer = await kernel.add(Doer("doer", execute=ask))
            context = await kernel.start(EventContext(name="loop"), doer, activate=True)
            context.trigger()
            await asyncio.sleep(0.1)

    simulate(main)
    assert "loop: queued request to reset doer failed" in caplog.text


@pytest.mark.fault("C08")
def test_stop_from_a_hook_of_the_context_ends_it_after_the_cycle() -> None:
    async def main(clock: SimulatedClock) -> None:
        async def stop() -> None:
            await doer.context.stop()

        async with Kernel() as kernel:
            doer, mate = await kernel.add(Doer("doer", execute=stop)), await kernel.add(Ticker("mate"))
            context = await kernel.start(PeriodicContext(10.0), doer, mate, activate=True)
            await asyncio.sleep(0.05)
            assert not context.running
            assert mate.begun == [0]
            assert context.members == ()
            assert doer.contexts == ()
            assert kernel.contexts == {}

    simulate(main)


def test_a_stop_tells_those_who_wait_for_something_that_will_not_happen() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            blocker, quiet = await kernel.add(Ticker("blocker", 1.0)), await kernel.add(Idle("quiet"))
            context = await kernel.start(PeriodicContext(100.0, name="loop"), blocker, quiet)
            await context.activate(blocker)
            await asyncio.sleep(0.1)
            asked = asyncio.create_task(context.activate(quiet, timeout=None))
            await asyncio.sleep(0.1)
            await context.stop()
            with pytest.raises(ClosedError, match="loop: the context has stopped"):
                await asked
            with pytest.raises(StateError, match="the context does not run"):
                await context.activate()

    simulate(main)


@pytest.mark.row(19)
def test_the_same_component_added_twice_at_once_is_added_once() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[tuple[object, ...]] = []
        async with Kernel() as kernel:
            one = await kernel.add(Diary("one", diary))
            context = await kernel.start(EventContext())
            first, second = await asyncio.gather(context.add(one), context.add(one), return_exceptions=True)
            assert first is None
            assert isinstance(second, StateError)
            assert context.members == (one,)
            assert diary == [("one", "startup")]
            await context.activate()
            await context.remove(one)
            with pytest.raises(StateError, match="is not in"):
                await context.remove(one)
        assert diary[1:] == [("one", "activated"), ("one", "deactivated"), ("one", "shutdown")]

    simulate(main)


@pytest.mark.row(19)
def test_members_added_and_removed_while_running_change_the_order_between_cycles() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[tuple[object, ...]] = []
        async with Kernel() as kernel:
            one, two = await kernel.add(Diary("one", diary)), await kernel.add(Diary("two", diary))
            context = await kernel.start(PeriodicContext(10.0), one, activate=True)
            await asyncio.sleep(0.05)
            await context.add(two)
            await context.activate(two)
            await asyncio.sleep(0.1)
            await context.remove(one)
            await asyncio.sleep(0.1)
            executed = [name for name, hook in diary if hook == "execute"]
            assert executed == ["one", "one", "two", "two"]

    simulate(main)


@pytest.mark.fault("C08")
@pytest.mark.parametrize("kind", KINDS)
def test_a_component_removed_from_its_kernel_leaves_its_contexts_in_order(kind: str) -> None:
    class Whole(Idle):
        seen: list[str]

        def on_activated(self) -> None:
            self.seen = []

        def on_deactivated(self) -> None:
            self.seen.append("deactivated")

        def on_shutdown(self) -> None:
            self.seen.append("shutdown")

        def on_finalize(self) -> None:
            self.seen.append("finalize")

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            whole = await kernel.add(Whole("whole"))
            context = await kernel.start(KINDS[kind](), whole, activate=True)
            await asyncio.sleep(0.01)
            await kernel.remove(whole)
            assert whole.seen == ["deactivated", "shutdown", "finalize"]
            assert context.members == ()
            assert context.running

    simulate(main)


@pytest.mark.row(35)
@pytest.mark.parametrize("kind", KINDS)
def test_a_stopped_context_can_be_started_again(kind: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            idle = await kernel.add(Idle("idle"))
            context = KINDS[kind]()
            for _ in range(3):
                await kernel.start(context, idle, activate=True)
                assert context.state(idle) is ACTIVE
                await asyncio.sleep(0.01)
                await asyncio.gather(context.stop(), context.stop())
                assert not context.running
                assert idle.contexts == ()

    simulate(main)


@pytest.mark.row(33)
def test_statistics_of_a_stopped_context_stay_readable_and_start_afresh() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 0.001))
            context = await kernel.start(PeriodicContext(10.0), ticker, activate=True)
            await asyncio.sleep(0.25)
            await context.stop()
            hook = context.statistics.hooks["ticker.on_execute"]
            assert (hook.count, hook.total_ns) == (3, 3 * MS)
            await kernel.start(context, ticker, activate=True)
            await asyncio.sleep(0.05)
            assert context.statistics.hooks["ticker.on_execute"].count == 1
            assert context.statistics.lateness_max_ns == 0

    simulate(main)
