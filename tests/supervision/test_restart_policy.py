"""The decisions of supervision: when help is given again, and when no more; any order of failures keeps the rules."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as budgeted
from hypothesis import strategies as st

from aiorts import Supervision
from aiorts.errors import ConfigurationError
from aiorts.model.wanted.restart_policy import Attempts
from campaign import cases

S = 1_000_000_000


def crash_loop(policy: Supervision, up: float, most: int = 1000) -> list[float]:
    """Delays of something that always fails `up` seconds after it was helped."""
    attempts, now, delays = Attempts(policy), 0, []
    while len(delays) < most:
        delay = attempts.failed(now)
        if delay is None:
            break
        delays.append(delay)
        now += round((delay + up) * S)
    return delays


@pytest.mark.fault("A18")
@pytest.mark.row(17)
def test_default_budget_is_five_in_thirty_seconds_with_doubling_delays() -> None:
    assert crash_loop(Supervision("restart"), 0.0) == [0.1, 0.2, 0.4, 0.8, 1.6]


def test_delays_end_at_the_longest() -> None:
    delays = crash_loop(Supervision("reset", budget=100), 0.0, most=20)
    assert delays[:9] == pytest.approx([0.1 * 2**n for n in range(9)])
    assert set(delays[9:]) == {30.0}


def test_a_long_good_run_starts_from_the_first_delay_again() -> None:
    attempts = Attempts(Supervision("restart"))
    assert attempts.failed(0) == 0.1
    assert attempts.failed(1 * S) == 0.2
    assert attempts.failed(60 * S) == 0.1
    assert attempts.total == 3


def test_never_is_never() -> None:
    attempts = Attempts(Supervision())
    assert attempts.failed(0) is None
    assert not attempts.exhausted


POLICIES = st.builds(
    Supervision,
    restart=st.sampled_from(["reset", "restart"]),
    backoff=st.floats(0.001, 1.0),
    backoff_max=st.floats(1.0, 60.0),
    budget=st.integers(0, 8),
    window=st.floats(0.5, 100.0),
)


@pytest.mark.slow(kept_by="test_default_budget_is_five_in_thirty_seconds_with_doubling_delays")
@given(policy=POLICIES, ups=st.lists(st.floats(0.0, 200.0), max_size=60))
@budgeted(max_examples=cases(10_000))
@pytest.mark.campaign
def test_never_more_than_the_budget_in_any_window(policy: Supervision, ups: list[float]) -> None:
    attempts, now, given_at, before = Attempts(policy), 0, [], 0.0
    window_ns = round(policy.window * S)
    for up in ups:
        now += round(up * S)
        failed_ns = now
        delay = attempts.failed(now)
        if delay is None:
            # Given up for a reason: the budget was used within one window; and for good.
            recent = [at for at in given_at if now - at < window_ns]
            assert len(recent) >= policy.budget
            assert attempts.exhausted
            assert attempts.failed(now + 10**15) is None
            return
        assert policy.backoff <= delay <= policy.backoff_max
        assert delay in (policy.backoff, min(before * 2, policy.backoff_max))
        before = delay
        now += round(delay * S)
        given_at.append(now)
        window = [at for at in given_at if failed_ns - at < window_ns]
        assert len(window) <= policy.budget


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"restart": "always"}, "restart = 'always'"),
        ({"backoff": 0.0}, "backoff = 0.0"),
        ({"backoff": float("nan")}, "backoff = nan"),
        ({"window": True}, "window = True"),
        ({"backoff": 2.0, "backoff_max": 1.0}, "backoff_max"),
        ({"budget": -1}, "budget = -1"),
        ({"budget": 2.5}, "budget = 2.5"),
        ({"deadline": -1.0}, "deadline = -1.0"),
        ({"deadlines": {"on_exekute": 1.0}}, "on_exekute"),
        ({"deadlines": {"on_initialize": 1.0}}, "on_initialize"),
        ({"deadlines": {"on_execute": "soon"}}, "deadlines.on_execute"),
    ],
)
def test_what_is_out_of_range_is_named(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigurationError, match=says):
        Supervision(**wrong)
