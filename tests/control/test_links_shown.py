"""Links as commands show and make them: `aiorts con --both-ends`, names of kernels as links know them."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from anyio import fail_after, sleep

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedLong
from control_parts import WAIT, commanded, with_client

pytestmark = pytest.mark.anyio


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow
async def test_the_ledger_from_end_to_end_is_asked_for_at_either_end(capsys: pytest.CaptureFixture[str]) -> None:
    station = Kernel("station", services={"links": {}, "control": {"name": "station", "mode": "on"}})
    robot = Kernel("robot", services={"control": {"name": "robot", "mode": "on"}})
    async with station, robot:
        sink, source = await station.add(Sink("sink")), await robot.add(Source("source"))
        connector = await robot.connect(source.out, "station/sink.inp")
        for value in range(3):
            source.out.write_nowait(TimedLong(0, value))
        with fail_after(5):
            assert (await sink.inp.read()).data == 0
            while connector.statistics.acknowledged < 3:
                await sleep(0.01)
        found = await with_client("robot", lambda client: client.call("part", WAIT, connectors=[connector.name]))
        assert 0 < found["connectors"][connector.name]["ledger"]["round_trip_ns"] < 5e9
        equation = "both ends: 3 written = 1 delivered + 0 dropped + 2 buffered + 0 in flight"
        for kernel, component in (("robot", "source"), ("station", "sink")):
            status, text = await commanded(capsys, "con", f"{kernel}/{component}", "--both-ends")
            assert (status, equation in text) == (0, True), text
            assert "both ends" not in (await commanded(capsys, "con", f"{kernel}/{component}"))[1]
        ports = ("robot/source.out", "station/sink.inp")
        status, text = await commanded(capsys, "con", "--both-ends", *ports)
        assert (status, equation in text) == (0, True), text
        status, text = await commanded(capsys, "disconnect", *ports)
        assert status == 0, text
        assert not robot.connectors
        status, text = await commanded(capsys, "disconnect", *ports)
        assert (status, "station/sink.inp: no connector leads there" in text) == (6, True), text


@pytest.mark.slow
async def test_top_shows_what_is_unread_at_the_readers_end_of_a_link(capsys: pytest.CaptureFixture[str]) -> None:
    async def shown() -> dict[str, Any]:
        status, text = await commanded(capsys, "top", "robot", "--once", "--json", "--interval", "0.1")
        assert status == 0, text
        (row,) = json.loads(text)["connectors"]
        return {key: row[key] for key in ("written", "buffered", "in_flight")}

    station = Kernel("station", services={"links": {}})
    async with Kernel("robot", services={"control": {"name": "robot", "mode": "on"}}) as robot:
        source = await robot.add(Source("source"))
        async with station:
            sink = await station.add(Sink("sink"))
            connector = await robot.connect(source.out, "station/sink.inp")
            for value in range(4):
                source.out.write_nowait(TimedLong(0, value))
            with fail_after(WAIT):
                assert (await sink.inp.read()).data == 0
                while connector.statistics.acknowledged < 4:
                    await sleep(0.01)
            assert await shown() == {"written": 4, "buffered": 3, "in_flight": 0}
        assert (await shown())["buffered"] is None
        text = (await commanded(capsys, "top", "robot", "--once", "--interval", "0.1"))[1]
        assert re.search(r"^source.out -> station/sink.inp +0.0 +-$", text, re.MULTILINE), text


async def test_where_the_other_kernel_is_gone_it_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel("robot", services={"control": {"name": "robot", "mode": "on"}}) as robot:
        source = await robot.add(Source("source"))
        await robot.connect(source.out, "station/sink.inp")
        status, text = await commanded(capsys, "con", "source.out", "--both-ends")
        assert (status, "both ends: not known: " in text, "there is no kernel 'station'" in text) == (0, True, True), (
            text
        )
        status, text = await commanded(capsys, "con", "source.out", "source.out", "source.out", "--both-ends")
        assert (status, "--both-ends is for listing" in text) == (2, True), text


async def test_where_the_readers_kernel_does_not_answer_delay_says_what_asks_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with Kernel("robot", services={"control": {"name": "robot", "mode": "on"}}) as robot:
        source = await robot.add(Source("source"))
        async with Kernel("station", services={"links": {}}) as station:
            sink = await station.add(Sink("sink"))
            await robot.connect(source.out, "station/sink.inp", measure=10)
            source.out.write_nowait(TimedLong(0, 1))
            with fail_after(WAIT):
                await sink.inp.read()
        status, text = await commanded(capsys, "delay", "source.out", "--count", "1", "--interval", "0.1")
        why = "at the read: not known (why: aiorts con source.out --both-ends); latency p50 "
        assert (status, text.startswith(why), "up to the link" in text) == (0, True, True), text


@pytest.mark.slow
@pytest.mark.parametrize("words", [("robot-1/source.out", "station-2/sink.inp"), ("sink.inp", "source.out")])
async def test_con_makes_a_link_between_ports_of_two_kernels(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    station = Kernel("b", services={"links": {"name": "station"}, "control": {"name": "station-2", "mode": "on"}})
    robot = Kernel("a", services={"control": {"name": "robot-1", "mode": "on"}})
    async with station, robot:
        sink, source = await station.add(Sink("sink")), await robot.add(Source("source"))
        await station.service(Links).opened()
        status, text = await commanded(capsys, "con", *words, "length=7")
        assert (status, "station/sink.inp" in text and "length 7" in text) == (0, True), text
        source.out.write_nowait(TimedLong(0, 5))
        with fail_after(5):
            assert (await sink.inp.read()).data == 5
        status, text = await commanded(capsys, "con", *words, "lenght=7", "allow_duplicate=1")
        assert (status, "did you mean 'length'" in text) == (2, True), text


async def test_the_name_that_links_use_is_shown_and_understood(capsys: pytest.CaptureFixture[str]) -> None:
    station = Kernel("b", services={"links": {"name": "station"}, "control": {"name": "station-2", "mode": "on"}})
    async with station:
        await station.add(Sink("sink"))
        await station.service(Links).opened()
        assert "station-2/  links: station\n  sink" in (await commanded(capsys, "ls"))[1]
        assert (await commanded(capsys, "ls", "station/sink")) == (0, "station-2/sink\n  in  inp  TimedLong\n")
        status, text = await commanded(capsys, "ls", "--json")
        assert (status, json.loads(text)["kernels"][0]["links"]) == (0, "station")
        async with Kernel("c", services={"control": {"name": "station", "mode": "on"}}):  # its own name comes first
            status, text = await commanded(capsys, "ls", "station/sink")
            assert (status, "nothing that runs has this name" in text) == (6, True), text
