"""The test kit for state machines: what was reached, and a path to each transition."""

from __future__ import annotations

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings

from aiorts import EventContext, EventPort, Param, StateMachineComponent
from aiorts.errors import DeclarationError
from aiorts.statechart import After, Always, Chart, End, History, In, On, Parallel, State
from aiorts.statemachines.interpreter import Machine, MachineEvent
from aiorts.testing import ChartCoverage, ChartPath, Rig, chart_coverage, chart_paths, simulated
from aiorts.types import TimedBoolean, TimedDouble
from statemachines.test_microstep import chart_of, charts

EXAMPLES = 500 if os.environ.get("AIORTS_CAMPAIGN") else 25


class Door(StateMachineComponent):
    """The door of the guide."""

    button = EventPort(TimedBoolean)
    barrier = EventPort(TimedDouble, unit="m")
    stop = EventPort(TimedBoolean)
    dwell = Param(5.0, unit="s", gt=0.0)
    chart = Chart(
        State(
            "works",
            State("closed", On("button", to="opening"), initial=True),
            State("opening", After(2.0, to="open")),
            State("open", After("dwell", to="closing"), On("button", to="closing")),
            State("closing", After(2.0, to="closed"), On("barrier", to="opening", guard="is_near")),
            On("stop", to="stopped"),
            History("before"),
            initial=True,
        ),
        State("stopped", On("button", to="before")),
    )

    def is_near(self, distance: TimedDouble) -> bool:
        return distance.data < 0.8


@pytest.mark.parametrize("path", chart_paths(Door).paths, ids=str)
def test_each_path_leads_a_real_component_to_its_transition(path: ChartPath) -> None:
    @simulated
    async def run() -> None:
        door = Door("door0")
        with chart_coverage(Door) as coverage:
            async with Rig(door, context=EventContext()) as rig:
                for move in path.moves:
                    assert not coverage.transitions[path.transition]
                    if move.event:
                        door.machine.send(move.event, TimedDouble(0, 0.3 if move.guards.get("is_near") else 9.0))
                    await rig.advance(move.seconds)
                assert coverage.transitions[path.transition] == 1

    run()


def test_all_transitions_of_the_door_have_a_path_of_the_fewest_moves() -> None:
    found = {str(path): " ".join(map(str, path.moves)) for path in chart_paths(Door).paths}
    assert found == {
        "works stop -> stopped": "stop",
        "closed button -> opening": "button",
        "opening after.opening.1 -> open": "button 2 s",
        "open after.open.1 -> closing": "button 2 s 5 s",
        "open button -> closing": "button 2 s button",
        "closing after.closing.1 -> closed": "button 2 s button 2 s",
        "closing barrier -> opening [is_near]": "button 2 s button barrier [is_near=True]",
        "stopped button -> before": "stop button",
    }
    assert chart_paths(Door).unreached == ()


def test_delays_are_those_of_the_class_or_as_given() -> None:
    after = "open after.open.1 -> closing"
    path = next(path for path in chart_paths(Door, delays={"dwell": 0.5}).paths if str(path) == after)
    assert path.moves[-1].seconds == 0.5
    with pytest.raises(DeclarationError, match=r"After\('dwell'\): say its seconds in delays="):
        chart_paths(Door.chart)


def test_what_cannot_be_reached_is_listed() -> None:
    chart = Chart(
        State("a", On("x", to="b"), initial=True), State("b", On("y", to="a", guard=In("a")), On("y", to="c")), End("c")
    )
    paths = chart_paths(chart)
    assert [str(path) for path in paths.paths] == ["a x -> b", "b y -> c"]
    assert paths.unreached == ("b y -> a [In('a')]",)
    assert chart_paths(chart, limit=2).unreached == ("b y -> a [In('a')]", "b y -> c")


def test_guards_in_the_activation_and_in_a_cycle_are_said() -> None:
    chart = Chart(
        State("a", Always(to="b", guard="ready"), initial=True), State("b", Always(to="a", guard="tired"), On("*"))
    )
    first, second, third = chart_paths(chart).paths
    assert (dict(first.guards), first.moves) == ({"ready": True, "tired": False}, ())
    assert [str(move) for move in second.moves] == ["cycle [tired=True, ready=False]"]
    assert [move.event for move in third.moves] == ["any"]


def test_coverage_counts_every_machine_and_names_what_is_missing() -> None:
    chart = Chart(State("a", On("x", to="b"), On("y"), initial=True), State("b"))
    with chart_coverage(chart) as coverage:
        for event in ("x", "none"):
            machine = Machine(chart, lambda *_: True)
            list(machine.start())
            list(machine.handle(MachineEvent(event)))
    list(machine.start())
    assert coverage.states == {"a": 2, "b": 1}
    assert coverage.transitions == {"a x -> b": 1, "a y -> a": 0}
    with pytest.raises(AssertionError, match="chart: 1 of 4 not reached:\n  a y -> a"):
        coverage.check()
    with chart_coverage(chart) as everything:
        machine = Machine(chart, lambda *_: True)
        list(machine.start())
        for event in ("y", "x"):
            list(machine.handle(MachineEvent(event)))
    everything.check()


@pytest.mark.slow(kept_by="test_all_transitions_of_the_door_have_a_path_of_the_fewest_moves")
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(charts())
def test_every_path_that_is_found_leads_there(states: tuple[Any, ...]) -> None:
    chart = chart_of(states)
    if chart is None:
        return
    paths = chart_paths(chart, limit=300)
    assert len(paths.paths) + len(paths.unreached) == len(chart.arcs)
    for path in paths.paths:
        with chart_coverage(chart) as coverage:
            _follow(chart, path, coverage)
        assert coverage.transitions[path.transition]


def _follow(chart: Chart, path: ChartPath, coverage: ChartCoverage) -> None:
    now_ns = 0
    answers = path.guards
    machine = Machine(chart, lambda guard, _: answers[str(guard)], now_ns=lambda: now_ns)
    _carry_out(machine, machine.start())
    for move in path.moves:
        assert not coverage.transitions[path.transition]
        answers = move.guards
        if move.event:
            _carry_out(machine, machine.handle(MachineEvent(move.event)))
        elif move.seconds:
            now_ns += round(move.seconds * 1e9)
            event = machine.due(now_ns)
            assert event is not None
            _carry_out(machine, machine.handle(event))
        else:
            _carry_out(machine, machine.look())


def _carry_out(machine: Machine, steps: Any) -> None:
    list(steps)
    while (event := machine.recalled()) is not None:
        list(machine.handle(event))


def test_parallel_regions_are_searched_together() -> None:
    left = State("left", State("l1", On("go", to="l2", guard=In("r2")), initial=True), State("l2"))
    right = State("right", State("r1", After(1.5, to="r2"), initial=True), State("r2"))
    paths = chart_paths(Chart(Parallel("all", left, right, initial=True)))
    assert {str(path): " ".join(map(str, path.moves)) for path in paths.paths} == {
        "l1 go -> l2 [In('r2')]": "1.5 s go",
        "r1 after.r1.1 -> r2": "1.5 s",
    }
