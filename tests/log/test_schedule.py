"""When which sample is due: pauses, jumps, gaps, passes and other paces, held against what a listener would observe."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts_log.playing.schedule import Pace, Schedule

S = 1_000_000_000
BEGIN = 1_700_000_000 * S


def play(schedule: Schedule, times: list[int], now: int) -> list[int]:
    """The moments at which samples of those times go out when nobody is late."""
    moments = []
    for time in times:
        schedule.take(time)
        assert schedule.due is not None
        now = max(now, schedule.due)
        schedule.sent(now, allowed=schedule.paused)
        moments.append(now)
    return moments


TIMES = st.lists(st.integers(0, 5 * S), min_size=1, max_size=50).map(lambda steps: _summed(steps))


def _summed(steps: list[int]) -> list[int]:
    times, at = [], BEGIN
    for step in steps:
        at += step
        times.append(at)
    return times


@given(TIMES, st.floats(0.1, 1000.0), st.integers(0, 10 * S))
def test_each_sample_is_due_at_its_distance_from_the_first_over_the_speed(
    times: list[int], speed: float, now: int
) -> None:
    moments = play(Schedule(Pace(speed), now), times, now)
    for time, moment in zip(times, moments, strict=True):
        exact = now + Fraction(time - times[0]) / Fraction(repr(speed))
        assert 0 <= moment - exact < 1  # never early, and never a whole nanosecond late: no drift


def test_in_an_hour_of_a_thousand_samples_a_second_nothing_adds_up() -> None:
    schedule = Schedule(Pace(0.3), 7)
    last = 0
    for number in range(0, 3_600_000, 997):
        schedule.take(BEGIN + number * S // 1000)
        assert schedule.due is not None
        last = schedule.due
        schedule.sent(last)
    exact = 7 + Fraction((3_599_170 * S) // 1000) / Fraction("0.3")
    assert 0 <= last - exact < 1


@given(TIMES, st.floats(0.5, 1e6))
def test_with_a_rate_their_own_times_do_not_count(times: list[int], rate: float) -> None:
    moments = play(Schedule(Pace(rate=rate), 3), times, 3)
    for number, moment in enumerate(moments):
        assert 0 <= moment - (3 + number * S / Fraction(repr(rate))) < 1


@given(TIMES)
def test_as_fast_as_possible_everything_is_due_at_once(times: list[int]) -> None:
    assert set(play(Schedule(Pace(float("inf")), 5), times, 5)) == {5}


@pytest.mark.fault("D14")
@given(TIMES, st.integers(1, 3 * S), st.floats(0.1, 1000.0))
def test_of_a_gap_no_more_is_waited_for_than_allowed(times: list[int], most: int, speed: float) -> None:
    schedule = Schedule(Pace(speed, max_gap=most), 0)
    now, left_out = 0, 0
    for before, time in zip([times[0], *times], times, strict=False):
        cut = schedule.take(time)
        assert cut == max(0, time - before - most)
        left_out += cut
        assert schedule.due is not None
        now = schedule.due
        assert 0 <= now - Fraction(time - times[0] - left_out) / Fraction(repr(speed)) < 1
        schedule.sent(now)
    assert schedule.shift == -left_out


@pytest.mark.fault("D14")
def test_where_the_clock_was_set_back_the_next_is_due_with_the_last_and_distances_hold_from_there() -> None:
    hour = 3600 * S
    schedule = Schedule(Pace(), 0)
    assert play(schedule, [BEGIN, BEGIN + S, BEGIN + S - hour, BEGIN + 3 * S - hour], 0) == [0, S, S, 3 * S]
    assert schedule.shift == hour  # stamps that were set back as well go on from where they were


def test_a_position_given_is_where_the_clock_begins_to_run() -> None:
    assert play(Schedule(Pace(2.0), 100, BEGIN), [BEGIN + S, BEGIN + 2 * S], 100) == [100 + S // 2, 100 + S]


@pytest.mark.parametrize("pace", [Pace(), Pace(rate=1.0)])
def test_time_until_the_first_sample_is_there_is_not_played(pace: Pace) -> None:
    schedule = Schedule(pace, 0)
    schedule.begin(5 * S)
    assert play(schedule, [BEGIN, BEGIN + S], 5 * S) == [5 * S, 6 * S]


def test_nor_is_time_until_a_place_is_found_and_stamps_keep_step_over_it() -> None:
    schedule = Schedule(Pace(), 0)
    play(schedule, [BEGIN], 0)
    schedule.jump(S, BEGIN + 100 * S)
    schedule.begin(3 * S)
    assert play(schedule, [BEGIN + 100 * S, BEGIN + 101 * S], 3 * S) == [3 * S, 4 * S]
    assert BEGIN + 101 * S + schedule.shift == BEGIN + 4 * S


class TestPause:
    def test_what_was_left_to_wait_for_is_left_when_it_goes_on(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.take(BEGIN + 10 * S)
        schedule.pause(4 * S)
        assert schedule.due is None
        assert schedule.position(1000 * S) == BEGIN + 4 * S
        schedule.resume(3600 * S)
        assert schedule.due == 3606 * S

    def test_what_was_late_when_it_was_paused_is_due_once_when_it_goes_on_and_the_rest_behind_it(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.take(BEGIN + S)  # held up by a reader until 50 s
        schedule.pause(50 * S)
        schedule.resume(60 * S)
        assert play(schedule, [BEGIN + S, BEGIN + 2 * S], 60 * S) == [60 * S, 61 * S]

    def test_so_many_are_sent_as_are_allowed(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.pause(0)
        schedule.allow(2)
        assert play(schedule, [BEGIN + S, BEGIN + 2 * S], 5 * S) == [5 * S, 5 * S]
        schedule.take(BEGIN + 5 * S)
        assert schedule.due is None
        schedule.resume(100 * S)
        assert schedule.due == 103 * S  # as long behind the sample that went out as was recorded

    def test_one_that_was_on_its_way_when_it_was_paused_is_none_of_those_that_are_allowed(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.take(BEGIN + S)
        schedule.pause(2 * S)
        schedule.allow(1)
        schedule.sent(3 * S)
        assert play(schedule, [BEGIN + 2 * S], 3 * S) == [3 * S]
        schedule.take(BEGIN + 3 * S)
        assert schedule.due is None

    def test_steps_of_one_that_plays_are_none(self) -> None:
        schedule = Schedule(Pace(), 0)
        schedule.allow(5)
        schedule.take(BEGIN)
        schedule.pause(0)
        assert schedule.due is None

    def test_with_a_rate_a_period_goes_on_where_it_was(self) -> None:
        schedule = Schedule(Pace(rate=1.0), 0)
        play(schedule, [1, 2, 3], 0)
        schedule.take(4)
        schedule.pause(2 * S + S // 4)
        schedule.resume(10 * S)
        assert schedule.due == 10 * S + 3 * S // 4


class TestPasses:
    def test_the_first_of_the_next_pass_is_as_far_behind_the_last_as_that_was_behind_the_one_before_it(self) -> None:
        schedule = Schedule(Pace(), 0)
        assert play(schedule, [BEGIN, BEGIN + S, BEGIN + 3 * S], 0) == [0, S, 3 * S]
        schedule.again(BEGIN)
        assert play(schedule, [BEGIN, BEGIN + S], 3 * S) == [5 * S, 6 * S]

    def test_passes_do_not_drift_when_who_plays_is_late(self) -> None:
        schedule = Schedule(Pace(), 0)
        for _ in range(100):
            for time in (BEGIN, BEGIN + S):
                schedule.take(time)
                schedule.sent((schedule.due or 0) + 1_000_000)
            schedule.again(BEGIN)
        schedule.take(BEGIN)
        assert schedule.due == 200 * S

    def test_one_moment_alone_is_not_repeated_without_end_in_no_time(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN, BEGIN], 0)
        schedule.again(BEGIN)
        assert play(schedule, [BEGIN], 0) == [S]

    def test_a_rate_goes_on_counting(self) -> None:
        schedule = Schedule(Pace(rate=2.0), 0)
        play(schedule, [BEGIN, BEGIN + S], 0)
        schedule.again(BEGIN)
        assert play(schedule, [BEGIN, BEGIN], 0) == [S, 3 * S // 2]


class TestChange:
    def test_another_speed_holds_from_where_it_is(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.take(BEGIN + 10 * S)
        schedule.change(4 * S, Pace(2.0))
        assert schedule.due == 7 * S

    def test_from_as_fast_as_possible_to_a_speed(self) -> None:
        schedule = Schedule(Pace(float("inf")), 0)
        play(schedule, [BEGIN, BEGIN + 10 * S], 0)
        schedule.change(S, Pace())
        schedule.take(BEGIN + 11 * S)
        assert schedule.due == 2 * S

    def test_from_times_to_a_rate_and_back(self) -> None:
        schedule = Schedule(Pace(), 0)
        play(schedule, [BEGIN], 0)
        schedule.change(S, Pace(rate=10.0))
        assert play(schedule, [BEGIN + 5 * S, BEGIN + 6 * S], S) == [S, S + S // 10]
        schedule.change(2 * S, Pace())
        schedule.take(BEGIN + 7 * S)
        assert schedule.due == 3 * S

    def test_the_same_pace_changes_nothing(self) -> None:
        schedule = Schedule(Pace(3.0), 0)
        play(schedule, [BEGIN], 0)
        schedule.take(BEGIN + 10)
        before = schedule.due
        schedule.change(2, Pace(3.0))
        assert schedule.due == before


@pytest.mark.fault("D15")
@pytest.mark.parametrize("value", [0, -1, float("nan"), 0.0])
@pytest.mark.parametrize("name", ["speed", "rate", "max_gap"])
def test_a_pace_that_makes_no_sense_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Pace(**{name: value})  # type: ignore[arg-type]


def test_a_rate_without_end_is_refused() -> None:
    with pytest.raises(ValueError, match="rate"):
        Pace(rate=float("inf"))


ACTS = st.lists(
    st.one_of(
        st.tuples(st.just("sample"), st.integers(-2 * S, 20 * S)),
        st.tuples(st.just("wait"), st.integers(0, 5 * S)),
        st.tuples(st.just("pause"), st.just(0)),
        st.tuples(st.just("resume"), st.just(0)),
        st.tuples(st.just("allow"), st.integers(0, 3)),
        st.tuples(st.just("jump"), st.integers(-100 * S, 100 * S)),
        st.tuples(st.just("again"), st.integers(-100 * S, 0)),
        st.tuples(st.just("held up"), st.integers(0, 5 * S)),
    ),
    max_size=60,
)


@pytest.mark.slow(kept_by="test_nor_is_time_until_a_place_is_found_and_stamps_keep_step_over_it")
@settings(max_examples=150)
@given(ACTS)
def test_whatever_happens_stamps_keep_step_with_the_clock_and_nothing_bursts(acts: list[Any]) -> None:
    """At speed 1 a stamp plus the shift is the time of the clock when the sample goes out, unless a reader held it up.

    Between two samples that nobody held up at least the time between them passes, but for steps.
    """
    schedule, now, at, late = Schedule(Pace(max_gap=10 * S), 0), 0, BEGIN, 0
    waiting: int | None = None
    first: int | None = None
    for act, value in acts:
        if act == "sample" and waiting is None:
            at += value
            waiting = at
            schedule.take(at)
            first = at if first is None else first
        elif act == "wait":
            now += value
        elif act == "pause":
            schedule.pause(now)
            late = 0
        elif act == "resume":
            schedule.resume(now)
        elif act == "allow":
            schedule.allow(value)
        elif act == "jump" and first is not None:
            at += value
            waiting = None
            schedule.jump(now, at)
            late = 0
        elif act == "again" and first is not None and waiting is None:
            at += value
            schedule.again(at)
        elif act == "held up":
            late = value
        if waiting is not None and (due := schedule.due) is not None and due <= now + late:
            # Whoever plays sees to it as soon as it is due, or when the reader lets go of it.
            moment = max(now, due)
            assert first is not None
            schedule.sent(moment, allowed=schedule.paused)
            assert waiting + schedule.shift - first <= moment
            now, waiting = moment, None
        position = schedule.position(now)
        if position is not None:
            assert schedule.last is not None
            assert position >= schedule.last


@pytest.mark.slow
@given(st.lists(st.tuples(st.sampled_from(["sample", "pause", "step", "jump", "again"]), st.integers(0, 9 * S))))
def test_who_is_never_late_stamps_with_the_time_of_the_clock_itself(acts: list[tuple[str, int]]) -> None:
    schedule, now, at = Schedule(Pace(max_gap=5 * S), 0), 0, BEGIN
    schedule.take(at)
    schedule.sent(now)
    for act, value in acts:
        if act == "pause":
            schedule.pause(now)
            now += value
            schedule.resume(now)
        elif act == "step":
            schedule.pause(now)
            now += value
            schedule.allow(1)
            at += value
            schedule.take(at)
            assert schedule.due is not None
            schedule.sent(now, allowed=True)
            assert at + schedule.shift == BEGIN + now
            now += 5
            schedule.resume(now)
        elif act == "jump":
            at += value - 4 * S
            schedule.jump(now, at)
        elif act == "again":
            at -= value
            schedule.again(at)
        else:
            at += value
            schedule.take(at)
            due = schedule.due
            assert due is not None
            assert due >= now
            now = due
            schedule.sent(now)
            assert at + schedule.shift == BEGIN + now
