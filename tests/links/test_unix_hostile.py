"""What a process of the same user may do at a kernel's socket without harm: garbage, silence; samples too large."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np
import pytest
from anyio import fail_after, sleep

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.links.messages import packed
from aiorts.sessions import private_folder
from aiorts.types import TimedLong, TimedOctetSeq
from campaign import CAMPAIGN

pytestmark = pytest.mark.anyio
fault = pytest.mark.fault


class Source(Component):
    out = OutPort(TimedLong)
    large = OutPort(TimedOctetSeq)


class Sink(Component):
    inp = InPort(TimedLong)
    large = InPort(TimedOctetSeq)


def reachable(name: str) -> Kernel:
    return Kernel(name, services={"links": {}})


FLOOD = """
import random, resource, socket, sys
path, count, what = sys.argv[1], int(sys.argv[2]), sys.argv[3]
hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
chance, idle = random.Random(11), []
for number in range(count):
    one = socket.socket(socket.AF_UNIX)
    one.connect(path)
    if what == "idle":
        idle.append(one)
        continue
    try:
        one.send(chance.randbytes(chance.randrange(4_096)))
    except OSError:
        pass
    one.close()
print("done", flush=True)
sys.stdin.read()
"""
"""Connects so many times, and sends garbage or nothing."""


@asynccontextmanager
async def flooded(kernel: Kernel, count: int, what: str) -> AsyncIterator[None]:
    """While another process has connected so often."""
    await kernel.service(Links).opened()
    (path,) = private_folder().glob("*.link")
    command = (sys.executable, "-c", FLOOD, str(path), str(count), what)
    process = await asyncio.create_subprocess_exec(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        with fail_after(60):
            assert await process.stdout.readline() == b"done\n"
        yield
    finally:
        await process.communicate(b"")


async def link_works(kernel: Kernel, sink: Sink, name: str) -> None:
    """Another kernel connects, and a sample of it is read, within two seconds."""
    with fail_after(2):
        async with Kernel(name) as other:
            source = await other.add(Source())
            await other.connect(source.out, "station/sink.inp")
            source.out.write_nowait(TimedLong(0, 7))
            assert (await sink.inp.read()).data == 7


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0


async def has_descriptors(count: int) -> None:
    with fail_after(10):
        while descriptors() > count:
            await sleep(0.02)


@pytest.mark.slow(kept_by="first")
@fault("E11")
async def test_garbage_of_many_connections_does_no_harm_and_leaves_nothing() -> None:
    async with reachable("station") as station:
        sink = await station.add(Sink("sink"))
        before = descriptors()
        async with flooded(station, 10_000 if CAMPAIGN else 200, "garbage"):
            await link_works(station, sink, "robot")
        await has_descriptors(before + 10)


@pytest.mark.slow
@fault("E12")
async def test_many_that_never_say_who_they_are_keep_nobody_out_and_are_closed() -> None:
    async with reachable("station") as station:
        sink = await station.add(Sink("sink"))
        before = descriptors()
        async with flooded(station, 900, "idle"):
            await link_works(station, sink, "robot")
            await has_descriptors(before + 10)


@pytest.mark.slow
@fault("E12")
async def test_of_those_that_never_say_who_they_are_256_are_kept_at_the_most() -> None:
    async with reachable("station") as station:
        sink = await station.add(Sink("sink"))
        await station.service(Links).opened()
        before = descriptors()
        async with flooded(station, 600, "idle"):
            await has_descriptors(before + 256 + 10)
            await link_works(station, sink, "robot")
            await has_descriptors(before + 10)


@pytest.mark.slow
@fault("E12")
async def test_who_asks_without_end_and_takes_no_answers_is_cut_off(caplog: pytest.LogCaptureFixture) -> None:
    async with reachable("station") as station:
        links = station.service(Links)
        await links.opened()
        (path,) = private_folder().glob("*.link")
        loop = asyncio.get_running_loop()
        with socket.socket(socket.AF_UNIX) as caller:
            caller.setblocking(False)
            caller.connect(str(path))
            hello, question = packed(["host", "asker", 1]), packed(["no such question", b""])
            await loop.sock_sendall(caller, struct.pack("<IBBHI", len(hello), 1, 0, 0, 0) + hello)
            asks = (struct.pack("<IBBHI", len(question), 2, 0, 0, 7) + question) * 200_000
            with fail_after(60), pytest.raises(ConnectionError):
                await loop.sock_sendall(caller, asks)
        with fail_after(10):
            while links.peers:
                await sleep(0.01)
        assert "it asks, and takes no answers" in caplog.text


@fault("E12")
@pytest.mark.parametrize(
    "greeting", [["host", "a/b", 1], ["host", "x" * 101, 1], ["host", "", 1], ["h" * 254, "a", 1], ["a/b", "a", 1]]
)
async def test_who_has_no_name_is_not_let_in(greeting: list[object], caplog: pytest.LogCaptureFixture) -> None:
    async with reachable("station") as station:
        links = station.service(Links)
        await links.opened()
        (path,) = private_folder().glob("*.link")
        with socket.socket(socket.AF_UNIX) as caller:
            caller.setblocking(False)
            caller.connect(str(path))
            body = packed(greeting)
            caller.send(struct.pack("<IBBHI", len(body), 1, 0, 0, 0) + body)
            loop = asyncio.get_running_loop()
            with fail_after(0.8):  # before it is closed as one that says nothing
                while await loop.sock_recv(caller, 4_096):
                    pass
        assert not links.peers
        assert "ended the connection with a process: " in caplog.text
        assert "name '" in caplog.text


@fault("E10")
async def test_a_sample_that_is_too_large_is_refused_before_it_is_sent_and_the_next_one_comes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with reachable("station") as station, Kernel("robot") as robot:
        sink, source = await station.add(Sink("sink")), await robot.add(Source())
        connector = await robot.connect(source.large, "station/sink.large")
        source.large.write_nowait(TimedOctetSeq(0, np.zeros((64 << 20) + 1, "u1")))
        source.large.write_nowait(TimedOctetSeq(0, np.ones(5, "u1")))
        with fail_after(10):
            assert (await sink.large.read()).data.tolist() == [1, 1, 1, 1, 1]
            while connector.statistics.in_flight:
                await sleep(0.01)
        assert (connector.statistics.dropped["unsendable"], connector.statistics.acknowledged) == (1, 1)
        assert "robot/source0.large" in caplog.text or "source0.large" in caplog.text
