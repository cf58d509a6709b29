"""When ticks are due: pure arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import PeriodicContext
from aiorts.contexts.schedule import Schedule
from aiorts.contexts.thread import ThreadContext
from aiorts.errors import ConfigurationError
from contexts.parts import MS, S

BAD_RATES = [
    0,
    -1,
    math.nan,
    math.inf,
    1e-9,
    1e9,
    "x",
    pytest.param(10**400, id="400"),
    pytest.param(10**5000, id="5000"),
]


@pytest.mark.fault("C02")
@pytest.mark.parametrize("rate", BAD_RATES, ids=repr)
@pytest.mark.parametrize("kind", [PeriodicContext, ThreadContext])
def test_a_rate_out_of_range_is_refused_with_the_range(kind: type[PeriodicContext], rate: object) -> None:
    with pytest.raises(ConfigurationError, match=r"expected.* 0\.001 to 10000 \(max_rate raises"):
        kind(rate)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [True, None, 1j, [1.0]], ids=repr)
def test_what_is_no_number_of_hertz_is_refused(rate: object) -> None:
    with pytest.raises(ConfigurationError):
        PeriodicContext(rate)  # type: ignore[arg-type]


def test_the_ceiling_is_configurable_and_checked() -> None:
    assert PeriodicContext(1e6, max_rate=1e6).rate == 1e6
    with pytest.raises(ConfigurationError, match="max_rate raises the ceiling"):
        PeriodicContext(20_000.0)
    for ceiling in (math.nan, "x", 0.0, True, 1e10):
        with pytest.raises(ConfigurationError, match="max_rate"):
            PeriodicContext(1.0, max_rate=ceiling)  # type: ignore[arg-type]


def test_an_unknown_overrun_policy_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="expected one of skip, catch_up"):
        PeriodicContext(1.0, overrun="burst")


@pytest.mark.row(24)
@given(rate=st.floats(0.001, 10_000.0), start=st.integers(0, 10**18), tick=st.integers(0, 10**9))
def test_tick_n_is_due_at_the_first_nanosecond_not_before_start_plus_n_over_rate(
    rate: float, start: int, tick: int
) -> None:
    plan = Schedule(rate)
    plan.start(start)
    exact = start + tick * S / Fraction(rate)
    assert plan._due(tick) == math.ceil(exact)


@pytest.mark.row(24)
@pytest.mark.parametrize("rate", [0.001, 1 / 3, 333.3, 500.0, 10_000.0])
def test_ticks_in_time_keep_the_rate_for_ever(rate: float) -> None:
    plan = Schedule(rate)
    plan.start(7)
    for n in range(2000):
        assert plan.due_ns == math.ceil(7 + n * S / Fraction(rate))
        assert plan.begin(plan.due_ns) is None
        plan.end(plan.due_ns)
    assert (plan.skipped, plan.overruns, plan.lateness.max_ns) == (0, 0, 0)


@pytest.mark.row(32)
def test_skip_runs_the_newest_tick_that_is_due() -> None:
    plan = Schedule(100.0)
    plan.start(0)
    plan.begin(0)
    plan.end(35 * MS)
    assert plan.begin(35 * MS) == (2, 25 * MS)  # ticks 1 and 2 are left out
    assert plan.due_ns == 30 * MS
    assert plan.lateness.max_ns == 25 * MS  # of tick 1
    assert plan.lateness.total_ns - plan.own_ns == 5 * MS  # of tick 3, which is run
    plan.end(36 * MS)
    assert plan.due_ns == 40 * MS
    assert plan.begin(40 * MS) is None
    assert (plan.overruns, plan.skipped) == (1, 2)


@pytest.mark.row(32)
@pytest.mark.fault("C05")
def test_a_tick_that_begins_when_newer_ones_are_due_gives_way_to_the_newest() -> None:
    plan = Schedule(100.0)
    plan.start(0)
    plan.begin(0)
    plan.end(0)
    assert plan.begin(10 * S + 9 * MS) == (999, 10 * S - MS)
    plan.end(10 * S + 9 * MS)
    assert plan.due_ns == 10 * S + 10 * MS
    assert plan.begin(plan.due_ns) is None
    assert (plan.overruns, plan.skipped) == (1, 999)


@pytest.mark.row(32)
def test_being_late_by_less_than_a_period_is_lateness_and_no_overrun() -> None:
    plan = Schedule(100.0)
    plan.start(0)
    assert plan.begin(9 * MS) is None
    plan.end(10 * MS)
    assert plan.begin(10 * MS) is None
    assert (plan.overruns, plan.lateness.max_ns) == (0, 9 * MS)


@pytest.mark.row(32)
def test_catch_up_runs_every_missed_tick_of_the_last_second_and_none_older() -> None:
    plan = Schedule(100.0, "catch_up")
    plan.start(0)
    plan.begin(0)
    plan.end(5 * S)
    dues = []
    while plan.due_ns <= 5 * S:
        plan.begin(5 * S)
        dues.append(plan.due_ns)
        plan.end(5 * S)
    assert plan.skipped == 399  # due at 10 ms to 3.99 s; the tick of 4 s is just one second old
    assert dues == [4 * S + n * 10 * MS for n in range(101)]
    assert all(5 * S - due <= S for due in dues)


@pytest.mark.row(32)
def test_catch_up_of_a_slow_context_runs_the_newest_tick_however_old() -> None:
    for policy in ("skip", "catch_up"):
        plan = Schedule(0.1, policy)
        plan.start(0)
        plan.begin(0)
        plan.end(25 * S)
        assert plan.begin(25 * S) == (1, 15 * S)
        assert plan.due_ns == 20 * S


@pytest.mark.row(24, 32)
@given(
    rate=st.sampled_from([0.001, 1 / 3, 333.3, 500.0, 10_000.0]),
    policy=st.sampled_from(["skip", "catch_up"]),
    takes=st.lists(st.integers(0, 3 * S), max_size=60),
)
def test_whatever_the_cycles_take_every_tick_is_run_or_counted_as_skipped(
    rate: float, policy: str, takes: list[int]
) -> None:
    plan, now = Schedule(rate, policy), 0
    plan.start(0)
    for run, taken in enumerate(takes):
        now = max(now, plan.due_ns)
        plan.begin(now)
        assert plan.due_ns == math.ceil((run + plan.skipped) * S / Fraction(rate))
        assert plan.due_ns <= now
        # never more than the newest one behind, or than what is caught up with
        assert now < plan.due_ns + S / rate + 1 or (policy == "catch_up" and now - plan.due_ns <= S)
        now += taken
        plan.end(now)


@pytest.mark.row(35)
@pytest.mark.parametrize(("before", "now", "rate", "due"), [(1.0, S // 2, 1000.0, S // 2), (100.0, 3, 1.0, S)])
def test_after_a_change_of_rate_the_next_tick_is_a_new_period_after_the_last_or_now(
    before: float, now: int, rate: float, due: int
) -> None:
    plan = Schedule(before)
    plan.start(0)
    plan.begin(0)
    plan.end(0)
    plan.set_rate(rate, now)
    assert plan.due_ns == due
    assert plan.overruns == 0
