"""The push policies as functions of counts."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.model.policy import Choice, Push, Subscription, admits, choose, default_push

NUMBERS = st.integers(1, 1_000)
BACKLOGS = st.integers(0, 50)


def test_the_default_is_all_for_flush_and_new_for_the_others() -> None:
    assert {kind.value: default_push(kind).value for kind in Subscription} == {
        "flush": "all",
        "new": "new",
        "periodic": "new",
    }


@pytest.mark.row(40)
@given(skip=st.integers(0, 20), first=NUMBERS)
def test_skip_sends_every_n_plus_first_and_the_others_send_all(skip: int, first: int) -> None:
    window = range(first, first + skip + 1)
    assert sum(admits(Push.SKIP, skip, number) for number in window) == 1
    assert admits(Push.SKIP, skip, skip + 1)
    assert not any(admits(Push.SKIP, skip, n) for n in range(1, skip + 1))
    for push in (Push.ALL, Push.FIFO, Push.NEW):
        assert all(admits(push, skip, number) for number in window)


@pytest.mark.row(40)
@given(first=NUMBERS, backlog=BACKLOGS, skip=st.integers(0, 5))
def test_what_a_period_does_with_its_backlog(first: int, backlog: int, skip: int) -> None:
    assert choose(Push.ALL, skip, first, backlog) == (Choice.SEND,) * backlog
    assert choose(Push.FIFO, skip, first, backlog) == ((Choice.SEND,) if backlog else ())
    newest = choose(Push.NEW, skip, first, backlog)
    assert newest == ((*(Choice.SUPERSEDE,) * (backlog - 1), Choice.SEND) if backlog else ())


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(40)
@given(skip=st.integers(0, 5), split=st.lists(st.integers(0, 7), max_size=10))
def test_skip_sends_the_same_samples_however_they_fall_into_periods(skip: int, split: list[int]) -> None:
    first = 1
    choices: list[Choice] = []
    for backlog in split:
        choices += choose(Push.SKIP, skip, first, backlog)
        first += backlog
    assert choices == list(choose(Push.SKIP, skip, 1, sum(split)))
    assert [choice is Choice.SEND for choice in choices] == [
        admits(Push.SKIP, skip, number) for number in range(1, sum(split) + 1)
    ]
