"""Periodic contexts: the rate, its change, overruns and what is counted."""

from __future__ import annotations

import asyncio
import math
import random
from fractions import Fraction

import pytest

from aiorts import Kernel, PeriodicContext, SimulatedClock
from aiorts.clock import SystemClock
from aiorts.errors import ConfigurationError
from aiorts.kernel.loop.bus import Overrun, RateChanged
from aiorts.testing.simulation import simulate
from campaign import cases
from contexts.parts import MS, Diary, S, Ticker


def ticks_of(rate: float, seconds: float, **options: object) -> tuple[Ticker, PeriodicContext]:
    async def main(clock: SimulatedClock) -> tuple[Ticker, PeriodicContext]:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", options.pop("takes", 0.0)))  # type: ignore[arg-type]
            context = await kernel.start(PeriodicContext(rate, **options), ticker, activate=True)  # type: ignore[arg-type]
            await asyncio.sleep(seconds)
            return ticker, context

    return simulate(main)


@pytest.mark.slow(kept_by="testing/test_rig.py::test_ticks_of_a_rate_do_not_drift")
@pytest.mark.row(24)
@pytest.mark.parametrize(("rate", "seconds"), [(500.0, 60.0), (333.3, 60.0), (1 / 3, 900.0), (0.001, 5e4), (1e4, 1.0)])
def test_a_periodic_context_ticks_at_start_plus_n_over_rate_exactly(rate: float, seconds: float) -> None:
    ticker, context = ticks_of(rate, seconds)
    expected = math.floor(Fraction(rate) * Fraction(seconds)) + 1
    assert abs(len(ticker.begun) - expected) <= 1
    assert ticker.begun == [math.ceil(n * S / Fraction(rate)) for n in range(len(ticker.begun))]
    assert context.statistics.overruns == context.statistics.skipped == context.statistics.lateness_max_ns == 0
    assert dict(context.statistics.lateness_histogram) == {1: context.ticks}


@pytest.mark.slow(kept_by="test_an_execution_of_three_periods_is_an_overrun_each_time_and_never_a_burst")
@pytest.mark.row(24)
def test_hooks_that_take_random_times_neither_change_the_rate_nor_make_it_drift() -> None:
    dice = random.Random(5)
    ticker, context = ticks_of(500.0, 60.0, takes=lambda: dice.choice([0.0, 0.0005, 0.0019, 0.003, 0.011]))
    statistics = context.statistics
    assert statistics.skipped > 100
    # ticks run and ticks skipped are all there were until the newest one began: exactly 500 Hz
    assert statistics.cycles + statistics.skipped - 1 == ticker.begun[-1] // (2 * MS)
    # No tick runs before its moment, and who was late is back on the grid at once.
    assert all(later - earlier >= 0 for earlier, later in zip(ticker.begun, ticker.begun[1:], strict=False))
    on_grid = sum(begun % (2 * MS) == 0 for begun in ticker.begun)
    assert on_grid > len(ticker.begun) // 2


@pytest.mark.slow(kept_by="test_in_real_time_too_periods_do_not_follow_the_wall_clock")
@pytest.mark.row(24)
def test_in_real_time_ticks_run_and_skipped_make_up_the_rate() -> None:
    async def main() -> tuple[int, float, int]:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker"))
            context = await kernel.start(PeriodicContext(500.0), ticker, activate=True)
            await asyncio.sleep(2.0)
            statistics = context.statistics
            elapsed = ticker.begun[-1] - ticker.begun[0]
            off = min((begun - ticker.begun[0]) % (2 * MS) for begun in ticker.begun[-50:])
            return statistics.cycles + statistics.skipped, elapsed / S, off

    counted, elapsed, off = asyncio.run(main())
    assert abs(counted - 1 - elapsed * 500.0) <= 2
    assert off < MS or off > 1.9 * MS


@pytest.mark.row(32, 33)
@pytest.mark.fault("C01")
def test_an_execution_of_three_periods_is_an_overrun_each_time_and_never_a_burst() -> None:
    # 1,000 cycles of 3 ms each at 1 kHz
    ticker, context = ticks_of(1000.0, 3.0, takes=0.003)
    statistics = context.statistics
    assert abs(statistics.overruns - 1000) <= 1
    assert abs(statistics.skipped - 2000) <= 2
    assert ticker.begun[:1000] == [n * 3 * MS for n in range(1000)]


@pytest.mark.row(32)
@pytest.mark.fault("C01")
def test_with_catch_up_missed_ticks_of_one_second_are_run_at_once_and_older_ones_skipped() -> None:
    takes = iter([5.0] + [0.0] * 1000)
    ticker, context = ticks_of(100.0, 6.0, overrun="catch_up", takes=lambda: next(takes))
    assert ticker.begun.count(5 * S) == 101  # those due from 4 s to 5 s
    assert ticker.begun[102:] == [5 * S + n * 10 * MS for n in range(1, len(ticker.begun) - 101)]
    assert context.statistics.skipped == 399
    assert context.statistics.lateness_max_ns == 5 * S - 10 * MS  # of tick 1, which is not run


@pytest.mark.row(33)
def test_a_stall_is_in_the_greatest_lateness_in_full() -> None:
    takes = iter([0.0, 10.05] + [0.0] * 1000)
    _, context = ticks_of(10.0, 20.0, takes=lambda: next(takes))
    assert context.statistics.skipped == 99
    assert context.statistics.lateness_max_ns == 9_950 * MS  # the tick of 0.2 s waited until 10.15 s
    assert context.statistics.lateness_total_ns == 50 * MS  # the tick of 10.1 s was run then


@pytest.mark.row(32)
def test_every_overrun_is_published_with_the_ticks_skipped_and_the_lateness() -> None:
    async def main(clock: SimulatedClock) -> list[Overrun]:
        seen: list[Overrun] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(Overrun, seen.append)
            takes = iter([0.0, 0.035] + [0.0] * 100)
            ticker = await kernel.add(Ticker("ticker", lambda: next(takes)))
            await kernel.start(PeriodicContext(100.0, name="loop"), ticker, activate=True)
            await asyncio.sleep(0.2)
        return seen

    assert simulate(main) == [Overrun("loop", 2, 25 * MS)]


def test_an_activation_that_takes_long_is_no_overrun() -> None:
    class Slow(Ticker):
        async def on_activated(self) -> None:
            await self.sleep(0.5)

    async def main(clock: SimulatedClock) -> tuple[int, int, list[int]]:
        async with Kernel() as kernel:
            slow = await kernel.add(Slow("slow"))
            context = await kernel.start(PeriodicContext(100.0, overrun="catch_up"), slow, activate=True)
            await asyncio.sleep(0.025)
            return context.statistics.overruns, context.statistics.skipped, slow.begun

    assert simulate(main) == (0, 0, [500 * MS, 510 * MS, 520 * MS])


@pytest.mark.row(33)
def test_counts_lateness_and_execution_times_are_true() -> None:
    takes = iter([0.001, 0.004, 0.012] + [0.0] * 100)
    _, context = ticks_of(100.0, 0.045, takes=lambda: next(takes))
    statistics = context.statistics
    # ticks at 0, 10, 20 (takes 12: the tick of 30 begins 2 late), 30, 40 ms
    assert (statistics.cycles, statistics.overruns, statistics.skipped) == (5, 1, 0)
    assert (statistics.lateness_max_ns, statistics.lateness_total_ns) == (2 * MS, 2 * MS)
    execute = statistics.hooks["ticker.on_execute"]
    assert (execute.count, execute.total_ns, execute.max_ns) == (5, 17 * MS, 12 * MS)


@pytest.mark.row(35)
@pytest.mark.fault("C10")
def test_another_rate_takes_effect_while_the_context_sleeps() -> None:
    async def main(
        clock: SimulatedClock,
    ) -> tuple[list[int], list[tuple[object, ...]], list[RateChanged], float | None]:
        diary: list[tuple[object, ...]] = []
        changes: list[RateChanged] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(RateChanged, changes.append)
            ticker = await kernel.add(Ticker("ticker"))
            members = [await kernel.add(Diary(name, diary)) for name in ("one", "two")]
            context = await kernel.start(PeriodicContext(1.0, name="loop"), ticker, *members, activate=True)
            await asyncio.sleep(0.25)
            await context.set_rate(1000.0)
            assert clock.monotonic_ns() == 250 * MS
            await asyncio.sleep(0.0035)
            return ticker.begun, [entry for entry in diary if entry[1] == "rate"], changes, context.rate

    begun, told, changes, rate = simulate(main)
    assert begun == [0, 250 * MS, 251 * MS, 252 * MS, 253 * MS]
    assert told == [("one", "rate"), ("two", "rate")]
    assert changes == [RateChanged("loop", 1000.0)]
    assert rate == 1000.0


@pytest.mark.row(35)
def test_a_bad_new_rate_is_refused_and_the_old_one_stays() -> None:
    async def main(clock: SimulatedClock) -> float | None:
        async with Kernel() as kernel:
            context = await kernel.start(PeriodicContext(10.0))
            for rate in (0, -1, math.nan, math.inf, 1e-9, 1e9, "x"):
                with pytest.raises(ConfigurationError):
                    await context.set_rate(rate)  # type: ignore[arg-type]
            return context.rate

    assert simulate(main) == 10.0


@pytest.mark.row(12)
def test_every_member_updates_its_state_after_every_member_has_executed() -> None:
    async def main(clock: SimulatedClock) -> list[tuple[object, ...]]:
        diary: list[tuple[object, ...]] = []
        async with Kernel() as kernel:
            members = [await kernel.add(Diary(name, diary)) for name in ("plant", "pid")]
            context = await kernel.start(PeriodicContext(10.0), *members, activate=True)
            await asyncio.sleep(0.15)
            await context.stop()
        return diary

    cycle = [("plant", "execute"), ("pid", "execute"), ("plant", "update"), ("pid", "update")]
    assert simulate(main) == [
        ("plant", "startup"),
        ("pid", "startup"),
        ("plant", "activated"),
        ("pid", "activated"),
        *cycle,
        *cycle,
        ("pid", "deactivated"),
        ("pid", "shutdown"),
        ("plant", "deactivated"),
        ("plant", "shutdown"),
    ]


@pytest.mark.slow
@pytest.mark.fault("C03")
def test_a_saturating_context_does_not_starve_the_others() -> None:
    async def main() -> tuple[list[int], int]:
        async with Kernel() as kernel:
            busy, calm = await kernel.add(Ticker("busy")), await kernel.add(Ticker("calm"))
            flood = await kernel.start(PeriodicContext(1e6, max_rate=1e6), busy, activate=True)
            await kernel.start(PeriodicContext(100.0), calm, activate=True)
            await asyncio.sleep(1.0)
            return calm.begun, flood.statistics.skipped

    begun, skipped = asyncio.run(main())
    assert len(begun) >= 30  # of 100; one that is starved has none, one on a busy machine skips some
    assert skipped > 0


@pytest.mark.fault("C04")
@pytest.mark.parametrize("jump", [3600, -3600])
def test_a_jump_of_the_wall_clock_moves_stamps_and_no_period(jump: int) -> None:
    async def main(clock: SimulatedClock) -> tuple[list[int], int, int]:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker"))
            context = await kernel.start(PeriodicContext(100.0), ticker, activate=True)
            await asyncio.sleep(0.1)
            clock.set_time_ns(clock.time_ns() + jump * S)
            await asyncio.sleep(0.1)
            return ticker.begun, context.statistics.lateness_max_ns, clock.time_ns()

    begun, late, stamp = simulate(main, clock=SimulatedClock(10_000 * S))
    assert begun == [n * 10 * MS for n in range(len(begun))]
    assert len(begun) >= 20
    assert late == 0
    assert stamp == (10_000 + jump) * S + 200 * MS


@pytest.mark.fault("C04")
def test_in_real_time_too_periods_do_not_follow_the_wall_clock() -> None:
    wall = [0]

    async def main() -> int:
        async with Kernel(clock=SystemClock(lambda: wall[0])) as kernel:
            ticker = await kernel.add(Ticker("ticker"))
            await kernel.start(PeriodicContext(100.0), ticker, activate=True)
            for _ in range(10):
                await asyncio.sleep(0.02)
                wall[0] += random.Random(3).choice([3600, -3600]) * S
            return len(ticker.begun)

    assert 5 <= asyncio.run(main()) <= 25


@pytest.mark.fault("C12")
def test_a_member_that_waits_holds_up_its_own_context_and_no_other() -> None:
    async def main(clock: SimulatedClock) -> tuple[list[int], list[int]]:
        takes = iter([10.0] + [0.0] * 1000)
        async with Kernel() as kernel:
            blocker = await kernel.add(Ticker("blocker", lambda: next(takes)))
            mate, other = await kernel.add(Ticker("mate")), await kernel.add(Ticker("other"))
            await kernel.start(PeriodicContext(100.0), blocker, mate, activate=True)
            await kernel.start(PeriodicContext(100.0), other, activate=True)
            await asyncio.sleep(10.5)
            return mate.begun, other.begun

    mate, other = simulate(main)
    assert mate[0] == 10 * S
    assert other == [n * 10 * MS for n in range(len(other))]
    assert len(other) >= 1050


@pytest.mark.slow(
    kept_by="contexts/test_schedule.py::test_whatever_the_cycles_take_every_tick_is_run_or_counted_as_skipped"
)
@pytest.mark.row(24)
def test_a_thousand_random_schedules_all_keep_their_rate() -> None:
    dice = random.Random(11)
    for _ in range(cases(1000)):
        rate = dice.uniform(1.0, 1000.0)
        _, context = ticks_of(rate, 5.0, takes=lambda rate=rate: dice.uniform(0.0, 2.0 / rate))
        statistics = context.statistics
        assert abs(statistics.cycles + statistics.skipped - 5.0 * rate) <= 2
