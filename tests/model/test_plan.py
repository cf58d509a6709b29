"""The plan from one system to another, its steps held against a model that refuses what a kernel refuses."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from time import process_time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.model.wanted.entries import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)
from aiorts.model.wanted.plan import Plan, connections_by_name, plan
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.model.wanted.start_rules import StartRule
from aiorts.model.wanted.steps import (
    Activate,
    Change,
    Configure,
    Connect,
    Create,
    Disconnect,
    Move,
    Reload,
    Remove,
    Renew,
    RenewContext,
    Retime,
    StartContext,
    Step,
    StopContext,
    Supervise,
)

PORTS = {"A": {"o", "i"}, "B": {"o", "i", "x"}}


def ports_of(one: ComponentEntry) -> set[str]:
    """The ports of a component of the model: by its type and by a parameter."""
    return PORTS[one.type] | ({"m"} if "more" in one.params else set())


class Model:
    """A system that carries out steps, and refuses one that a kernel would refuse."""

    def __init__(self, wanted: Wanted) -> None:
        self.components = dict(wanted.components)
        self.connections = connections_by_name(wanted)
        self.contexts = dict(wanted.contexts)
        self.composites = dict(wanted.composites)

    def do(self, steps: Plan) -> Model:
        for step in steps.steps:
            assert step.text
            assert "\n" not in step.text
            self.step(step)
            self.check()
        return self

    def check(self) -> None:
        for one in self.connections.values():
            for path in one.ports:
                name, _, port = path.partition(".")
                assert port in ports_of(self.components[name]), f"{path} is connected and not there"
        homes = [member for one in self.composites.values() for member in one.members]
        homes += [member for one in self.contexts.values() for member in one.members]
        assert set(homes) <= {*self.components, *self.composites}
        assert len(set(homes)) == len(homes)

    def step(self, step: Step) -> None:
        match step:
            case Create(one):
                assert one.name not in {*self.components, *self.composites}
                self.components[one.name] = one
            case Remove(one):
                assert self.components.pop(one.name) == one
            case Connect(name, one):
                assert name not in self.connections
                self.connections[name] = one
            case Disconnect(name, one):
                assert self.connections.pop(name) == one
            case StartContext(one):
                assert one.name not in self.contexts
                assert one.members == ()
                self.contexts[one.name] = one
            case StopContext(one):
                assert self.contexts.pop(one.name) == one
                assert one.members == ()
            case Configure(before, after) | Reload(before, after) | Supervise(before, after):
                assert self.components[before.name] == before
                assert type(step) is Reload or before.type == after.type
                self.components[before.name] = after
            case Change(name, before, after) | Renew(name, before, after):
                assert self.connections[name] == before
                assert before.ports == after.ports
                words = {word for word in {**before.options, **after.options} if word != "name"}
                differ = {word for word in words if before.options.get(word) != after.options.get(word)}
                assert type(step) is Renew or differ <= {"push_rate", "length", "full"}
                self.connections[name] = after
            case Retime(before, after) | RenewContext(before, after):
                assert self.contexts[before.name] == before
                assert before.members == after.members
                self.contexts[before.name] = after
            case Activate(name, before, after):
                assert self.contexts[name].activate is before
                self.contexts[name] = replace(self.contexts[name], activate=after)
            case Move(before, after):
                for name, members in before.contexts.items():
                    assert self.contexts[name].members == members
                    self.contexts[name] = replace(self.contexts[name], members=after.contexts[name])
                for name, composite in before.composites.items():
                    assert self.composites.pop(name, None) == composite
                self.composites |= {name: one for name, one in after.composites.items() if one is not None}
            case _:
                raise AssertionError(f"no such step: {step}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]


@st.composite
def systems(draw: st.DrawFn) -> Wanted:
    names = draw(st.sets(st.sampled_from("abcdef"), max_size=6))
    components = {
        name: ComponentEntry(
            name,
            draw(st.sampled_from("AB")),
            draw(st.sampled_from([{}, {"gain": 1.0}, {"gain": 2.0}, {"more": True}])),
            active=draw(st.sampled_from(["", "fast"])),
            supervision=draw(st.sampled_from([None, Supervision("reset")])),
            start=draw(st.sampled_from([None, StartRule(name, wait=1.0)])),
        )
        for name in sorted(names)
    }
    paths = [f"{one.name}.{port}" for one in components.values() for port in sorted(ports_of(one))]
    options = st.sampled_from([{}, {"length": 3}, {"length": 0}, {"name": "w"}, {"stamp": "send"}, {"full": "block"}])
    ends = st.tuples(st.sampled_from(paths), st.sampled_from(paths)) if paths else st.nothing()
    connections = draw(st.lists(st.builds(ConnectionEntry, ends, options), max_size=5)) if paths else []
    left = draw(st.permutations(sorted(names)))
    composites: dict[str, CompositeEntry] = {}
    for name in draw(st.sets(st.sampled_from(["g", "h"]))):
        count = draw(st.integers(0, len(left)))
        members, left = tuple(left[:count]), [*left[count:], name]
        composites[name] = CompositeEntry(
            name, members, order=draw(st.sampled_from(["stated", "dataflow"])), named=True
        )
    contexts: dict[str, ContextEntry] = {}
    for name in draw(st.sets(st.sampled_from(["x", "y", "z"]))):
        count = draw(st.integers(0, len(left)))
        members, left = tuple(left[:count]), left[count:]
        kind, chosen = draw(st.sampled_from([("event", {}), ("periodic", {"rate": 1.0}), ("periodic", {"rate": 2.0})]))
        contexts[name] = ContextEntry(name, kind, members, draw(st.booleans()), chosen)
    return Wanted(components, tuple(connections), contexts, composites=composites)


@pytest.mark.slow(kept_by="test_each_difference_is_a_step_with_a_line")
@given(systems(), systems())
def test_the_steps_make_the_wanted_system_and_their_reverses_the_old_one(now: Wanted, wanted: Wanted) -> None:
    found = plan(now, wanted)
    model = Model(now).do(found)
    assert model == Model(wanted)
    assert model.do(found.reverse()) == Model(now)
    assert found.reverse().reverse() == found
    assert plan(wanted, wanted).empty
    assert found.empty is (Model(now) == Model(wanted))
    json.dumps(found.to_plain())


def component(name: str = "a", kind: str = "A", **params: Any) -> ComponentEntry:
    return ComponentEntry(name, kind, params)


def system(*parts: Any, **others: Any) -> Wanted:
    """A system of these entries."""

    def named(kind: type) -> Mapping[str, Any]:
        return {one.name: one for one in parts if isinstance(one, kind)}

    joined = tuple(one for one in parts if isinstance(one, ConnectionEntry))
    return Wanted(named(ComponentEntry), joined, named(ContextEntry), composites=named(CompositeEntry), **others)


A, B = component("a", "/home/x/a.py:A"), component("b", "B")
WIRE = ConnectionEntry(("a.o", "b.i"))


@pytest.mark.parametrize(
    ("now", "wanted", "texts"),
    [
        (system(A), system(A, B), ["create b (B)"]),
        (system(A), system(), ["remove a (a.py:A)"]),
        (system(A), system(component("a", "/home/y/c.py:A")), ["reload a: a.py:A -> c.py:A"]),
        (
            system(component(gain=1.0, rate=5.0)),
            system(component(gain=2.0, name_="x")),
            ["configure a: params.gain 1.0 -> 2.0, params.rate 5.0 -> default, params.name_ default -> x"],
        ),
        (
            system(A),
            system(replace(A, supervision=Supervision("reset"), start=StartRule("a", "b active"))),
            ["supervise a: supervision.restart default -> reset, start.after default -> ['b active']"],
        ),
        (system(A, B), system(A, B, WIRE), ["connect a.o -> b.i"]),
        (system(A, B, WIRE), system(A, B), ["disconnect a.o -> b.i"]),
        (
            system(A, B, WIRE),
            system(A, B, replace(WIRE, options={"length": 3, "full": "block"})),
            ["change a.o -> b.i: length default -> 3, full default -> block"],
        ),
        (
            system(A, B, WIRE),
            system(A, B, replace(WIRE, options={"subscription": "new"})),
            ["renew a.o -> b.i: subscription default -> new"],
        ),
        (
            system(A),
            system(A, ContextEntry("x", "periodic", ("a",), True, {"rate": 5.0})),
            ["start context x (periodic, 5.0 Hz)", "move x: +a"],
        ),
        (
            system(A, B, ContextEntry("x", "event", ("a", "b"))),
            system(A, B, ContextEntry("x", "event", ("b", "a"))),
            ["move x: order b, a"],
        ),
        (
            system(A, ContextEntry("x", "periodic", ("a",), True, {"rate": 5.0})),
            system(A, ContextEntry("x", "periodic", ("a",), False, {"rate": 6.0})),
            ["retime x: rate 5.0 -> 6.0", "deactivate the members of x"],
        ),
        (
            system(A, ContextEntry("x", "periodic", ("a",), True, {"rate": 5.0})),
            system(A, ContextEntry("x", "event", ("a",))),
            ["renew context x: kind periodic -> event, rate 5.0 -> default"],
        ),
        (system(A, B), system(A, B, CompositeEntry("g", ("a", "b"))), ["move +composite g (a, b)"]),
    ],
    ids=str,
)
def test_each_difference_is_a_step_with_a_line(now: Wanted, wanted: Wanted, texts: list[str]) -> None:
    assert [step.text for step in plan(now, wanted).steps] == texts


def test_a_component_that_may_get_other_ports_is_connected_after_it_has_them() -> None:
    before = system(A, B, WIRE, ConnectionEntry(("b.o", "a.i")))
    after = system(A, replace(B, type="C"), ConnectionEntry(("a.o", "b.new")), ConnectionEntry(("b.o", "a.i")))
    assert [type(step) for step in plan(before, after).steps] == [Disconnect, Reload, Connect]


def test_what_no_step_changes_is_refused_with_what_to_do() -> None:
    now = system(A, services={"watch_loop": {}, "old": {}})
    wanted = system(
        CompositeEntry("a", ()), clock=ClockEntry("simulated"), services={"watch_loop": {"limit": 9}, "new": {}}
    )
    found = plan(now, wanted)
    assert found.steps == ()
    assert [text.partition(";")[0] for text in found.refused] == [
        "the clock of a system that runs cannot be changed",
        "[watch_loop] is changed: the table of a service is read when a system starts",
        "[old] is taken away: the table of a service is read when a system starts",
        "[new] is added: the table of a service is read when a system starts",
        "a: becomes a composite of the same name",
    ]


def large(count: int, gain: float) -> Wanted:
    components = [component(f"c{number}", gain=gain + number % 3) for number in range(count)]
    wires = [
        ConnectionEntry((f"c{number}.o", f"c{(number + step) % count}.i"), {"length": 3 + number % 2}, number)
        for number in range(count)
        for step in (1, 2)
    ]
    return system(*components, *wires, ContextEntry("x", "event", tuple(one.name for one in components)))


@pytest.mark.slow(kept_by="test_each_difference_is_a_step_with_a_line")
def test_the_plan_of_a_large_system_takes_time_by_its_size() -> None:
    def taken(count: int) -> float:
        pairs = [(large(count, 1.0), large(count, 2.0)) for _ in range(3)]
        began = process_time()
        for now, wanted in pairs:
            assert len(plan(now, wanted).steps) == count
        return (process_time() - began) / len(pairs)

    small, whole = min(taken(100) for _ in range(3)), taken(1000)
    assert whole < 2.0
    assert whole <= 12 * small + 0.05
