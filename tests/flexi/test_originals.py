"""What was wrong with all of the original components at once, played against each of these."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, LifecycleState, OutPort, PeriodicContext
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, record
from aiorts_flexi.mapping.filter import FlexiFilter
from aiorts_flexi.readme import COMPONENTS

READY: dict[str, dict[str, Any]] = {
    "FlexiAdd": {"port": "TimedLong:2"},
    "FlexiConst": {"outputs": ["TimedLong"], "constants": ["0"]},
    "FlexiDump": {"inputs": ["TimedLong"]},
    "FlexiDupe": {"inputs": ["TimedLong:2"]},
    "FlexiFilter": {"inputs": ["TimedLong"], "outputs": ["TimedLong"]},
    "FlexiLogger": {"inputs": ["TimedLong"]},
    "FlexiSelect": {"port": "TimedLong:2"},
}
KINDS = sorted(READY)


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is recorded goes there."""
    monkeypatch.chdir(tmp_path)


@record
class Battery:
    """A record of a user, in no module called RTC."""

    tm: int = 0
    data: float = 0.0


@dataclass(frozen=True)
class Reading:
    """A user's dataclass, without time."""

    volts: float = 0.0


@pytest.mark.parametrize("kind", KINDS)
@simulated
async def test_several_of_a_kind_in_a_process_are_created_by_name_and_differ(kind: str) -> None:
    async with Kernel() as one, Kernel() as two:
        made = [await kernel.create(kind, **READY[kind]) for kernel in (one, one, two)]
        assert len({id(component) for component in made}) == 3
        assert [component.name for component in made] == [f"{kind.lower()}0", f"{kind.lower()}1", f"{kind.lower()}0"]
        assert len({id(port) for component in made for port in component.ports.values()}) == 3 * len(made[0].ports)


@pytest.mark.parametrize("kind", KINDS)
@simulated
async def test_ports_are_made_once_however_often_a_context_starts(kind: str) -> None:
    async with Kernel() as kernel:
        component = await kernel.create(kind, **READY[kind])
        before = dict(component.ports)
        for context in (EventContext(), PeriodicContext(rate=10.0), EventContext()):
            await kernel.start(context, component, activate=True)
            await kernel.sleep(0.5)
            await kernel.stop(context)
        assert dict(component.ports) == before
        assert component.last_error is None


@pytest.mark.parametrize("kind", KINDS)
@simulated
async def test_nothing_is_printed_but_what_is_dumped(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel() as kernel:
        component = await kernel.create(kind, **READY[kind], verbosity=0)
        user = await kernel.create(Component)
        for port in component.ports.values():
            if isinstance(port, InPort):
                feed: OutPort[Any] = user.add_port(port.name, OutPort(port.type))
                await kernel.connect(feed, port)
        await kernel.start(EventContext(), component, activate=True)
        for port in user.ports.values():
            assert isinstance(port, OutPort)
            await port.write(port.type(0, 1))
        await kernel.sleep(0.5)
        assert component.state is LifecycleState.ACTIVE
    out, err = capsys.readouterr()
    assert bool(out) is (kind == "FlexiDump")
    assert err == ""


@pytest.mark.parametrize("cls", [Battery, Reading], ids=lambda cls: cls.__name__)
@simulated
async def test_types_of_any_module_can_be_used(cls: type[Any], capsys: pytest.CaptureFixture[str]) -> None:
    name = f"{cls.__module__}.{cls.__qualname__}"
    OutPort(cls)  # a dataclass is known once it is used somewhere
    async with Kernel() as kernel:
        user = await kernel.create(Component)
        feed, taker = user.add_port("feed", OutPort(cls)), user.add_port("taker", InPort(cls))
        const = await kernel.create(
            "FlexiConst", outputs=[name], constants=["{}" if cls is Reading else "0.5"], count=1
        )
        dupe = await kernel.create("FlexiDupe", inputs=[f"{name}:1"])
        add = await kernel.create("FlexiAdd", port=f"{name}:2")
        dump = await kernel.create("FlexiDump", inputs=[name], format="values")
        for one, other in (
            *((feed, dupe.ports["input0"]), (dupe.ports["output0_0"], add.ports["input0"])),
            *((add.ports["output"], taker), (add.ports["output"], dump.ports["input0"])),
            (const.ports["output"], add.ports["input1"]),
        ):
            await kernel.connect(one, other)
        await kernel.start(EventContext(), dupe, add, dump, const, activate=True)
        await kernel.sleep(0.1)
        taker.drain()
        feed.write_nowait(cls(0, 1.0) if cls is Battery else cls(1.0))
        await kernel.sleep(0.1)
        assert taker.drain() == [Battery(0, 1.5) if cls is Battery else Reading(1.0)]
    assert capsys.readouterr().out.splitlines()[-1] == ("1.5" if cls is Battery else "1.0")


@pytest.mark.parametrize("kind", ["FlexiAdd", "FlexiFilter"])
@simulated
async def test_what_comes_out_shares_no_memory_with_what_went_in(kind: str) -> None:
    params = {
        "FlexiAdd": {"port": "TimedDoubleSeq:1"},
        "FlexiFilter": {"inputs": ["TimedDoubleSeq:1"], "outputs": ["TimedDoubleSeq:1"], "map": "0:0>0:0"},
    }
    async with Kernel() as kernel:
        component = await kernel.create(kind, **params[kind])
        user = await kernel.create(Component)
        feed, taker = user.add_port("feed", OutPort(TimedDoubleSeq)), user.add_port("taker", InPort(TimedDoubleSeq))
        ins = [port for port in component.ports.values() if isinstance(port, InPort)]
        outs = [port for port in component.ports.values() if isinstance(port, OutPort)]
        await kernel.connect(feed, ins[0])
        await kernel.connect(outs[0], taker)
        await kernel.start(EventContext(), component, activate=True)
        sent = TimedDoubleSeq(1, [2.0])
        feed.write_nowait(sent)
        await kernel.sleep(0.1)
        (got,) = taker.drain()
        assert got == sent
        assert got.data.ctypes.data != sent.data.ctypes.data


@simulated
async def test_the_filter_prints_its_map_and_sends_whatever_came_before_an_error(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    async with Kernel() as kernel:
        component = await kernel.create(
            FlexiFilter, inputs=["TimedDouble"], outputs=["TimedLong"], map="0>1000>0", verbosity=1
        )
        user = await kernel.create(Component)
        feed, taker = user.add_port("feed", OutPort(TimedDouble)), user.add_port("taker", InPort(TimedLong))
        await kernel.connect(feed, component.ports["input0"])
        await kernel.connect(component.ports["output0"], taker)
        context = await kernel.start(EventContext(), component, activate=True)
        feed.write_nowait(TimedDouble(1, 1.5))
        feed.write_nowait(TimedDouble(2, 1e30))
        await kernel.sleep(0.1)
        assert taker.drain() == [TimedLong(1, 1500)]
        assert component.state is LifecycleState.ERROR
        await context.reset()
        await context.activate()
        feed.write_nowait(TimedDouble(3, 2.5))
        await kernel.sleep(0.1)
        assert taker.drain() == [TimedLong(3, 2500)]
    assert re.search(r"input0 +x 1000 +output0 +f64 -> i32", caplog.text)


def test_every_component_is_played_here() -> None:
    assert {cls.__name__ for cls in COMPONENTS} == set(READY)
