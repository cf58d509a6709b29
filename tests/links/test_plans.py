"""Plans that change the options of links."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType

import pytest
from anyio import fail_after

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.planning import Planning, wanted_of
from aiorts.types import TimedLong

pytestmark = pytest.mark.anyio


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow
async def test_a_link_is_made_anew_where_its_options_change_and_back() -> None:
    async with Kernel("station", services={"links": {}}) as station, Kernel("robot") as robot:
        source, sink = await robot.add(Source("source")), await station.add(Sink("sink"))
        with fail_after(10):
            await robot.connect(source.out, "station/sink.inp")
            before = wanted_of(robot)
            (entry,) = before.connections
            flush = replace(entry, options=MappingProxyType({"subscription": "flush"}))
            for number, wanted in enumerate((replace(before, connections=(flush,)), before)):
                applied = await robot.apply(wanted)
                assert applied.done, applied
                assert await source.out.write(TimedLong(0, number))
                assert (await sink.inp.read()).data == number
                (connector,) = robot.connectors.values()
                assert str(connector.profile.subscription) == ("new" if number else "flush")
                (there,) = wanted_of(robot).connections
                assert there.options == {**wanted.connections[0].options, "on_link_lost": "wait"}


async def test_flush_stays_flush_where_the_readers_kernel_connects() -> None:
    async with Kernel("station") as station, Kernel("robot", services={"links": {}}) as robot:
        source, sink = await robot.add(Source("source")), await station.add(Sink("sink"))
        with fail_after(10):
            await station.connect(sink.inp, "robot/source.out", subscription="flush")
            assert await source.out.write(TimedLong(0, 1))
            (connector,) = robot.connectors.values()
            assert (str(connector.profile.subscription), sink.inp.is_new) == ("flush", True)


async def test_a_component_of_a_plan_that_failed_is_connected_all_the_same() -> None:
    async with Kernel("station", services={"links": {}}) as station, Kernel("robot") as robot:
        source = await robot.add(Source("source"))
        with suppress(ZeroDivisionError), station.service(Planning).services_wait():
            sink = await station.add(Sink("sink"))
            await robot.connect(source.out, "station/sink.inp")
            source.out.write_nowait(TimedLong(0, 1))
            raise ZeroDivisionError
        with fail_after(5):
            assert (await sink.inp.read()).data == 1
