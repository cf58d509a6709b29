"""The lifecycle table: every state and event has an answer, and every hook that raises has a consequence."""

from __future__ import annotations

import itertools

import pytest

from aiorts.model.lifecycle import ADVICE, HOOKS, ON_FAILURE, TRANSITIONS, Event, Failure, LifecycleState, transition

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


@pytest.mark.row(10)
@pytest.mark.parametrize(("state", "event"), list(itertools.product(LifecycleState, Event)))
def test_every_event_in_every_state_leads_somewhere_or_is_refused_with_advice(
    state: LifecycleState, event: Event
) -> None:
    way = transition(state, event)
    assert (way is None) == ((state, event) in ADVICE)
    if way is not None:
        assert set(way.hooks) <= set(HOOKS)


@pytest.mark.row(10)
def test_the_ways_are_those_of_the_rtc_specification() -> None:
    ways = {key: (way.hooks, way.target) for key, way in TRANSITIONS.items()}
    assert ways == {
        (I, Event.ACTIVATE): (("on_activated",), A),
        (A, Event.DEACTIVATE): (("on_deactivated",), I),
        (A, Event.FAIL): (("on_deactivated", "on_aborting"), E),
        (I, Event.FAIL): (("on_aborting",), E),
        (E, Event.RESET): (("on_reset",), I),
        (E, Event.FAIL): ((), E),
    }


def test_no_state_but_inactive_leads_to_active_and_only_reset_leads_out_of_error() -> None:
    assert [key for key, way in TRANSITIONS.items() if way.target is A] == [(I, Event.ACTIVATE)]
    assert [event for (state, event), way in TRANSITIONS.items() if state is E and way.target is not E] == [Event.RESET]


@pytest.mark.row(11)
@pytest.mark.fault("A01")
def test_each_of_the_twelve_hooks_has_one_consequence_when_it_raises() -> None:
    assert len(HOOKS) == 12
    assert ON_FAILURE.keys() == set(HOOKS)
    by_consequence = {failure: {hook for hook, what in ON_FAILURE.items() if what is failure} for failure in Failure}
    assert by_consequence == {
        Failure.REFUSE: {"on_initialize"},
        Failure.ABORT: {"on_startup", "on_activated", "on_execute", "on_state_update", "on_rate_changed"},
        Failure.STAY: {"on_reset", "on_error", "on_aborting"},
        Failure.RECORD: {"on_deactivated", "on_shutdown", "on_finalize"},
    }
