"""External contexts: exactly one cycle for each tick, and the tick returns when it is over."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import ExternalContext, Kernel, LifecycleState, PeriodicContext, SimulatedClock
from aiorts.errors import ClosedError, StateError
from aiorts.testing.simulation import simulate
from campaign import cases
from contexts.parts import Doer, Idle, S, Ticker


@pytest.mark.row(25, 26)
def test_a_tick_runs_exactly_one_cycle_and_returns_when_it_is_over() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 2.0))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            assert ticker.begun == []
            for number in range(1, 4):
                await context.tick()
                assert len(ticker.begun) == number
                assert clock.monotonic_ns() == number * 2 * S
            await context.tick(4)
            assert context.statistics.cycles == 7
            await asyncio.sleep(100.0)
            assert context.statistics.cycles == 7

    simulate(main)


@pytest.mark.row(25)
def test_no_tick_is_lost_however_many_ask_at_once() -> None:
    count = cases(50_000)

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker"))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            await asyncio.gather(*(context.tick() for _ in range(count)))
            assert len(ticker.begun) == context.statistics.cycles == count

    simulate(main)


@pytest.mark.row(25)
def test_ticks_asked_for_while_a_cycle_runs_are_run_after_it() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 1.0))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            first = asyncio.create_task(context.tick())
            await asyncio.sleep(0.5)
            await asyncio.gather(context.tick(), context.tick())
            assert first.done()
            assert ticker.begun == [0, S, 2 * S]

    simulate(main)


@pytest.mark.row(25)
def test_a_tick_cancelled_before_its_cycle_is_withdrawn_and_one_cancelled_during_it_ends_it_not() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 1.0))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            asked = [asyncio.create_task(context.tick()) for _ in range(4)]
            await asyncio.sleep(0.5)
            asked[0].cancel()  # runs
            asked[2].cancel()  # waits
            await asyncio.sleep(10.0)
            assert ticker.begun == [0, S, 2 * S]
            assert [task.cancelled() for task in asked] == [True, False, True, False]

    simulate(main)


@pytest.mark.row(26)
def test_what_a_cycle_leads_to_has_taken_effect_when_the_tick_returns() -> None:
    async def fail() -> None:
        raise ValueError("no")

    async def main(clock: SimulatedClock) -> None:
        async def leave() -> None:
            source.finish()

        async with Kernel() as kernel:
            failing, source = await kernel.add(Doer("failing", execute=fail)), await kernel.add(Doer("source"))
            source.execute = leave
            context = await kernel.start(ExternalContext(), failing, source, activate=True)
            await context.tick()
            assert context.state(failing) is LifecycleState.ERROR
            assert context.state(source) is LifecycleState.INACTIVE

    simulate(main)


@pytest.mark.row(25)
def test_a_tick_from_a_hook_that_it_would_wait_for_is_refused() -> None:
    async def main(clock: SimulatedClock) -> None:
        refused: list[str] = []

        async def tick() -> None:
            try:
                await context.tick()
            except StateError as error:
                refused.append(str(error))

        async with Kernel() as kernel:
            own, shared = await kernel.add(Doer("own", execute=tick)), await kernel.add(Doer("shared", execute=tick))
            context = await kernel.start(ExternalContext(name="steps"), own, shared, activate=True)
            await context.tick()
            assert refused == ["steps: tick() from a hook of this context would wait for itself"] * 2
            # from another context too, when the component is a member of both
            await context.deactivate()
            await kernel.start(PeriodicContext(1.0), shared, activate=True)
            await asyncio.sleep(0.5)
            assert len(refused) == 3

    simulate(main)


@pytest.mark.row(25)
def test_another_contexts_hook_may_tick_and_wait() -> None:
    async def main(clock: SimulatedClock) -> None:
        async def tick() -> None:
            await context.tick()

        async with Kernel() as kernel:
            ticker, leader = await kernel.add(Ticker("ticker")), await kernel.add(Doer("leader", execute=tick))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            await kernel.start(PeriodicContext(10.0), leader, activate=True)
            await asyncio.sleep(0.95)
            assert len(ticker.begun) == 10

    simulate(main)


@pytest.mark.row(25)
def test_ticks_that_wait_when_the_context_stops_are_told() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 1.0))
            context = await kernel.start(ExternalContext(), ticker, activate=True)
            asked = [asyncio.create_task(context.tick()) for _ in range(3)]
            await asyncio.sleep(0.5)
            await context.stop()
            outcomes = await asyncio.gather(*asked, return_exceptions=True)
            assert [type(outcome) for outcome in outcomes] == [ClosedError] * 3
            with pytest.raises(StateError, match="does not run"):
                await context.tick()

    simulate(main)


@pytest.mark.row(25)
def test_a_tick_with_nobody_active_is_a_cycle_all_the_same() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            context = await kernel.start(ExternalContext(), await kernel.add(Idle("idle")))
            await context.tick(3)
            assert context.statistics.cycles == 3

    simulate(main)
