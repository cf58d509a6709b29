"""A window in which a system does worse takes it all back: who had gone is there again, with all it had."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from aiorts import Component, Kernel
from aiorts.planning import wanted_of
from aiorts.system import build, load, wanted
from aiorts.testing import simulate
from planning.test_apply import check_ledgers, texts

PARTS = """
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

class Ramp(Component):
    out = OutPort(TimedLong)
    five = OutPort(TimedLong)
    number = 0
    def on_execute(self):
        self.number += 1
        self.out.write_nowait(TimedLong(data=self.number))
        if self.number <= 5:
            self.five.write_nowait(TimedLong(data=self.number))

class Meter(Component):
    inp = InPort(TimedLong)
    reads: bool = Param(True)
    def on_execute(self):
        if self.reads:
            self.inp.drain()

class Keeper(Component):
    inp = InPort(TimedLong)
    hooks = ()
    diary = []
    def on_initialize(self):
        self.note("on_initialize")
    def on_finalize(self):
        self.note("on_finalize")
    def note(self, hook):
        self.hooks += (hook,)
        self.diary.append((type(self).__name__, hook))

class Other(Keeper):
    def on_reload(self, old):
        self.taken = old

class Camera(Keeper):
    parks = False

class Exchanged(Camera):
    pass
"""
SYSTEM = """
schema = 1

[components.ramp]
type = "parts.py:Ramp"

[components.meter]
type = "parts.py:Meter"

{more}

[contexts.work]
kind = "periodic"
rate = 100.0
members = ["ramp", "meter"{members}]

[[connections]]
from = "ramp.out"
to = "meter.inp"
"""
KEEPER = """
[components.keeper]
type = "parts.py:{type}"

[[connections]]
from = "ramp.five"
to = "keeper.inp"
length = 8
"""
WORSE = ("[components.meter]", "[components.meter]\nparams.reads = false")


class Files:
    """System files that differ in the keeper's type, "" for none."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "parts.py").write_text(PARTS)

    def __call__(self, kind: str, *, worse: bool = False) -> Path:
        more = KEEPER.format(type=kind) if kind else ""
        text = SYSTEM.format(more=more, members=', "keeper"' if kind else "")
        path = self.folder / f"{kind}{worse}.toml"
        path.write_text(text.replace(*WORSE) if worse else text)
        return path


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return Files(tmp_path)


def unread(component: Component) -> list[int]:
    """What can be read; it is read."""
    return [sample.data for sample in component.inp.drain()]


@pytest.mark.slow(kept_by="test_who_is_gone_ends_when_it_is_final")
@pytest.mark.parametrize("kind", ["", "Other"], ids=["removed", "replaced"])
def test_an_attribute_and_five_unread_samples_survive_a_roll_back(kind: str, files: Files) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(files("Keeper")))
            await kernel.sleep(1.0)
            before = wanted_of(kernel)
            keeper, meter = kernel.components["keeper"], kernel.components["meter"]
            keeper.attribute = attribute = object()
            states, connectors = dict(keeper.states), dict(kernel.connectors)
            applied = await kernel.apply(wanted(load(files(kind, worse=True))), window=1.0)
            assert not applied.done
            assert applied.notes == ()
            assert "ramp.out-meter.inp" in applied.rolled_back
            assert "drop" in applied.rolled_back
            assert texts(wanted_of(kernel), before) == []
            assert kernel.components["keeper"] is keeper
            assert kernel.components["meter"] is meter
            assert keeper.attribute is attribute
            assert keeper.hooks == ("on_initialize",)
            assert dict(keeper.states) == states
            assert dict(kernel.connectors) == connectors
            assert unread(keeper) == [1, 2, 3, 4, 5]
            check_ledgers(kernel)
            await kernel.sleep(0.1)
            assert not kernel.registry.parked
            kernel.components["ramp"].number = 0
            await kernel.sleep(0.1)
            assert unread(keeper) == [1, 2, 3, 4, 5]
        assert keeper.hooks == ("on_initialize", "on_finalize")

    simulate(main())


@pytest.mark.parametrize("kind", ["", "Other"], ids=["removed", "replaced"])
def test_who_is_gone_ends_when_it_is_final(kind: str, files: Files) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(files("Keeper")))
            await kernel.sleep(1.0)
            keeper, connector = kernel.components["keeper"], kernel.connectors["ramp.five-keeper.inp"]
            applied = await kernel.apply(wanted(load(files(kind))), window=1.0)
            assert applied.done, applied.rolled_back
            assert not kernel.registry.parked
            assert keeper.hooks == ("on_initialize", "on_finalize")
            if kind:
                now = kernel.components["keeper"]
                assert now.taken is keeper
                assert unread(now) == [1, 2, 3, 4, 5]
            else:
                assert connector.closed
                assert connector.statistics.dropped == {"disconnected": 5}
            check_ledgers(kernel)

    simulate(main())


@pytest.mark.parametrize("kind", ["", "Exchanged"], ids=["removed", "replaced"])
def test_who_does_not_park_is_finalized_before_its_replacement_is_made(kind: str, files: Files) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(files("Camera")))
            await kernel.sleep(1.0)
            before, camera = wanted_of(kernel), kernel.components["keeper"]
            log = type(camera).diary
            log.clear()
            applied = await kernel.apply(wanted(load(files(kind, worse=True))), window=1.0)
            assert not applied.done
            assert applied.notes == ("keeper: was made anew: what it held in attributes is lost",)
            again = kernel.components["keeper"]
            assert again is not camera
            assert type(again) is type(camera)
            assert texts(wanted_of(kernel), before) == []
            between = [(kind, "on_initialize"), (kind, "on_finalize")] if kind else []
            assert log == [("Camera", "on_finalize"), *between, ("Camera", "on_initialize")]
            kernel.components["ramp"].number = 0
            await kernel.sleep(0.1)
            assert unread(again) == [1, 2, 3, 4, 5]
            check_ledgers(kernel)

    simulate(main())


def test_a_context_that_was_stopped_in_the_window_is_said(files: Files) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(files("Keeper")))
            await kernel.sleep(1.0)
            task = asyncio.ensure_future(kernel.apply(wanted(load(files("", worse=True))), window=1.0))
            await kernel.sleep(1.9)
            await kernel.contexts["work"].stop()
            applied = await task
            assert not applied.done
            (note,) = applied.notes
            assert "work: was stopped meanwhile; ramp, meter, keeper: cannot run there" in note
            assert not kernel.registry.parked

    simulate(main())
