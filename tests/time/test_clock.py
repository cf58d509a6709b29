"""Clocks: what jumps, what never does, and exact integer nanoseconds."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.clock import ScaledClock, SimulatedClock, SystemClock, current_clock, to_ns
from aiorts.errors import StateError

HOUR = 3600 * 10**9


@pytest.mark.fault("C04")
@pytest.mark.parametrize("jump", [HOUR, -HOUR])
def test_wall_clock_jump_moves_stamps_and_not_periods(jump: int) -> None:
    wall = [5 * HOUR]
    clock = SystemClock(wall=lambda: wall[0])
    before = clock.monotonic_ns()
    wall[0] += jump
    assert clock.time_ns() == 5 * HOUR + jump
    assert clock.time() == (5 * HOUR + jump) / 1e9
    assert 0 <= clock.monotonic_ns() - before < HOUR // 60


@pytest.mark.fault("C04")
def test_simulated_wall_clock_jump_leaves_deadlines_alone() -> None:
    clock = SimulatedClock(start_ns=5 * HOUR)
    clock.call_at(10, lambda: None)
    clock.set_time_ns(4 * HOUR)
    assert (clock.time_ns(), clock.monotonic_ns(), clock.next_deadline()) == (4 * HOUR, 0, 10)


def test_system_clock_is_the_machines() -> None:
    clock = SystemClock()
    assert abs(clock.time_ns() - time.time_ns()) < 10**9
    assert abs(clock.monotonic_ns() - time.monotonic_ns()) < 10**9
    assert clock.real_deadline_ns(7) == 7
    assert clock.speed == 1.0


@pytest.mark.parametrize("speed", [200.0, 0.5, 1.0, 0.1])
def test_scaled_clock_scales_stamps_and_periods_alike(speed: float) -> None:
    real = [1000]
    clock = ScaledClock(speed, start_ns=77, real=lambda: real[0])
    assert (clock.time_ns(), clock.monotonic_ns(), clock.speed) == (77, 1000, speed)
    real[0] += HOUR
    elapsed = clock.monotonic_ns() - 1000
    assert elapsed == pytest.approx(HOUR * speed, abs=1, rel=1e-15)
    assert clock.time_ns() - 77 == elapsed


@given(
    speed=st.floats(1e-3, 1e4),
    base=st.integers(0, 10**15),
    ahead=st.integers(-(10**12), 10**18),
)
def test_scaled_deadline_is_the_first_real_moment_at_which_it_is_reached(speed: float, base: int, ahead: int) -> None:
    real = [base]
    clock = ScaledClock(speed, real=lambda: real[0])
    deadline = base + ahead
    real[0] = clock.real_deadline_ns(deadline)
    assert clock.monotonic_ns() >= deadline
    real[0] -= 1
    assert clock.monotonic_ns() < deadline


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_scaled_clock_refuses_a_speed_that_is_none(speed: float) -> None:
    with pytest.raises(ValueError, match="speed="):
        ScaledClock(speed)


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.1, 10**8), (3, 3 * 10**9), (10**9 + 1, (10**9 + 1) * 10**9), (1e-15, 1), (-1.5, -15 * 10**8)],
)
def test_seconds_become_the_nearest_nanosecond(seconds: float, expected: int) -> None:
    assert to_ns(seconds) == expected


@pytest.mark.parametrize("seconds", [math.nan, math.inf, -math.inf])
def test_no_number_of_seconds_is_refused_by_name(seconds: float) -> None:
    with pytest.raises(ValueError, match="delay="):
        to_ns(seconds, "delay")


def test_simulated_deadline_has_no_real_time() -> None:
    with pytest.raises(StateError, match="simulated"):
        SimulatedClock().real_deadline_ns(1)


def test_outside_of_a_loop_there_is_no_current_clock() -> None:
    assert current_clock() is None
