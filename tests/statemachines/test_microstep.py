"""Random charts and random events: our interpreter does what a slow one written after SCXML's text does."""

from __future__ import annotations

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts.errors import DeclarationError, StateError
from aiorts.statechart import After, Always, Chart, End, History, In, On, Parallel, State
from aiorts.statemachines.interpreter import Machine, MachineEvent
from statemachines.reference import Reference

EVENTS = ("e0", "e1", "e0.a", "e0x")
GUARDS = ("g0", "g1")
EXAMPLES = 3000 if os.environ.get("AIORTS_CAMPAIGN") else 120


@st.composite
def charts(draw: st.DrawFn) -> tuple[Any, ...]:
    """The states of a chart: up to 14, nested up to four deep, with regions, histories, timers, guards, ends."""
    count = iter(range(14))
    shape: list[dict[str, Any]] = []

    def grow(depth: int, in_region: bool) -> dict[str, Any] | None:
        number = next(count, None)
        if number is None:
            return None
        node: dict[str, Any] = {"name": f"s{number}", "kind": "state", "children": [], "history": []}
        shape.append(node)
        sizes = [0, 0, 2, 3] if depth < 3 else [0]
        size = draw(st.sampled_from(sizes))
        if size:
            node["kind"] = draw(st.sampled_from(["state", "state", "parallel"]))
            for _ in range(size):
                child = grow(depth + 1, node["kind"] == "parallel")
                if child is not None:
                    node["children"].append(child)
            if not node["children"]:
                node["kind"] = "state"
            else:
                for deep in draw(st.lists(st.booleans(), max_size=1)):
                    node["history"].append((f"h{number}", deep))
        elif not in_region and draw(st.integers(0, 6)) == 0:
            node["kind"] = "final"
        return node

    tops = [top for top in (grow(0, False) for _ in range(3)) if top is not None]
    names = [n["name"] for n in shape] + [h for n in shape for h, _ in n["history"]]
    within: dict[str, set[str]] = {}

    def note(node: dict[str, Any]) -> set[str]:
        found = {h for h, _ in node["history"]}
        for child in node["children"]:
            found |= {child["name"]} | note(child)
        within[node["name"]] = found
        return found

    for top in tops:
        note(top)
    looks = [In(n["name"], active) for n in shape for active in (True, False)]
    composite = [n["name"] for n in shape if n["children"]]
    done = ["done.state", *(f"done.state.{name}" for name in composite)]

    def way(source: str) -> Any:
        to = draw(st.none() | st.sampled_from(names))
        guard = draw(
            st.none()
            | st.sampled_from(GUARDS)
            | st.sampled_from(looks)
            | st.tuples(st.sampled_from(looks), st.sampled_from(GUARDS))
        )
        action = draw(st.none() | st.just("act"))
        local = to is not None and to in within[source] and draw(st.booleans())
        kind = draw(st.integers(0, 9))
        if kind in (0, 3) and guard is not None and not isinstance(guard, In) and to is not None:
            return Always(to, guard, action, local)
        if kind in (1, 2):
            return After(draw(st.sampled_from([0.5, 1.0, 1.5])), to, guard, action, local)
        return On(draw(st.sampled_from([*EVENTS, *EVENTS, *EVENTS, "*", *done])), to, guard, action, local)

    def build(node: dict[str, Any], initial: bool) -> Any:
        if node["kind"] == "final":
            return End(node["name"], initial=initial, entry="act")
        ways = [way(node["name"]) for _ in range(draw(st.integers(0, 3)))]
        chosen = draw(st.integers(0, max(len(node["children"]) - 1, 0)))
        compound = node["kind"] == "state"
        children = [build(child, compound and n == chosen) for n, child in enumerate(node["children"])]
        histories = [History(name, None, deep) for name, deep in node["history"]]
        kind = Parallel if node["kind"] == "parallel" else State
        defer = draw(st.just(()) | st.lists(st.sampled_from(EVENTS), max_size=2))
        return kind(node["name"], *ways, *histories, *children, initial=initial, defer=defer)

    first = draw(st.integers(0, len(tops) - 1))
    return tuple(build(top, n == first) for n, top in enumerate(tops))


def log_of(steps: Any, log: list[tuple[str, str]], chart: Chart) -> None:
    for step in steps:
        if step.state:
            log.append((step.what, chart.nodes[step.state].name))  # noqa: PERF401 - what came before it raised counts


def chart_of(states: tuple[Any, ...]) -> Chart | None:
    try:
        return Chart(*states)
    except DeclarationError:
        return None  # two transitions that cannot be told apart


moves = st.one_of(
    st.sampled_from(EVENTS).map(lambda e: ("event", e)),
    st.sampled_from(GUARDS).map(lambda g: ("turn", g)),
    st.just(("cycle", None)),
    st.sampled_from([500_000_000, 700_000_000, 1_000_000_000]).map(lambda t: ("time", t)),
)


@pytest.mark.slow(kept_by="test_of_two_that_leave_the_same_states_the_one_further_inside_is_taken_wherever_it_stands")
@settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
@given(charts(), st.lists(moves, max_size=12))
@pytest.mark.row(102)
def test_every_chart_does_what_the_text_says(states: tuple[Any, ...], played: list[tuple[str, Any]]) -> None:
    chart = chart_of(states)
    if chart is None:
        return
    guards = dict.fromkeys(GUARDS, True)
    now = [0]
    reference = Reference(*states, guards=guards)
    machine = Machine(chart, lambda guard, _: guards[str(guard)], now_ns=lambda: now[0])
    log: list[tuple[str, str]] = []
    endless = False

    def run(steps: Any) -> None:
        nonlocal endless
        try:
            log_of(steps, log, chart)
            while (event := machine.recalled()) is not None:
                log_of(machine.handle(event), log, chart)
        except StateError:
            endless = True

    reference.start()
    run(machine.start())
    for what, value in (("", None), *played):
        if endless or reference.endless:
            assert endless is reference.endless
            return
        if what == "event":
            reference.handle(value)
            run(iter(()))  # what is taken by now comes first
            if not machine.ended:
                run(machine.handle(MachineEvent(value)))
        elif what == "cycle":
            if reference.running:
                reference.cycle()
                run(machine.look())
        elif what == "turn":
            guards[value] = not guards[value]
        elif what == "time":
            reference.pass_time(reference.now + value)
            until = now[0] + value
            while not machine.ended and not endless and (due := machine.next_deadline) is not None and due <= until:
                now[0] = due
                event = machine.due(due)
                assert event is not None
                run(machine.handle(event))
            now[0] = until
        if endless or reference.endless:
            continue
        assert machine.configuration == reference.names
        assert log == [entry for entry in reference.log if entry[1] != "root"]
        assert machine.ended is not reference.running
        assert machine.ended or [event.name for event in machine.deferred] == reference.deferred
        legal(chart, machine.states)


def legal(chart: Chart, states: int) -> None:
    """One state of each compound, every region of each parallel, the parents of all."""
    for node in chart.nodes:
        if not states & node.bit:
            assert not states & node.inside
        elif node.compound:
            assert sum(states >> child & 1 for child in node.children) == 1
        elif node.kind == "parallel":
            assert all(states >> child & 1 for child in node.children)


def settled(*states: Any, event: str = "go") -> tuple[str, ...]:
    machine = Machine(Chart(*states), lambda guard, _: True)
    list(machine.start())
    list(machine.handle(MachineEvent(event)))
    return machine.configuration


@pytest.mark.row(102)
def test_of_two_that_leave_the_same_states_the_one_further_inside_is_taken_wherever_it_stands() -> None:
    whole, quiet = On("go", to="away"), State("quiet")
    loud = State("loud", State("l1", On("go", to="l2"), initial=True), State("l2"))
    for regions in ((quiet, loud), (loud, quiet)):
        expected = ("all", *(("quiet", "loud", "l2") if regions[0] is quiet else ("loud", "l2", "quiet")))
        assert settled(Parallel("all", whole, *regions, initial=True), State("away")) == expected
    out = State("loud", State("l1", On("go", to="there"), initial=True), State("l2"))
    for regions in ((quiet, out), (out, quiet)):
        assert settled(Parallel("all", whole, *regions, initial=True), State("away"), State("there")) == ("there",)


@pytest.mark.row(102)
def test_of_two_on_a_level_that_leave_the_same_states_the_first_is_taken() -> None:
    left, right = State("left", On("go", to="a")), State("right", On("go", to="b"))
    for regions, end in (((left, right), "a"), ((right, left), "b")):
        assert settled(Parallel("all", *regions, initial=True), State("a"), State("b")) == (end,)


@pytest.mark.row(103)
def test_a_state_that_is_left_to_its_own_history_comes_back_as_it_was() -> None:
    machine = Machine(
        Chart(
            State(
                "p",
                On("again", to="h"),
                State("a", On("go", to="b"), initial=True),
                State("b", State("b1", On("go", to="b2"), initial=True), State("b2")),
                History("h", deep=True),
            )
        ),
        lambda guard, _: True,
    )
    list(machine.start())
    for event in ("go", "go", "again"):
        list(machine.handle(MachineEvent(event)))
    assert machine.configuration == ("p", "b", "b2")


@pytest.mark.row(103)
def test_a_transition_between_two_regions_leaves_and_enters_all_of_them() -> None:
    chart = Chart(
        Parallel(
            "all",
            State("left", State("l1", On("go", to="r2"), initial=True), State("l2")),
            State("right", State("r1", initial=True), State("r2")),
            initial=True,
        )
    )
    machine = Machine(chart, lambda guard, _: True)
    list(machine.start())
    log: list[tuple[str, str]] = []
    log_of(machine.handle(MachineEvent("go")), log, chart)
    assert [name for what, name in log if what == "exit"] == ["r1", "right", "l1", "left", "all"]
    assert [name for what, name in log if what == "entry"] == ["all", "left", "l1", "right", "r2"]


@pytest.mark.row(103)
def test_a_parallel_state_is_done_when_all_of_its_regions_are() -> None:
    machine = Machine(
        Chart(
            Parallel(
                "both",
                State("left", State("l", On("one", to="le"), initial=True), End("le")),
                State("right", State("r", On("two", to="re"), initial=True), End("re")),
                On("done.state.both", to="over"),
                initial=True,
            ),
            State("over"),
        ),
        lambda guard, _: True,
    )
    list(machine.start())
    list(machine.handle(MachineEvent("one")))
    assert machine.configuration == ("both", "left", "le", "right", "r")
    list(machine.handle(MachineEvent("two")))
    assert machine.configuration == ("over",)


@pytest.mark.row(103)
def test_any_event_means_those_from_outside_and_not_the_machines_own() -> None:
    machine = Machine(
        Chart(
            State("p", State("a", On("go", to="e"), initial=True), End("e"), On("*", to="q"), initial=True),
            State("q", On("back", to="p")),
        ),
        lambda guard, _: True,
    )
    list(machine.start())
    list(machine.handle(MachineEvent("go")))
    assert machine.configuration == ("p", "e")
    list(machine.handle(MachineEvent("done.state.p")))
    assert machine.configuration == ("q",)
