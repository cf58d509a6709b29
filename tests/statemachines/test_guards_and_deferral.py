"""Guards that look at other states, and events that a state keeps for later."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts import Component, EventContext, EventPort, Kernel, OutPort, StateMachineComponent
from aiorts.errors import DeclarationError, StateError
from aiorts.statechart import After, Always, Chart, ChartWarning, End, In, On, Parallel, State
from aiorts.statemachines.interpreter import DEFERRED, Machine, MachineEvent
from aiorts.testing import simulate
from aiorts.types import TimedLong


def played(chart: Chart, *events: str, guard: bool = True) -> Machine:
    """A machine after these events."""
    machine = Machine(chart, lambda _guard, _event: guard)
    list(machine.start())
    for event in events:
        list(machine.handle(MachineEvent(event)))
        while (again := machine.recalled()) is not None:
            list(machine.handle(again))
    return machine


def regions(guard: Any) -> Chart:
    lamp = State("lamp", State("off", On("press", to="on", guard=guard), initial=True), State("on"))
    fuse = State("fuse", State("good", On("blow", to="blown"), initial=True), State("blown"))
    return Chart(Parallel("all", lamp, fuse, initial=True))


def test_a_guard_looks_at_another_region() -> None:
    assert "on" in played(regions(In("good")), "press").configuration
    assert "off" in played(regions(In("good")), "blow", "press").configuration
    assert "off" in played(regions(~In("good")), "press").configuration
    assert "on" in played(regions(~In("good")), "blow", "press").configuration


def test_several_guards_must_all_be_true() -> None:
    assert "on" in played(regions(("ready", In("good"))), "press").configuration
    assert "off" in played(regions(("ready", In("good"))), "press", guard=False).configuration
    assert "off" in played(regions(["ready", In("good")]), "blow", "press").configuration


def test_a_guard_that_looks_at_states_is_asked_before_one_that_runs_code() -> None:
    asked = []

    def says_yes(guard: Any, _event: MachineEvent | None) -> bool:
        asked.append(guard)
        return True

    machine = Machine(regions(("ready", ~In("good"))), says_yes)
    list(machine.start())
    list(machine.handle(MachineEvent("press")))
    assert asked == []


def test_what_needs_no_event_waits_for_a_state_of_another_region() -> None:
    left = State("left", State("l1", Always(to="l2", guard=In("r2")), initial=True), State("l2"))
    right = State("right", State("r1", On("go", to="r2"), initial=True), State("r2"))
    assert "l2" in played(Chart(Parallel("all", left, right, initial=True)), "go").configuration


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: In(3), r"In\(3\): expected the name of a state"),  # type: ignore[arg-type]
        (lambda: State("a", defer=3), "'a': defer = 3: expected an event's name, or a tuple of names"),  # type: ignore[arg-type]
        (lambda: State("a", On("x", guard=False), initial=True), r"guard = False: expected a method's name, .* In"),  # type: ignore[arg-type]
        (lambda: State("a", On("x", guard=(In("a"), 3)), initial=True), "guard = 3: expected"),  # type: ignore[arg-type]
    ],
)
def test_a_guard_or_event_of_a_wrong_type_is_named_with_what_is_expected(make: Any, says: str) -> None:
    with pytest.raises(DeclarationError, match=says):
        Chart(make())


def test_an_event_that_is_deferred_for_no_transition_is_a_warning() -> None:
    def make(*kept: str) -> None:
        idle = State("idle", On("job.new", to="busy"), initial=True)
        Lost = type("Lost", (StateMachineComponent,), {"chart": Chart(idle, State("busy", On("done"), defer=kept))})
        assert Lost.chart.name == "Lost"

    make("job", "job.new.first", "*")
    with pytest.warns(
        ChartWarning, match=r"Lost: 'busy' defers 'jb\.new', .* no transition; did you mean 'job\.new'\?"
    ):
        make("jb.new")


@pytest.mark.parametrize(
    ("states", "says"),
    [
        ((State("a", On("x", to="b", guard=In("c")), initial=True), State("b")), "no state 'c'"),
        (
            (State("a", On("x", to="b", guard=(In("b"), ~In("b"))), initial=True), State("b")),
            "its guards are never true together",
        ),
        ((State("a", Always(guard=In("a")), initial=True),), "needs a target, or a guard that is no state alone"),
        (
            (State("a", On("x", to="b"), On("x", to="a", guard=In("a")), initial=True), State("b")),
            "cannot be told apart",
        ),
        ((State("a", defer="x y", initial=True),), "defer: expected an event's name, got 'x y'"),
        ((State("a", defer=["x.*"], initial=True),), "write 'x'"),
        ((State("a", defer="after.a.1", initial=True),), "expected an event's name"),
    ],
)
def test_a_mistake_is_named_when_the_table_is_made(states: tuple[State, ...], says: str) -> None:
    with pytest.raises(DeclarationError, match=says):
        Chart(*states)


BUSY = Chart(
    State("busy", On("done", to="idle"), defer=("job", "note"), initial=True),
    State("idle", On("job", to="busy"), On("note", action="note")),
)


def test_a_deferred_event_comes_when_its_state_is_left_in_the_order_of_arrival() -> None:
    machine = played(BUSY, "note", "job", "note", "job")
    assert [event.name for event in machine.deferred] == ["note", "job", "note", "job"]
    assert (machine.configuration, machine.ignored) == (("busy",), 0)
    list(machine.handle(MachineEvent("done")))
    assert machine.recalled() == MachineEvent("note")
    assert machine.recalled() == MachineEvent("job")
    list(machine.handle(MachineEvent("job")))
    assert machine.recalled() is None
    assert [event.name for event in machine.deferred] == ["note", "job"]


def test_a_transition_inside_is_taken_and_one_around_is_not() -> None:
    inner = State("inner", On("a", to="other"), initial=True)
    mid = State("mid", inner, State("other"), defer=("a", "b"), initial=True)
    chart = Chart(State("outer", mid, On("b", to="away"), initial=True), State("away"))
    assert "other" in played(chart, "a").configuration
    machine = played(chart, "b")
    assert "inner" in machine.configuration
    assert [event.name for event in machine.deferred] == ["b"]


def test_a_newer_event_does_not_overtake_one_that_a_state_both_defers_and_handles() -> None:
    """The guard says no to the first one, and yes when the second one comes."""
    taken: list[int] = []

    class Gate(StateMachineComponent):
        job = EventPort(TimedLong)
        chart = Chart(State("busy", On("job", action="take", guard="open"), defer="job", initial=True))
        opened = False

        def open(self) -> bool:
            return self.opened

        def take(self, sample: TimedLong) -> None:
            taken.append(sample.data)

    class Source(Component):
        out = OutPort(TimedLong)

    async def main(_clock: Any) -> None:
        async with Kernel() as kernel:
            gate, source = await kernel.add(Gate("gate")), await kernel.add(Source("source"))
            await kernel.connect(source.out, gate.job)
            await kernel.start(EventContext(), gate, activate=True)
            source.out.write_nowait(TimedLong(0, 1))
            await kernel.sleep(0.1)
            gate.opened = True
            source.out.write_nowait(TimedLong(0, 2))
            await kernel.sleep(0.1)

    simulate(main)
    assert taken == [1, 2]


def test_another_region_takes_what_one_defers() -> None:
    one = State("one", State("waits", defer="go", initial=True))
    two = State("two", State("t1", On("go", to="t2"), initial=True), State("t2"))
    machine = played(Chart(Parallel("all", one, two, initial=True)), "go")
    assert "t2" in machine.configuration
    assert not machine.deferred


def test_a_timer_is_never_deferred() -> None:
    chart = Chart(State("a", After(1.0, to="b"), defer="*", initial=True), State("b"))
    machine = Machine(chart, lambda *_: True)
    list(machine.start())
    event = machine.due(1_000_000_000)
    assert event is not None
    list(machine.handle(event))
    assert machine.configuration == ("b",)


def test_what_is_deferred_at_the_end_counts_as_ignored() -> None:
    machine = played(BUSY, "job", "note")
    list(machine.stop())
    assert (machine.ignored, len(machine.deferred)) == (2, 0)


def test_more_than_a_machine_keeps_is_an_error_that_says_so() -> None:
    machine = played(BUSY)
    for _ in range(DEFERRED):
        list(machine.handle(MachineEvent("job")))
    with pytest.raises(StateError, match=f"job: {DEFERRED} events are deferred"):
        list(machine.handle(MachineEvent("job")))


WRITTEN = Chart(
    Parallel(
        "all",
        State("l", State("l1", On("x", to="l2", guard=(In("r1"), ~In("r2"), "ready")), initial=True), State("l2")),
        State("r", State("r1", On("x", to="r2", guard=~In("l2")), defer=("y", "z.a"), initial=True), State("r2")),
        initial=True,
    ),
    On("z", to="over", local=True),
    End("over"),
)


def test_scxml_has_guards_and_deferral_and_reads_them_back() -> None:
    text = WRITTEN.to_scxml()
    assert "cond=\"In('r1') &amp;&amp; !In('r2') &amp;&amp; ready\"" in text
    assert 'a:defer="y z.a"' in text
    assert Chart.from_scxml(text).structure == WRITTEN.structure
    assert "r1 : defer y, z.a" in WRITTEN.to_mermaid()
    assert "l1 --> l2 : x [In('r1') && !In('r2') && ready]" in WRITTEN.to_mermaid()


class Worker(StateMachineComponent):
    """Takes one job after the other, each for a second."""

    job = EventPort(TimedLong)
    chart = Chart(
        State("idle", On("job", to="works", action="begin"), initial=True),
        State("works", After(1.0, to="idle"), defer="job"),
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.begun: list[tuple[float, int]] = []

    def begin(self, job: TimedLong) -> None:
        self.begun.append((self.clock.time(), job.data))


class Source(Component):
    """Writes jobs."""

    out = OutPort(TimedLong)


def test_a_component_keeps_jobs_with_their_data_and_shows_them() -> None:
    async def main() -> tuple[list[tuple[float, int]], tuple[str, ...], int]:
        async with Kernel() as kernel:
            source, worker = await kernel.create(Source), await kernel.create(Worker)
            await kernel.connect(source.out, worker.job)
            await kernel.start(EventContext(), worker, activate=True)
            for number in range(3):
                await source.out.write(TimedLong(0, number))
            await kernel.sleep(0.5)
            kept = worker.machine.deferred
            report = kernel.profile().components["worker0"].machine
            assert report is not None
            assert report.deferred == kept
            await kernel.sleep(5.0)
            return worker.begun, kept, worker.machine.ignored

    begun, kept, ignored = simulate(main())
    assert begun == [(0.0, 0), (1.0, 1), (2.0, 2)]
    assert kept == ("job", "job")
    assert ignored == 0
