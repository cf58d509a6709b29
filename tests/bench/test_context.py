"""Ticks to figures, from moments that are known exactly; and the rows of `aiorts bench context`, at a tiny size."""

from __future__ import annotations

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts_bench.harness.bench import with_aims
from aiorts_bench.harness.case import Case
from aiorts_bench.harness.report import Row
from aiorts_bench.harness.runner import measure
from aiorts_bench.punctuality import context, paper
from aiorts_bench.punctuality.pacing import Ticks, Timing, best_deviation
from aiorts_bench.punctuality.ticking import reading_of

MS = 1_000_000
PERIOD = 2 * MS


def ticks(late: list[int], *, numbers: list[int] | None = None, skipped: int = 0, factor: float = 1.0) -> Ticks:
    """Ticks of 2 ms times `factor`, each so much too late."""
    numbers = numbers or list(range(len(late)))
    due = [round(1000 * MS + number * PERIOD * factor) for number in numbers]
    return Ticks(PERIOD, due, [one + more for one, more in zip(due, late, strict=True)], skipped)


def test_lateness_and_periods() -> None:
    found = ticks([10, 30, 20, 20])
    timing = Timing.of(found)
    assert found.lateness_ns == [10, 30, 20, 20]
    assert found.periods_ns == [PERIOD + 20, PERIOD - 10, PERIOD]
    assert timing.period_deviation == statistics.pstdev([20, -10, 0])
    assert timing.executed == pytest.approx(500, rel=1e-4)


def test_a_period_in_which_a_tick_was_left_out_is_no_period_but_an_interval() -> None:
    found = ticks([0, 0, 0, 0], numbers=[0, 1, 3, 4], skipped=1)
    assert found.complete
    assert found.periods_ns == [PERIOD, PERIOD]
    assert found.intervals_ns == [PERIOD, 2 * PERIOD, PERIOD]
    assert Timing.of(found).executed == pytest.approx(3e9 / (4 * PERIOD))


def test_who_leaves_out_every_second_tick_deviates_by_a_period() -> None:
    timing = Timing.of(ticks([0] * 10, numbers=list(range(0, 20, 2)), skipped=9))
    assert timing.period_deviation_best == timing.period_deviation == PERIOD
    assert timing.executed == pytest.approx(250)


def test_ticks_run_and_skipped_that_are_not_all_that_were_due_are_a_fault() -> None:
    lost = ticks([0] * 8, numbers=[0, 1, 2, 4, 5, 6, 7, 8], skipped=0)
    assert not lost.complete
    assert "8 ticks run + 0 skipped, but 9 were due" in reading_of(lost).faults[0]
    counted = Ticks(PERIOD, lost.due_ns, lost.ran_ns, 1, counted=7)
    assert "the context counted 7" in reading_of(counted).faults[0]


@pytest.mark.slow(kept_by="test_rate_error_forgives_one_late_tick_at_the_end")
@given(st.lists(st.integers(0, 40_000), min_size=40, max_size=120), st.sampled_from([1.0, 1.0001, 1.002, 0.999]))
def test_rate_error_is_the_drift_and_not_the_lateness_of_single_ticks(late: list[int], factor: float) -> None:
    # A context that calls its own drifting moments due is found out: the nominal period is the measure.
    found = ticks(late, factor=factor).rate_error
    bound = 40_000 / (len(late) * PERIOD / 2)
    assert found == pytest.approx(1 / factor - 1, abs=bound)


def test_moments_called_due_that_drift_by_whole_periods_are_missing_ticks() -> None:
    assert not ticks([0] * 100, factor=1.073).complete


def test_rate_error_forgives_one_late_tick_at_the_end() -> None:
    assert ticks([0] * 99 + [1_500_000]).rate_error == 0.0
    assert ticks([0] * 100, factor=1.001).rate_error == pytest.approx(-0.001, rel=0.01)


def test_deviation_of_the_best_leaves_one_in_a_hundred_out() -> None:
    late = PERIOD + 5 * MS
    assert best_deviation([*[PERIOD] * 99, late], PERIOD) == 0
    assert best_deviation([*[PERIOD] * 98, late, late], PERIOD) > 0


def tiny(cases: tuple[Case, ...], *names: str) -> dict[str, Row]:
    chosen = tuple(case for case in with_aims(cases) if case.name in names)
    return {row.case.name: row for row in measure(chosen, loop="asyncio", rounds=1, scale=0.4)}


@pytest.mark.slow(kept_by="test_ticks_run_and_skipped_that_are_not_all_that_were_due_are_a_fault")
def test_rows_of_the_loop_run_every_tick_that_was_due() -> None:
    rows = tiny(context.loop_cases(), "asyncio.sleep", "periodic, 1", "periodic, 10", "event", "external")
    assert {name: row.faults for name, row in rows.items() if row.faults} == {}
    for row in rows.values():
        assert row.messages == 24
        assert {"executed", "interval p99", "rate error", "deviation 99 %"} <= set(row.figures)


@pytest.mark.slow(kept_by="test_lateness_and_periods")
def test_rows_of_a_real_time_context_stand_beside_the_bare_system_call() -> None:
    rows = tiny(
        context.thread_cases(None),
        *("clock_nanosleep", "time.sleep", "thread, 1", "realtime, 1", "realtime, 10", "realtime, four"),
        "realtime, busy",
    )
    assert {name: row.faults for name, row in rows.items() if row.faults} == {}
    aims = {(one.aim.baseline, one.measure.name, one.aim.factor) for one in rows["realtime, four"].ratios}
    assert aims == {
        ("clock_nanosleep", "lateness p50", 2.0),
        ("clock_nanosleep", "deviation 99 %", 2.0),
        ("", "rate error", 100.0),
    }
    assert [one.measure.name for one in rows["realtime, busy"].ratios] == ["lateness p99"]


def test_a_short_round_does_not_judge_the_rate() -> None:
    assert "rate error" not in {
        aim.measure.name for case in context.loop_cases(long=False) for aim in case.aims if aim.measure
    }
    assert "rate error" in {aim.measure.name for case in context.loop_cases() for aim in case.aims if aim.measure}


def test_every_aim_names_a_case_of_its_table() -> None:
    for table in (context.loop_cases(), context.thread_cases(None), paper.cases(None, context.realtime(), 50)):
        assert {aim.baseline for case in table for aim in case.aims} - {""} <= {case.name for case in table}
