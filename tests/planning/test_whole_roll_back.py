"""What is taken back is as it was in every respect: objects, order, states, configuration; or it is said."""

from __future__ import annotations

from pathlib import Path
from random import Random
from typing import Any

import pytest

from aiorts import Kernel, Param
from aiorts.errors import ApplyError
from aiorts.kernel.execution.cell import cell
from aiorts.model.wanted.entries import Wanted
from aiorts.model.wanted.plan import Plan, plan
from aiorts.planning import Planning
from aiorts.supervision import Supervising
from aiorts.system import build, load, wanted
from aiorts.testing import simulate
from campaign import cases
from planning.generated import random_system
from planning.test_apply import FAILS, fail_in_step

SEEDS = range(cases(240))
PARTS = """
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

BROKEN = set()

class Ramp(Component):
    out = OutPort(TimedLong)
    last: int = Param(0)
    number = 0
    def on_execute(self):
        self.number += 1
        self.out.write_nowait(TimedLong(data=self.number))
        if self.number == self.last:
            self.finish()

class Meter(Component):
    inp = InPort(TimedLong)
    fails: bool = Param(False)
    def on_execute(self):
        self.inp.drain()
        if self.fails:
            raise ValueError("it was told to fail")

class Camera(Meter):
    def on_initialize(self):
        if self.name in BROKEN:
            raise OSError("the device is gone")

class Failing(Component):
    def on_activated(self):
        BROKEN.add("camera2")
        raise ValueError("dark")
"""


def everything(kernel: Kernel) -> dict[str, Any]:
    """What of a kernel a plan can change, with its order; objects as they are."""
    components = kernel.components.values()
    rules = kernel.service(Supervising).rules
    return {
        "components": list(kernel.components.items()),
        "connectors": list(kernel.connectors.items()),
        "services": list(kernel.service_connectors),
        "contexts": list(kernel.contexts.items()),
        "members": {name: list(one.members) for name, one in kernel.contexts.items()},
        "rates": {name: one.rate for name, one in kernel.contexts.items()},
        "states": {one.name: dict(one.states) for one in components},
        "finished": {one.name: one.has_finished for one in components},
        "ports": {one.name: dict(one.ports) for one in components},
        "at ports": {
            port.path: list(port.connectors) for one in components for port in one.ports.values() if port.connectors
        },
        "profiles": {name: one.profile for name, one in kernel.connectors.items()},
        "configurations": {one.name: cell(one).configuration for one in components},
        "placements": {one.name: cell(one).previous_placements for one in components},
        "rules": (dict(rules), set(kernel.service(Planning).exclusive), dict(kernel.registry.on_link_lost)),
        "parked": set(kernel.registry.parked),
    }


def different(before: dict[str, Any], kernel: Kernel) -> dict[str, Any]:
    """By what of a kernel is not as it was: how it was, and how it is."""
    after = everything(kernel)
    return {what: (was, after[what]) for what, was in before.items() if was != after[what]}


@pytest.mark.parametrize("does_it_first", [False, True], ids=["not done", "done"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_plan_that_fails_leaves_all_as_it_was(
    seed: int, does_it_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = Random(5000 + seed)
    one, other = random_system(random), random_system(random)
    steps = len(plan(one, other).steps)

    async def main() -> None:
        async with Kernel() as kernel:
            await kernel.apply(one)
            await kernel.sleep(0.35)
            before = everything(kernel)
            for number in {0, random.randrange(steps), steps - 1}:
                with monkeypatch.context() as patch:
                    fail_in_step(patch, number, does_it_first=does_it_first)
                    FAILS.append(True)
                    with pytest.raises(ApplyError) as refused:
                        await kernel.apply(other)
                    FAILS.clear()
                assert refused.value.not_undone == ()
                assert different(before, kernel) == {}, number
                await kernel.sleep(0.1)

    if steps:
        simulate(main())


@pytest.mark.parametrize("seed", SEEDS)
def test_a_plan_that_is_not_agreed_to_leaves_all_as_it_was(seed: int) -> None:
    random = Random(7000 + seed)
    one, other = random_system(random), random_system(random)

    async def disagree(_: Plan) -> str:
        return "no"

    async def main() -> None:
        async with Kernel() as kernel:
            await kernel.apply(one)
            await kernel.sleep(0.35)
            before = everything(kernel)
            applied = await kernel.service(Planning).apply(other, dry_run=False, window=0.0, agreed=disagree)
            assert applied.notes == ()
            assert different(before, kernel) == {}

    if plan(one, other).steps:
        simulate(main())


# -- cases that the generator does not make ----------------------------------------------------------------------------


@pytest.fixture
def systems(tmp_path: Path) -> Any:
    """Makes a system of a text in which the components are of `parts.py`."""
    (tmp_path / "parts.py").write_text(PARTS)

    def system(text: str) -> Any:
        path = tmp_path / "system.toml"
        path.write_text("schema = 1\n" + text)
        return load(path)

    return system


TWO = """
[components.ramp]
type = "parts.py:Ramp"
[components.meter]
type = "parts.py:Meter"
params.fails = false
[[connections]]
from = "ramp.out"
to = "meter.inp"
"""
APART = TWO + '[contexts.work]\nkind = "periodic"\nrate = 100.0\nmembers = ["ramp", "meter"]\n'
TOGETHER = (
    TWO
    + '[composites.both]\nmembers = ["ramp", "meter"]\n'
    + '[contexts.work]\nkind = "periodic"\nrate = 100.0\nmembers = ["both"]\n'
)


@pytest.mark.parametrize("text", [APART, TOGETHER], ids=["apart", "in a composite"])
def test_a_component_that_the_change_led_into_error_runs_again(text: str, systems: Any) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, systems(text))
            await kernel.sleep(1.0)
            before = everything(kernel)
            applied = await kernel.apply(wanted(systems(text.replace("false", "true"))), window=1.0)
            assert "meter: in error" in applied.rolled_back
            assert applied.notes == ()
            changed = different(before, kernel)
            changed.pop("configurations", None)
            assert changed == {}
            assert kernel.components["meter"].fails is False
            assert {str(one.states["work"]) for one in kernel.components.values()} == {"active"}

    simulate(main())


def test_a_component_that_was_deactivated_meanwhile_is_not_activated_and_it_is_said(systems: Any) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, systems(APART))
            await kernel.sleep(1.0)

            async def deactivate(_: Plan) -> str:
                await kernel.deactivate("ramp")
                return "no"

            target = wanted(systems(APART.replace("100.0", "50.0")))
            applied = await kernel.service(Planning).apply(target, dry_run=False, window=0.0, agreed=deactivate)
            assert applied.notes == ("ramp: was active in work, and is inactive",)

    simulate(main())


def test_a_source_that_has_finished_has_finished_afterwards(systems: Any) -> None:
    text = APART.replace('parts.py:Ramp"', 'parts.py:Ramp"\nparams.last = 5')

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, systems(text))
            await kernel.sleep(1.0)
            before = everything(kernel)
            assert before["finished"]["ramp"]

            async def disagree(_: Plan) -> str:
                return "no"

            moved = text.replace('["ramp", "meter"]', '["meter"]')
            moved += '[contexts.other]\nkind = "periodic"\nrate = 50.0\nmembers = ["ramp"]\n'
            applied = await kernel.service(Planning).apply(
                wanted(systems(moved)), dry_run=False, window=0.0, agreed=disagree
            )
            assert applied.notes == ()
            assert different(before, kernel) == {}

    simulate(main())


CAMERAS = "".join(
    f'[components.camera{number}]\ntype = "parts.py:Camera"\nexclusive = true\n'
    f'[[connections]]\nfrom = "ramp.out"\nto = "camera{number}.inp"\n'
    for number in (1, 2)
)


@pytest.mark.parametrize("group", ["", "camera"], ids=["apart", "in a composite"])
def test_one_of_two_that_cannot_be_made_again_does_not_keep_the_other_out(group: str, systems: Any) -> None:
    composite = '[composites.pair]\nmembers = ["camera1", "camera2"]\nexported = ["camera2.inp"]\n' if group else ""
    there = '"pair"' if group else '"camera1", "camera2"'
    one = (
        TWO
        + CAMERAS
        + composite
        + f'[contexts.work]\nkind = "periodic"\nrate = 100.0\nmembers = ["ramp", {there}, "meter"]\n'
    )
    two = (
        TWO
        + '[components.worse]\ntype = "parts.py:Failing"\n'
        + '[contexts.work]\nkind = "periodic"\nrate = 100.0\nmembers = ["ramp", "meter", "worse"]\n'
    )

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, systems(one))
            await kernel.sleep(1.0)
            with pytest.raises(ApplyError) as refused:
                await kernel.apply(wanted(systems(two)))
            assert "KeyError" not in str(refused.value)
            assert any("create camera2" in note and "the device is gone" in note for note in refused.value.not_undone)
            assert any(note.startswith("camera1: was made anew") for note in refused.value.not_undone)
            assert str(kernel.components["camera1"].states["work"]) == "active"
            assert [one.name for one in kernel.contexts["work"].members] == ["ramp", "camera1", "meter"]
            assert list(kernel.connectors) == ["ramp.out-meter.inp", "ramp.out-camera1.inp"]

    simulate(main())


def test_a_parameter_that_came_at_run_time_is_there_again(systems: Any) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, systems(APART))
            await kernel.sleep(0.1)
            meter: Any = kernel.components["meter"]
            await meter.add_param("extra", Param(1))
            before = everything(kernel)

            async def disagree(_: Plan) -> str:
                return "no"

            target: Wanted = wanted(systems(APART.replace("false", "true")))
            applied = await kernel.service(Planning).apply(target, dry_run=False, window=0.0, agreed=disagree)
            assert applied.notes == ()
            changed = different(before, kernel)
            assert changed == {}
            assert meter.configuration.values["extra"] == 1

    simulate(main())
