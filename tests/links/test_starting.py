"""A link to a component that a system file makes waits until that is active: nothing is dropped as inactive."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from anyio import fail_after

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, Supervision
from aiorts.events import ComponentRemoved
from aiorts.links import Links
from aiorts.system import build, load, wait_finished
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong
from links.memory_kernels import until

pytestmark = pytest.mark.anyio
READER = """
import asyncio
from aiorts import Component, InPort
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong
from links.memory_kernels import until


class Slow(Component):
    inp = InPort(TimedLong)

    async def on_activated(self):
        self.numbers = []
        await asyncio.sleep(0.1)

    def on_execute(self):
        self.numbers += [sample.data for sample in self.inp.drain()]
"""
SYSTEM = """
schema = 1
[links]
name = "station"
[components.reader]
type = "reader.py:Slow"
[components.loose]
type = "reader.py:Slow"
[contexts.events]
kind = "event"
members = ["reader"]
"""


WRITER = """
from aiorts import Component, OutPort
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong
from links.memory_kernels import until


class Writer(Component):
    out = OutPort(TimedLong)

    def on_execute(self):
        for number in range(3):
            self.out.write_nowait(TimedLong(0, number))
        self.finish()
"""
ROBOT = """
schema = 1
[components.writer]
type = "writer.py:Writer"
[contexts.events]
kind = "periodic"
rate = 100.0
members = ["writer"]
[[connections]]
from = "writer.out"
to = "station/sink.inp"
"""


class Sink(Component):
    inp = InPort(TimedLong)


class Source(Component):
    out = OutPort(TimedLong)


async def test_samples_that_waited_for_a_system_come_when_it_runs(tmp_path: Path) -> None:
    (tmp_path / "reader.py").write_text(READER)
    (tmp_path / "station.toml").write_text(SYSTEM)
    async with Kernel("robot", services={"links": {}}) as robot:
        source = await robot.add(Source("source"))
        connector = await robot.connect(source.out, "station/reader.inp", length=8, full="block", timeout=None)
        loose = await robot.connect(source.out, "station/loose.inp", length=1_000)

        async def write() -> None:
            for number in range(300):
                await source.out.write(TimedLong(0, number))

        writing = asyncio.ensure_future(write())
        async with Kernel("s") as station:
            await build(station, load(tmp_path / "station.toml"))
            reader = station.components["reader"]
            with fail_after(10):
                await writing
                while connector.statistics.in_flight or connector.statistics.buffered or loose.statistics.in_flight:
                    await asyncio.sleep(0.01)
                while len(getattr(reader, "numbers", ())) < 300:
                    await asyncio.sleep(0.01)
            assert getattr(reader, "numbers", None) == list(range(300))
            assert set(robot.service(Links).report().values()) == {"up"}


@pytest.mark.slow(kept_by="test_samples_that_waited_for_a_system_come_when_it_runs")
@pytest.mark.parametrize("is_there", [True, False])
async def test_a_system_that_ends_waits_for_its_links_and_says_what_was_not_taken(
    tmp_path: Path, is_there: bool
) -> None:
    (tmp_path / "writer.py").write_text(WRITER)
    (tmp_path / "robot.toml").write_text(ROBOT)
    async with Kernel("station", services={"links": {}}) as station, Kernel("robot") as robot:
        if is_there:
            await station.add(Sink("sink"))
        await build(robot, load(tmp_path / "robot.toml"))
        with fail_after(10):
            unread = await wait_finished(robot)
        assert [one.name for one in unread] == ([] if is_there else ["writer.out-station/sink.inp"])
        (connector,) = robot.connectors.values()
        assert connector.statistics.acknowledged == (3 if is_there else 0)


class Fussy(Sink):
    async def on_initialize(self) -> None:
        await self.sleep(1.0)

    def on_execute(self) -> None:
        raise ValueError("always")


def test_a_component_between_two_instances_is_one_that_is_being_started() -> None:
    async def main() -> str:
        network = MemoryNetwork()
        async with Kernel("station") as station, Kernel("robot") as robot:
            for kernel in (station, robot):
                kernel.service(Links).use(network.transport(kernel.name))
                await kernel.service(Links).opened()
            sink, source = await station.add(Fussy("sink")), await robot.add(Source("source"))
            station.supervise(sink, Supervision("restart"))
            removed = asyncio.Event()
            station.bus.subscribe(ComponentRemoved, lambda _: removed.set())
            await station.start(PeriodicContext(rate=10.0), sink, activate=True)
            await removed.wait()
            assert "sink" not in station.components
            connector = await robot.connect(source.out, "station/sink.inp")
            return str(robot.service(Links).report()[connector.name])

    assert "sink is being started" in simulate(main())


def test_a_component_that_comes_is_heard_of_by_whatever_way_its_kernel_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of one host may find each other by a socket and over the network; which comes first is chance."""

    async def main() -> str:
        ways = MemoryNetwork(delay=0.1), MemoryNetwork()
        async with Kernel("station") as station, Kernel("robot") as robot:
            there, here = station.service(Links), robot.service(Links)
            for links, name in ((there, "station"), (here, "robot")):
                links.use(ways[0].transport(name))
                await links.opened()
            with there.making():
                await station.add(Sink("sink"))
            source = await robot.add(Source("source"))
            connecting = asyncio.ensure_future(robot.connect(source.out, "station/sink.inp"))
            await asyncio.sleep(0.05)  # it is asked, and not answered
            monkeypatch.setattr("aiorts.testing.memory_links._HOST", "network")
            for links, name in ((there, "station"), (here, "robot")):
                await links.reach.carry(ways[1].transport(name))
            connector = await connecting
            await until(lambda: "is being started" in here.report()[connector.name])
            there.started()
            await asyncio.sleep(5.0)
            return str(here.report()[connector.name])

    assert simulate(main()) == "up"
