"""Random configuration against a small model: sets, switches, bad values, changes while hooks run and from hooks.

After every step the component is exactly what the model says, or exactly what it was; what the bus told, put together,
is the same; and no cycle ever saw two halves.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, Param, PeriodicContext
from aiorts.errors import AiortsError, ConfigurationError
from aiorts.events import (
    ConfigurationSetActivated,
    ConfigurationSetAdded,
    ConfigurationSetChanged,
    ConfigurationSetRemoved,
    ParameterAdded,
    ParameterChanged,
    ParameterRemoved,
    ParametersChanged,
)
from aiorts.kernel.execution.cell import cell
from aiorts.testing import simulate
from aiorts.types import TimedLong
from campaign import cases
from config_parts import hear


def small(value: int) -> None:
    if value == 7:
        raise ValueError("seven is unlucky")


class Subject(Component):
    a = Param(0, ge=0, le=9)
    b = Param(1, ge=0, le=10)
    c = Param(0, validator=small)
    configurations: ClassVar = {"one": {"a": 2, "b": 3}}

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[tuple[Any, ...]] = []
        self.taken: tuple[int, int] | None = None
        self.wishes: list[Any] = []

    def check_configuration(self, values: Mapping[str, Any]) -> Any:
        if values["a"] > values["b"]:
            raise ValueError("a is above b")
        return lambda: setattr(self, "taken", (values["a"], values["b"]))

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any]]:
        return {f"in{number}": InPort(TimedLong) for number in range(values["a"] % 4)}

    def image(self) -> tuple[Any, ...]:
        return self.a, self.b, self.c, self.taken, len(self.ports), self.configuration.active

    async def on_execute(self) -> None:
        before = self.image()
        if self.wishes:
            await self.wishes.pop()
        await asyncio.sleep(0.01)
        assert self.image() == before
        self.seen.append(before)


class Model:
    """What the configuration should be, worked out the simple way."""

    def __init__(self) -> None:
        self.sets: dict[str, dict[str, int]] = {"default": {"a": 0, "b": 1, "c": 0}, "one": {"a": 2, "b": 3}}
        self.active = "default"

    def in_force(self, sets: dict[str, dict[str, int]], name: str) -> dict[str, int]:
        return {**sets["default"], **sets[name]}

    def accepts(self, sets: dict[str, dict[str, int]]) -> bool:
        for name in sets:
            whole = self.in_force(sets, name)
            if not (0 <= whole["a"] <= 9 and 0 <= whole["b"] <= 10 and whole["a"] <= whole["b"]) or whole["c"] == 7:
                return False
        return True

    def step(self, what: str, name: str, values: dict[str, Any]) -> bool:
        """Do it, or leave everything; whether it was done."""
        sets, active = {key: dict(held) for key, held in self.sets.items()}, self.active
        takes_values = what in ("configure", "change", "add", "put")
        known = self.sets["default"].keys()
        if takes_values and any(key not in known or not isinstance(value, int) for key, value in values.items()):
            return False
        if what == "configure":
            sets[active].update(values)
        elif what == "change" and name in sets:
            sets[name].update(values)
        elif what in ("add", "put") and name != "default" and (what == "put" or name not in sets):
            sets[name] = dict(values)
        elif what == "remove" and name in sets and name not in ("default", active):
            del sets[name]
        elif what == "activate" and name in sets:
            active = name
        elif what == "add_param" and "p" not in sets["default"]:
            sets["default"]["p"] = 5
        elif what == "remove_param" and "p" in sets["default"]:
            for held in sets.values():
                held.pop("p", None)
        else:
            return False
        if not self.accepts(sets):
            return False
        self.sets, self.active = sets, active
        return True


class Reader:
    """What somebody knows who heard nothing but the bus."""

    def __init__(self, subject: Subject) -> None:
        self.sets = {name: dict(values) for name, values in subject.configuration.sets.items()}
        self.active = subject.configuration.active
        self.values = dict(subject.configuration.values)
        self.batch: dict[str, Any] = {}

    def hear(self, event: Any) -> None:
        match event:
            case ConfigurationSetAdded():
                assert event.set not in self.sets
                self.sets[event.set] = dict(event.values)
            case ConfigurationSetChanged():
                assert self.sets[event.set] == dict(event.old) != dict(event.new)
                self.sets[event.set] = dict(event.new)
            case ConfigurationSetRemoved():
                assert self.sets.pop(event.set) == dict(event.values)
            case ConfigurationSetActivated():
                assert self.active == event.old
                self.active = event.new
            case ParameterAdded():
                self.values[event.parameter] = event.value
            case ParameterRemoved():
                del self.values[event.parameter]
            case ParameterChanged():
                assert self.values[event.parameter] == event.old != event.new
                assert event.set == self.active
                self.values[event.parameter] = self.batch[event.parameter] = event.new
            case ParametersChanged():
                assert dict(event.values) == self.batch
                self.batch = {}
            case _:
                return


def wish(subject: Subject, what: str, name: str, values: dict[str, Any]) -> Any:
    configuration = subject.configuration
    if what == "configure":
        return subject.configure(**values)
    if what in ("add", "put"):
        return configuration.add(name, values, replace=what == "put")
    if what == "change":
        return configuration.change(name, values)
    if what == "add_param":
        return subject.add_param("p", Param(5))
    if what == "remove_param":
        return subject.remove_param("p")
    return configuration.activate(name) if what == "activate" else configuration.remove(name)


names = st.sampled_from(("default", "one", "two", "three"))
numbers = st.one_of(st.integers(-1, 10), st.just(7), st.just("x"), st.just(2.5))
values = st.dictionaries(st.sampled_from(("a", "b", "c", "p", "q")), numbers, max_size=3)
steps = st.lists(
    st.tuples(
        st.sampled_from(
            ("configure", "configure", "change", "add", "put", "remove", "activate", "add_param", "remove_param")
        ),
        names,
        values,
        st.sampled_from(("wait", "wait", "hook", "together")),
        st.sampled_from((0.0, 0.003, 0.02)),
    ),
    max_size=25,
)


@pytest.mark.slow(kept_by="kernel/test_configuring.py::test_sets_are_declared_added_changed_activated_and_removed")
@pytest.mark.row(72, 75, 76)
@pytest.mark.fault("B22")
@settings(max_examples=cases(5000), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(("none", "inactive", "periodic", "several", "event")), steps)
def test_a_component_is_what_the_model_says_after_any_changes(
    kind: str, steps: list[tuple[str, str, dict[str, Any], str, float]]
) -> None:
    async def main(clock: object) -> None:
        async with Kernel() as kernel:
            subject, model = await kernel.add(Subject("subject")), Model()
            contexts = {
                "none": [],
                "inactive": [PeriodicContext(20.0)],
                "periodic": [PeriodicContext(20.0)],
                "several": [PeriodicContext(20.0), PeriodicContext(13.0)],
                "event": [EventContext()],
            }[kind]
            for context in contexts:
                await kernel.start(context, subject, activate=kind != "inactive")
            reader = Reader(subject)
            heard = hear(kernel)
            running: list[Any] = []
            for what, name, values, how, pause in steps:
                if how != "together":
                    await gather(running)
                if how == "hook" and kind in ("periodic", "several") and is_right_now(subject, what, name, values):
                    subject.wishes.append(wish(subject, what, name, values))
                    count = len(subject.seen)
                    for _ in range(100):
                        await asyncio.sleep(0.01)
                        if len(subject.seen) > count and not subject.wishes and not cell(subject).changes_queued:
                            break
                    else:
                        raise AssertionError(subject.last_error)
                    await asyncio.sleep(0.02)
                    model.step(what, name, values)
                elif how == "together":
                    running.append(asyncio.create_task(expect(subject, model, what, name, values)))
                    await asyncio.sleep(0)
                    continue
                else:
                    await expect(subject, model, what, name, values)
                assert dict(subject.configuration.sets) == model.sets
                if isinstance(contexts[0] if contexts else None, EventContext):
                    contexts[0].trigger(subject)  # type: ignore[union-attr]
                await asyncio.sleep(pause)
            await gather(running)
            await asyncio.sleep(0.1)
            for event in heard:
                reader.hear(event)
            configuration = subject.configuration
            assert dict(configuration.sets) == model.sets == reader.sets
            assert configuration.active == model.active == reader.active
            whole = model.in_force(model.sets, model.active)
            assert dict(configuration.values) == whole == reader.values
            assert {key: getattr(subject, key) for key in whole} == whole
            assert hasattr(subject, "p") is ("p" in whole)
            assert subject.taken == (whole["a"], whole["b"])
            assert list(subject.ports) == [f"in{number}" for number in range(whole["a"] % 4)]
            assert subject.last_error is None
            for a, b, _, taken, ports, _ in subject.seen:
                assert a <= b
                assert (taken, ports) == ((a, b), a % 4)

    simulate(main)


def is_right_now(subject: Subject, what: str, name: str, values: dict[str, Any]) -> bool:
    """Whether the model would accept it at this moment."""
    model = Model()
    model.sets = {key: dict(held) for key, held in subject.configuration.sets.items()}
    model.active = subject.configuration.active
    return model.step(what, name, values)


async def expect(subject: Subject, model: Model, what: str, name: str, values: dict[str, Any]) -> None:
    right_when_asked = is_right_now(subject, what, name, values)
    try:
        await wish(subject, what, name, values)
    except ConfigurationError:
        # Nonsense by the state at hand is refused at once, though by its turn it might have become right.
        assert not (right_when_asked and model.step(what, name, values))
    else:
        assert model.step(what, name, values)  # in the order asked for


async def gather(running: list[Any]) -> None:
    while running:
        await running.pop(0)


def test_the_model_refuses_what_it_should() -> None:
    model = Model()
    assert not model.step("configure", "", {"a": 9})
    assert not model.step("configure", "", {"c": 7})
    assert model.step("add", "two", {"a": 1})
    assert model.step("activate", "two", {})
    assert not model.step("remove", "two", {})
    assert model.in_force(model.sets, "two") == {"a": 1, "b": 1, "c": 0}
    assert issubclass(ConfigurationError, AiortsError)
