"""What the commands say of a link: its state, and of its samples what is known at this end."""

from __future__ import annotations

from pathlib import Path

import pytest
from anyio import fail_after, sleep

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.cli.commands.live.look.describing import text_of
from aiorts.model.plain import plain
from aiorts.observe import system_part
from aiorts.system import GRAPH_FORMATS, graph, parse, running_graph
from aiorts.types import TimedLong

pytestmark = pytest.mark.anyio


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


def said(kernel: Kernel, connector: str) -> list[str]:
    report = plain(system_part(kernel, [], [connector], []))
    return [line.strip() for line in text_of("connector", connector, connector, report).splitlines()]


@pytest.mark.slow
async def test_a_link_that_waits_and_one_that_is_up() -> None:
    async with Kernel("robot", services={"links": {}}) as robot:
        source = await robot.add(Source("source"))
        name = (await robot.connect(source.out, "station/sink.inp")).name
        source.out.write_nowait(TimedLong(0, 1))
        assert "link connecting: there is no kernel 'station' yet" in said(robot, name)
        assert "written 1, acknowledged 0, in flight 0, waiting 1, dropped 0" in said(robot, name)
        async with Kernel("station", services={"links": {}}) as station:
            sink = await station.add(Sink("sink"))
            with fail_after(5):
                assert (await sink.inp.read()).data == 1
                while "written 1, acknowledged 1, in flight 0, waiting 0, dropped 0" not in said(robot, name):
                    await sleep(0.01)
            assert "link up" in said(robot, name)
            (theirs,) = station.connectors
            assert "written 1, delivered 1, waiting 0, dropped 0" in said(station, theirs)


SYSTEM = """
schema = 1
[components.source]
type = "aiorts_flexi:FlexiConst"
[[connections]]
from = "source.out"
to = "my.host/station/sink.inp"
[contexts.main]
kind = "event"
members = ["source"]
"""


@pytest.mark.parametrize("language", GRAPH_FORMATS)
async def test_drawings_show_the_components_of_other_kernels(language: str) -> None:
    assert "my.host/station/sink" in graph(parse(SYSTEM, Path("robot.toml")), language)
    async with Kernel("robot", services={"links": {}}) as robot:
        source, sink = await robot.add(Source("source")), await robot.add(Sink("sink"))
        await robot.connect(source.out, "station/sink.inp")
        await robot.connect("station/source.out", sink.inp)
        drawn = running_graph(robot.profile(), language)
        assert "station/sink" in drawn
        assert "station/source" in drawn
