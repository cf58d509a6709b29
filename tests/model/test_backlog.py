"""What a context would be late by itself, of schedules that are stalled at random and of some that are too slow."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from aiorts.contexts.schedule import Schedule
from aiorts.model.health.backlog import Backlog

MS = 1_000_000
PERIOD = 10 * MS
stalls = st.lists(st.one_of(st.just(0), st.integers(0, 80 * MS)), min_size=1, max_size=30)


def overruns(costs: list[int], stalls: list[int], policy: str) -> list[bool]:
    """Of each overrun whether the context would have been late by itself; a stall comes in the middle of a cycle."""
    plan, backlog = Schedule(100.0, policy), Backlog()
    pauses: list[tuple[int, int]] = []
    found = []
    now = 0
    plan.start(0)
    for cost, stall in zip(costs, stalls, strict=True):
        now = max(now, plan.due_ns)
        missed = plan.begin(now)
        if missed is not None:
            left_out, late = missed
            first = now - late - PERIOD
            since = sum(max(0, end - max(began, first)) for began, end in pauses)
            total = sum(end - began for began, end in pauses)
            found.append(backlog.late_by_itself(now, late, left_out, PERIOD, total, since))
        now += cost // 2
        pauses.append((now, now + stall))
        now += stall + cost - cost // 2
        plan.end(now)
    return found


@given(stalls, st.integers(0, 9 * MS), st.sampled_from(["skip", "catch_up"]))
def test_what_is_late_by_stalls_alone_is_not_late_by_itself(stalls: list[int], cost: int, policy: str) -> None:
    assert not any(overruns([cost] * len(stalls), stalls, policy))


@given(st.integers(11 * MS, 50 * MS), st.sampled_from(["skip", "catch_up"]))
def test_what_is_late_without_a_stall_is_late_by_itself(cost: int, policy: str) -> None:
    found = overruns([cost] * 20, [0] * 20, policy)
    assert found
    assert all(found)


@given(st.integers(12 * MS, 19 * MS), st.sampled_from(["skip", "catch_up"]))
def test_a_stall_hides_no_more_overruns_than_it_is_long(cost: int, policy: str) -> None:
    found = overruns([cost] * 60, [0] * 10 + [30 * MS] + [0] * 49, policy)
    assert found.count(False) <= 30 * MS // (cost - PERIOD) + 2
