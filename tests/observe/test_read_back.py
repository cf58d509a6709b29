"""What was written of a system is read back as values of the same classes, and the same code runs on them."""

from __future__ import annotations

import inspect
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import aiorts
from aiorts import (
    Component,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    Param,
    PlainLimits,
    SimulatedClock,
    SystemProfile,
    profile_from_plain,
    profile_to_plain,
)
from aiorts.errors import LimitError, RecordError
from aiorts.events import Change, PastEvent, ProfileSnapshot
from aiorts.model import blame, profile, service_profile, timing
from aiorts.observe import change_values, profiles
from aiorts.observe.change_values import Part
from aiorts.observe.profiles import ComponentReport
from aiorts.testing import simulate
from aiorts.types import TimedDouble
from campaign import cases
from plain_parts import JSON, MSGPACK, of_class
from reference_api import report_class

KINDS = [
    *(
        kind
        for module in (blame, profile, service_profile, timing, profiles, change_values)
        for kind in vars(module).values()
        if inspect.isclass(kind) and is_dataclass(kind) and kind.__module__ == module.__name__
    ),
    *map(report_class, ("SynchronizerStatistics", "LoopStalls", "ConfigurationProfile", "ObserverStatistics")),
]
"""Every class of profiles, changes and statistics."""


class Speed(StrEnum):
    SLOW = "slow"


class Sensor(Component):
    """Measures something."""

    out = OutPort(TimedDouble)
    gain = Param(1.0, ge=0.0, le=math.inf)
    limit = Param(math.inf)
    file = Param(Path("a/b"))
    speed = Param(Speed.SLOW)
    window = Param((1.0, math.inf))
    by_name = Param({"a": 1.0})
    maybe = Param(None, type=Path | None)
    most = Param(1, le=2**63 - 1)
    configurations = {"low": {"limit": 2.0, "file": "c"}}  # noqa: RUF012


class Arm(Component):
    force = InPort(TimedDouble)

    def on_execute(self) -> None:
        raise ValueError("too hot")


def through_json(value: Any) -> Any:
    return json.loads(json.dumps(profile_to_plain(value), allow_nan=False))


@pytest.mark.slow(kept_by="test_a_profile_of_a_system_is_read_back_with_the_values_that_parameters_hold")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__qualname__)
def test_what_was_written_of_any_class_is_read_back(kind: Any) -> None:
    @settings(max_examples=cases(1_000), suppress_health_check=list(HealthCheck), deadline=None)
    @given(st.data())
    def holds(data: st.DataObject) -> None:
        value = data.draw(VALUES if kind is Change else PARTS if kind is Part else of_class(kind))
        assert profile_from_plain(kind, profile_to_plain(value)) == value
        assert profile_from_plain(kind, through_json(value)) == value

    holds()


PARTS = st.one_of(
    [
        st.builds(Part, st.just(section), st.text(max_size=3), st.none() | of_class(report))
        for section, report in change_values.SECTIONS.items()
    ]
)
VALUES = st.builds(Change, st.integers(), of_class(PastEvent), st.lists(PARTS, max_size=2).map(tuple))


def test_a_profile_of_a_system_is_read_back_with_the_values_that_parameters_hold() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("robot") as kernel:
            sensor, arm = await kernel.add(Sensor("sensor0")), await kernel.add(Arm("arm0"))
            await kernel.connect(sensor.out, arm.force, length=3, measure=5)
            loop = await kernel.start(ExternalContext(name="loop"), sensor, arm, activate=True)
            sensor.out.write_nowait(TimedDouble(0, 1.0))
            await loop.tick()
            made = kernel.profile()
            read = profile_from_plain(SystemProfile, through_json(made))
            assert read == made
            params = read.components["sensor0"].params
            assert params["limit"].value == math.inf
            assert params["file"].value == Path("a/b")
            assert params["window"].value == (1.0, math.inf)
            assert params["maybe"].value is None
            assert params["speed"].value == "slow"
            assert read.components["sensor0"].configuration.sets["low"] == {"limit": 2.0, "file": Path("c")}
            assert read.structure() == made.structure()
            for mapping in (read.components, params, params["by_name"].value, read.contexts["loop"].statistics.missed):
                assert type(mapping) is MappingProxyType

    simulate(main)


def test_changes_read_back_give_the_profile_of_every_later_moment() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("robot") as kernel:
            watch = kernel.changes()
            known: Any = None
            kinds: list[str] = []

            async def follow() -> None:
                nonlocal known
                await clock.advance(0.1)
                while watch._stale or watch._queue:
                    live = await anext(watch)
                    told = through_json(live)
                    kind: Any = ProfileSnapshot if told["kind"] == "ProfileSnapshot" else Change
                    read = profile_from_plain(kind, told)
                    assert through_json(read) == told
                    known = read.apply(known)
                    kinds.append(told["kind"])
                assert known.structure() == kernel.profile().structure()

            await follow()
            sensor, arm = await kernel.add(Sensor("sensor0")), await kernel.add(Arm("arm0"))
            await follow()
            wire = await kernel.connect(sensor.out, arm.force)
            await follow()
            loop = await kernel.start(ExternalContext(name="loop"), sensor, arm, activate=True)
            await follow()
            await sensor.configure(limit=math.inf, file="x")
            sensor.add_port("more", OutPort(TimedDouble))
            await follow()
            sensor.out.write_nowait(TimedDouble(0, 1.0))
            await loop.tick()
            await follow()
            await kernel.disconnect(wire)
            await kernel.remove(sensor)
            await follow()
            assert {"ProfileSnapshot", "ComponentAdded", "Connected", "HookFailed", "StateChanged"} <= set(kinds)
            assert {"ParametersChanged", "PortAdded", "Disconnected", "ComponentRemoved"} <= set(kinds)

    simulate(main)


PLAIN: dict[str, Any] = {
    "name": "robot",
    "sequence": 3,
    "state": "open",
    "clock": {"kind": "SystemClock", "time_ns": 1, "monotonic_ns": 2, "uptime_ns": 3, "speed": 1.0},
    "versions": {"aiorts": "0.1.0"},
    "components": {},
    "connectors": {},
    "contexts": {},
}
ARM: dict[str, Any] = {"type": "m:Arm", "doc": "", "ports": {}, "params": {}, "configuration": {}, "states": {}}
CHANGE: dict[str, Any] = {
    "sequence": 4,
    "kind": "ComponentAdded",
    "event": {"component": "arm0"},
    "parts": [{"section": "components", "name": "arm0", "now": ARM}],
}


def test_a_change_read_back_has_its_event_by_name_and_fields() -> None:
    change = profile_from_plain(Change, CHANGE)
    assert change.event == PastEvent("ComponentAdded", {"component": "arm0"})
    after = change.apply(profile_from_plain(SystemProfile, PLAIN))
    assert after.sequence == 4
    assert after.components == {"arm0": profile_from_plain(ComponentReport, ARM)}


def test_what_a_later_version_adds_is_kept_and_what_an_earlier_one_lacks_has_its_default() -> None:
    unknown: dict[str, Any] = {}
    later = PLAIN | {"weather": "fine", "components": {"arm0": ARM | {"colour": [1]}}}
    read = profile_from_plain(SystemProfile, later, unknown=unknown)
    assert unknown == {"weather": "fine", "components.arm0.colour": [1]}
    assert read.components["arm0"].calls == {}
    assert read.schema == 1


@pytest.mark.parametrize(
    ("kind", "data", "message"),
    [
        (SystemProfile, PLAIN | {"schema": 2, "components": 5}, "schema: the profile is of a later form than this"),
        (ProfileSnapshot, {"profile": PLAIN | {"schema": 99}}, "schema: the profile is of a later form than this"),
        (SystemProfile, PLAIN | {"schema": "2"}, "schema: expected a whole number, got '2'"),
        (SystemProfile, [], "SystemProfile: expected an object"),
        (Change, [], "Change: expected an object"),
        (Change, {"kind": "ProfileSnapshot"}, "kind: expected a change, got ProfileSnapshot"),
        (ProfileSnapshot, CHANGE | {"profile": PLAIN}, "kind: expected ProfileSnapshot, got a Change"),
        (
            SystemProfile,
            PLAIN | {"components": {"arm0": ARM | {"ports": {"p": {}}}}},
            "components.arm0.ports.p.name: is",
        ),
        (Change, CHANGE | {"parts": [{"section": "clock", "name": "a", "now": None}]}, "parts[0].section: expected"),
        (
            Change,
            CHANGE | {"parts": [{"section": "contexts", "name": "a", "now": ARM}]},
            "parts[0]: contexts: expec",
        ),
        (Change, CHANGE | {"parts": [{"section": "contexts", "name": "a"}]}, "parts[0].now: is missing"),
    ],
)
def test_what_is_wrong_is_named_by_its_path(kind: Any, data: Any, message: str) -> None:
    with pytest.raises(RecordError, match=re.escape(message)):
        profile_from_plain(kind, data)


def test_limits_hold() -> None:
    with pytest.raises(LimitError, match="more than 20 values"):
        profile_from_plain(
            SystemProfile, PLAIN | {"versions": dict.fromkeys(map(str, range(30)), "")}, PlainLimits(8, 20)
        )


def parts_of(data: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in a plain form: its object or list, and the key."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield data, key
        if isinstance(value, dict | list):
            yield from parts_of(value)


@pytest.mark.slow(kept_by="test_what_is_wrong_is_named_by_its_path")
@settings(max_examples=cases(10_000), suppress_health_check=list(HealthCheck), deadline=None)
@given(st.sampled_from([SystemProfile, Change, ProfileSnapshot]), st.data(), JSON | MSGPACK)
def test_whatever_is_put_where_a_value_or_a_clean_error_comes_out(kind: Any, data: st.DataObject, part: Any) -> None:
    param = {"value": 1.0, "default": "NaN", "type": "float", "choices": [1.0]}
    profile = PLAIN | {"components": {"arm0": ARM | {"params": {"gain": param}}}}
    whole = {"sequence": 1, "kind": "ProfileSnapshot", "profile": profile}
    plain = json.loads(json.dumps({SystemProfile: profile, Change: CHANGE, ProfileSnapshot: whole}[kind]))
    holder, key = data.draw(st.sampled_from(list(parts_of(plain))))
    holder[key] = part
    try:
        read = profile_from_plain(kind, plain, unknown={})
    except (RecordError, LimitError):
        return
    assert type(read) is kind
    if kind is not SystemProfile:
        read.apply(profile_from_plain(SystemProfile, PLAIN)).structure()


@pytest.mark.slow(kept_by="first")
def test_reading_imports_no_loop_no_arrays_and_no_kernel() -> None:
    code = (
        "import sys; from aiorts import SystemProfile, profile_from_plain; from aiorts.events import Change;"
        f"profile_from_plain(SystemProfile, {PLAIN!r}); profile_from_plain(Change, {CHANGE!r});"
        "print([name for name in sys.modules if name in ('asyncio', 'numpy') or name.startswith('aiorts.kernel')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"
    assert aiorts.PlainLimits is PlainLimits
