"""A profile has all that a system may have: services, configuration sets, state machines, modes, composites."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any, ClassVar, Protocol

import jsonschema
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import aiorts
from aiorts import (
    AiortsError,
    Component,
    Composite,
    EventContext,
    EventPort,
    ExternalContext,
    InPort,
    Kernel,
    MultiModeComponent,
    OutPort,
    Param,
    PeriodicContext,
    Provided,
    Required,
    SimulatedClock,
    StateMachineComponent,
    ThreadContext,
    profile_from_plain,
)
from aiorts.errors import ServiceError
from aiorts.events import Change, MachineBefore, ProfileSnapshot
from aiorts.statechart import Chart, History, On, State
from aiorts.testing import simulate
from aiorts.types import TimedDouble, TimedLong

VALIDATOR = jsonschema.Draft202012Validator(aiorts.profile_schema())


class Brake(Protocol):
    """Stops an arm."""

    async def stop(self, force: float = 1.0) -> float: ...


class Disc(Component):
    """A brake that a strong arm breaks."""

    service = Provided[Brake](always=True)
    gain = Param(1.0, ge=0.0, le=50.0, unit="N", doc="how much")
    configurations: ClassVar = {"stiff": {"gain": 10.0}}

    async def stop(self, force: float = 1.0) -> float:
        if force > 50.0:
            raise ValueError("too strong")
        await self.sleep(force)
        return force


class Arm(Component):
    brake = Required[Brake](timeout=5.0)
    brakes = Required[Brake](timeout=5.0, many=True, port="all")
    into = InPort(TimedDouble)
    out = OutPort(TimedDouble)


class Door(StateMachineComponent):
    """Open, half open or closed; remembers how far it was open."""

    go = EventPort(TimedLong)
    slide = EventPort(TimedLong)
    chart = Chart(
        State("closed", On("go", to="before"), initial=True),
        State(
            "open",
            State("half", On("slide", to="full"), initial=True),
            State("full", On("slide", to="half")),
            History("before"),
            On("go", to="closed"),
        ),
    )


class Gear(MultiModeComponent):
    modes = ("manual", "automatic")


def checked(kernel: Kernel) -> Any:
    """The profile as somebody else reads it."""
    told = json.loads(kernel.profile().to_json())
    VALIDATOR.validate(told)
    return told


@pytest.mark.row(79)
def test_a_profile_tells_who_is_bound_with_whom_and_what_came_of_the_calls() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            arm, one, two = await kernel.add(Arm("arm")), await kernel.add(Disc("one")), await kernel.add(Disc("two"))
            first = await kernel.connect(arm.brake, one.service, name="first")
            await kernel.connect(arm.brakes, one.service, two.service)
            await arm.brake.proxy.stop(2.0)
            with pytest.raises(ServiceError):
                await arm.brake.proxy.stop(99.0)
            with pytest.raises(ServiceError):
                await arm.brake.proxy.stop(10.0)
            await arm.brakes.proxies[0].stop(1.0)
            waiting = asyncio.create_task(arm.brake.proxy.stop(3.0))
            await asyncio.sleep(1.0)
            told = checked(kernel)
            connector = told["service_connectors"]["first"]
            assert connector["ports"] == ["arm.brake", "one.service"]
            (binding,) = connector["bindings"]
            assert (binding["required"], binding["provided"]) == ("arm.brake", "one.service")
            assert binding["interface"] == "Brake"
            assert binding["waiting"] == 1
            counts = binding["statistics"]
            assert (counts["calls"], counts["failures"], counts["timeouts"]) == (3, 1, 1)
            assert counts["max_ns"] == 5_000_000_000
            assert len(told["service_connectors"]) == 3
            by_end = {name: component["calls"] for name, component in told["components"].items()}
            assert by_end["arm"]["brake"]["calls"] == 3
            assert by_end["arm"]["all.brakes"]["calls"] == 1
            assert by_end["one"]["service"] == by_end["one"]["service"] | {"calls": 4, "failures": 1, "timeouts": 1}
            assert by_end["two"]["service"]["calls"] == 0
            (end,) = told["components"]["arm"]["ports"]["brake"]["interfaces"]
            assert end["bound_to"] == ["one.service"]
            assert end["methods"][0]["name"] == "stop"
            # A connection that has ended took nothing with it, and what it cut short is counted at both ends.
            await kernel.disconnect(first)
            with pytest.raises(ServiceError):
                await waiting
            assert arm.brake.statistics.calls == 4
            assert one.service.statistics.calls == 5
            assert first.statistics.calls == 4
            assert "first" not in checked(kernel)["service_connectors"]

    simulate(main)


@pytest.mark.row(79)
def test_a_profile_tells_every_configuration_set() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            disc = await kernel.add(Disc("disc"))
            await disc.configuration.add("soft", {"gain": 0.5})
            await disc.configuration.activate("stiff")
            await disc.add_param("more", Param(3, ge=1, unit="s"))
            told = checked(kernel)["components"]["disc"]
            assert told["configuration"] == {
                "active": "stiff",
                "sets": {"default": {"gain": 1.0, "more": 3}, "stiff": {"gain": 10.0}, "soft": {"gain": 0.5}},
            }
            gain, more = told["params"]["gain"], told["params"]["more"]
            assert (gain["value"], gain["default"], gain["unit"], gain["doc"]) == (10.0, 1.0, "N", "how much")
            assert (gain["ge"], gain["le"], gain["declared"]) == (0.0, 50.0, True)
            assert (more["value"], more["unit"], more["ge"], more["declared"]) == (3, "s", 1, False)

    simulate(main)


@pytest.mark.row(79)
@pytest.mark.parametrize("kind", [EventContext, lambda: ThreadContext(rate=100.0)])
def test_a_profile_tells_what_a_machine_does_and_remembers_and_the_mode(kind: Any) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            door, gear = await kernel.add(Door("door")), await kernel.add(Gear("gear"))
            told = checked(kernel)["components"]
            assert told["door"]["machine"] == {
                "chart": "Door", "states": [], "history": {}, "timers": {}, "ignored": 0, "deferred": []
            }  # fmt: skip
            assert told["door"]["modes"] is told["door"]["composite"] is told["gear"]["machine"] is None
            await kernel.start(kind(), door, activate=True)
            loop = await kernel.start(ExternalContext(name="loop"), gear, activate=True)
            source = kernel_source = await kernel.add(Buttons("source"))
            await kernel.connect(source.go, door.go)
            await kernel.connect(kernel_source.slide, door.slide)
            for port in (source.go, source.slide, source.go, source.slide):
                port.write_nowait(TimedLong(0, 1))
                await kernel.sleep(0.1)
            await gear.set_mode("automatic")
            told = checked(kernel)["components"]
            assert told["door"]["machine"]["states"] == ["closed"]
            assert told["door"]["machine"]["history"] == {"before": ["full"]}
            assert told["door"]["machine"]["ignored"] == 1
            assert told["gear"]["modes"] == {
                "modes": ["manual", "automatic"],
                "mode": "automatic",
                "by_context": {loop.name: "automatic"},
                "pending": None,
            }

    simulate(main)


class Buttons(Component):
    go = OutPort(TimedLong)
    slide = OutPort(TimedLong)


@pytest.mark.row(79, 99)
def test_a_profile_tells_what_a_composite_is_made_of_and_shows() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            inner = Composite("inner", Arm("a"), Arm("b"), exported={"*.into": "{component}_into"}, groups="a|b")
            outer = Composite("outer", inner, Arm("c"), exported=["c.out"], errors="isolate")
            await kernel.add(outer)
            await kernel.start(EventContext(name="loop"), outer, activate=True)
            told = checked(kernel)["components"]
            assert told["outer"]["composite"] == {
                "members": ["inner", "c"],
                "parts": ["a", "b", "c"],
                "exported": {"out": "c.out"},
                "groups": [],
                "order": "stated",
                "errors": "isolate",
                "own_schedule": False,
            }
            assert told["inner"]["composite"]["groups"] == [["a"], ["b"]]
            assert told["inner"]["composite"]["exported"] == {"a_into": "a.into", "b_into": "b.into"}
            assert {name: port["name"] for name, port in told["inner"]["ports"].items()} == {
                "a_into": "a_into",
                "b_into": "b_into",
            }
            assert told["outer"]["states"] == told["inner"]["states"] == told["a"]["states"] == {"loop": "active"}

    simulate(main)


# -- any system, any course ----------------------------------------------------------------------------------------

KINDS: dict[str, Any] = {"disc": Disc, "arm": Arm, "door": Door, "gear": Gear}
ACTIONS = (
    *("add", "remove", "connect", "disconnect", "serve", "call", "start", "stop", "join", "leave", "activate"),
    *("deactivate", "reset", "set", "activate_set", "remove_set", "param", "unparam", "configure", "event", "mode"),
    *("compose", "enter", "quit", "export", "group", "tick"),
)
STEPS = st.lists(st.tuples(st.sampled_from(ACTIONS), st.integers(0, 7), st.integers(0, 7)), max_size=40)

COURSE: list[tuple[str, int, int]] = [
    ("serve", 1, 0),
    ("serve", 1, 1),
    ("call", 1, 1),
    ("connect", 1, 5),
    ("start", 2, 3),
    ("event", 2, 0),
    ("event", 2, 1),
    ("mode", 3, 1),
    ("mode", 7, 1),
    ("set", 0, 1),
    ("activate_set", 0, 1),
    ("configure", 0, 7),
    ("param", 0, 0),
    ("compose", 5, 7),
    ("compose", 0, 0),
    ("start", 9, 9),
    ("export", 8, 1),
    ("enter", 0, 4),
    ("group", 0, 0),
    ("activate", 1, 1),
    ("deactivate", 1, 1),
    ("quit", 0, 0),
    ("unparam", 0, 0),
    ("activate_set", 0, 0),
    ("remove_set", 0, 1),
    ("disconnect", 0, 0),
    ("disconnect", 0, 0),
    ("stop", 0, 0),
    *[("remove", 1, 0)] * 6,
]


class Course:
    """One change of a system after the other, those that are not possible left out."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel
        self.source = Buttons("buttons")

    def pick(self, number: int, kind: type[Any] = Component) -> Any:
        fitting = [c for c in self.kernel.components.values() if isinstance(c, kind) and c is not self.source]
        return fitting[number % len(fitting)] if fitting else None

    async def take(self, action: str, one: int, other: int) -> None:
        # What is not there now, or may not be, does not happen.
        with contextlib.suppress(AiortsError, ValueError, AttributeError, ZeroDivisionError):
            await getattr(self, action)(one, other)

    async def add(self, one: int, other: int) -> None:
        component: Any = list(KINDS.values())[one % 4](f"{list(KINDS)[one % 4]}{self.kernel.bus.sequence}")
        await self.kernel.add(component)
        if isinstance(component, Door):
            await self.kernel.connect(self.source.go, component.go)
            await self.kernel.connect(self.source.slide, component.slide)

    async def remove(self, one: int, other: int) -> None:
        await self.kernel.remove(self.pick(one))

    async def connect(self, one: int, other: int) -> None:
        await self.kernel.connect(self.pick(one, Arm).out, self.pick(other, Arm).into)

    async def disconnect(self, one: int, other: int) -> None:
        there = [*self.kernel.connectors.values(), *self.kernel.service_connectors.values()]
        await self.kernel.disconnect(there[one % len(there)])

    async def serve(self, one: int, other: int) -> None:
        arm = self.pick(one, Arm)
        await self.kernel.connect(arm.brakes if other % 2 else arm.brake, self.pick(other, Disc).service)

    async def call(self, one: int, other: int) -> None:
        await self.pick(one, Arm).brake.proxy.stop(10.0 * other)

    async def start(self, one: int, other: int) -> None:
        members = dict.fromkeys((self.pick(one), self.pick(other)))
        kinds: Any = (ExternalContext, EventContext, lambda: PeriodicContext(10.0))
        await self.kernel.start(kinds[(one + other) % 3](), *members, activate=one % 3 != 0)

    def context(self, number: int) -> Any:
        contexts = list(self.kernel.contexts.values())
        return contexts[number % len(contexts)]

    async def stop(self, one: int, other: int) -> None:
        await self.context(one).stop()

    async def join(self, one: int, other: int) -> None:
        await self.context(one).add(self.pick(other))

    async def leave(self, one: int, other: int) -> None:
        await self.context(one).remove(self.pick(other))

    async def activate(self, one: int, other: int) -> None:
        await (self.pick(one, Composite) if other % 2 else self.context(one)).activate()

    async def deactivate(self, one: int, other: int) -> None:
        await (self.pick(one, Composite) if other % 2 else self.context(one)).deactivate()

    async def reset(self, one: int, other: int) -> None:
        await self.context(one).reset()

    async def set(self, one: int, other: int) -> None:
        await self.pick(one, Disc).configuration.add(f"set{other}", {"gain": float(other)}, replace=True)

    async def activate_set(self, one: int, other: int) -> None:
        await self.pick(one, Disc).configuration.activate(
            "stiff" if other > 5 else f"set{other}" if other else "default"
        )

    async def remove_set(self, one: int, other: int) -> None:
        await self.pick(one, Disc).configuration.remove(f"set{other}")

    async def param(self, one: int, other: int) -> None:
        await self.pick(one).add_param(f"p{other}", Param(other))

    async def unparam(self, one: int, other: int) -> None:
        await self.pick(one).remove_param(f"p{other}")

    async def configure(self, one: int, other: int) -> None:
        await self.pick(one, Disc).configure(gain=float(other))

    async def event(self, one: int, other: int) -> None:
        port = self.source.slide if other % 2 else self.source.go
        port.write_nowait(TimedLong(0, one))
        await self.kernel.sleep(0.2)

    async def mode(self, one: int, other: int) -> None:
        await self.pick(one, Gear).set_mode(("manual", "automatic")[other % 2])

    async def compose(self, one: int, other: int) -> None:
        members = dict.fromkeys((self.pick(one), self.pick(other)))
        exported = {"*.out": "{component}_out"} if one % 2 else ()
        await self.kernel.add(Composite(f"comp{self.kernel.bus.sequence}", *members, exported=exported))

    async def enter(self, one: int, other: int) -> None:
        await self.pick(one, Composite).add_members(self.pick(other))

    async def quit(self, one: int, other: int) -> None:
        composite = self.pick(one, Composite)
        await composite.remove_members(composite.members[other % len(composite.members)])

    async def export(self, one: int, other: int) -> None:
        await self.pick(one, Composite).change(exported={"*.into": "{component}_in"} if other % 2 else ())

    async def group(self, one: int, other: int) -> None:
        composite = self.pick(one, Composite)
        await composite.change(
            groups="" if other % 2 else "|".join(member.name for member in composite.members),
            order="dataflow" if other > 3 else "stated",
        )

    async def tick(self, one: int, other: int) -> None:
        await self.context(one).tick()


@pytest.mark.slow(kept_by="observe/test_changes.py::test_changes_applied_to_the_snapshot_give_the_later_snapshot")
@pytest.mark.row(84)
@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@example(COURSE)
@given(STEPS)
def test_changes_applied_give_the_later_profile_of_any_system_and_the_schema_is_kept(
    steps: list[tuple[str, int, int]],
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            course = Course(kernel)
            await kernel.add(course.source)
            for number in range(8):
                await course.add(number, 0)
            watch = kernel.changes()
            known: Any = None
            read_back: Any = None
            for step in steps:
                profiling = asyncio.create_task(kernel.profile_in_turns(0.0))
                await asyncio.sleep(0)
                await course.take(*step)
                in_turns = await profiling
                while watch._stale or watch._queue:
                    change = await anext(watch)
                    plain = json.loads(json.dumps(change.to_plain(), allow_nan=False))
                    assert known is None or not isinstance(change, ProfileSnapshot)
                    known = change.apply(known)
                    read: Change | ProfileSnapshot = profile_from_plain(type(change), plain)
                    assert read.to_plain() == plain
                    read_back = read.apply(read_back)
                now = kernel.profile()
                assert known.structure() == now.structure(), step
                assert read_back.structure() == now.structure(), step
                if in_turns.sequence == now.sequence:
                    assert in_turns.structure() == now.structure(), step
            checked(kernel)

    simulate(main)


@pytest.mark.slow(kept_by="test_a_profile_tells_what_a_machine_does_and_remembers_and_the_mode")
def test_the_course_gets_everywhere() -> None:
    """The example is worth something: all of it takes place."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            course, seen = Course(kernel), dict[str, None]()
            kernel.bus.subscribe(aiorts.events.Event, lambda event: seen.setdefault(type(event).__name__))
            await kernel.add(course.source)
            for number in range(8):
                await course.add(number, 0)
            most = dict.fromkeys(("service_connectors", "connectors", "contexts"), 0)
            machine, modes, states = set(), set(), set()
            for step in COURSE:
                await course.take(*step)
                told = kernel.profile()
                checked(kernel)
                most = {name: max(number, len(getattr(told, name))) for name, number in most.items()}
                for report in told.components.values():
                    machine.update(report.machine.states if report.machine else ())
                    modes.add(report.modes.mode if report.modes else "")
                    states.update(report.states.values() if report.composite else ())
            assert set(seen) >= {
                *("CompositeChanged", "ConfigurationSetActivated", "ConfigurationSetAdded", "ConfigurationSetRemoved"),
                *("MachineChanged", "ModeChanged", "ParameterAdded", "ParameterRemoved", "PortAdded", "PortRemoved"),
            }
            assert most["service_connectors"] == 2
            assert {"closed", "open", "half"} <= machine
            assert {"manual", "automatic"} <= modes
            assert states == {"active", "inactive"}

    simulate(main)


def test_a_watch_is_not_told_of_every_action_of_a_machine() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            door, buttons = await kernel.add(Door("door")), await kernel.add(Buttons("buttons"))
            await kernel.connect(buttons.go, door.go)
            await kernel.start(EventContext(), door, activate=True)
            watch, actions = kernel.changes(), []
            kernel.bus.subscribe(MachineBefore, actions.append)
            await anext(watch)
            buttons.go.write_nowait(TimedLong(0, 1))
            await kernel.sleep(0.1)
            change: Any = await anext(watch)
            assert change.event.new == ("open", "half")
            assert not watch._queue
            assert len(actions) > 1

    simulate(main)
