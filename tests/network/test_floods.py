"""Connections that come to nothing hold up no kernel with a certificate."""

from __future__ import annotations

import asyncio
import os
import random
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.links import Links

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from campaign import CAMPAIGN, time_limit
from network.certificate_parts import folder
from network.linked_parts import Linked, ended, settings, settled
from network.network_parts import free_port

pytestmark = pytest.mark.slow

BEFORE, GARBAGE = (2_500, 10_000) if CAMPAIGN else (50, 50)
"""Connections; of those that fail the engine takes ten a second, and 2,000 wait in it."""
ROOM, GROWN = 64 << 20, 4 << 20
"""Bytes for all that wait at the same time, which the process keeps, and that it may grow by after them."""
PLACE = 4 << 10
"""Bytes that the engine keeps for each connection that waits beside the others: a bare engine, with nothing of ours, is
17.6 MiB larger after 10,000 that follow 2,500, a kernel 19.7 MiB."""
WORKED_OFF = 20.0 + 0.15 * GARBAGE
"""Seconds until the last of them is over, with a margin."""
JOINS = 2.0
"""Seconds within which a kernel with a certificate is seen."""
LISTENS = """
import asyncio, sys
from aiorts import Kernel
from aiorts_zenoh import Network

async def main(address, certificates):
    services = {"zenoh": {"listen": address, "host": "far", "certificates": certificates}}
    async with Kernel("reader", services=services) as kernel:
        await kernel.service(Network).opened()
        print("listens", flush=True)
        await asyncio.to_thread(sys.stdin.read)

asyncio.run(main(*sys.argv[1:]))
"""


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Where a kernel in a process of its own listens."""
    folder(tmp_path, reader="component", writer="component")
    with listening(tmp_path, f"127.0.0.1:{free_port()}") as where:
        yield where


@contextmanager
def listening(certificates: Path, where: str) -> Iterator[str]:
    """A kernel in a process of its own listens there, and ends in order afterwards."""
    command = [sys.executable, "-c", LISTENS, where, str(certificates)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "listens\n"
        yield where
        assert process.poll() is None, "it has ended"
        process.communicate("", timeout=20.0)
        assert process.returncode == 0
    finally:
        process.kill()
        process.wait(10.0)


async def joins(address: str, certificates: Path) -> float:
    """Seconds until a kernel with a certificate is seen there."""
    began = time.monotonic()
    near = {"zenoh": {"connect": address, "host": "near", "certificates": certificates}}
    async with Kernel("writer", services=near) as writer, asyncio.timeout(20.0):
        while not writer.service(Links).peers:
            await asyncio.sleep(0.01)
        return time.monotonic() - began


@pytest.mark.fault("E12")
@pytest.mark.parametrize(
    ("count", "sent"),
    [(900, b""), (900, b"\x16\x03\x01\x02\x00\x01"), (10, b"\x20\x00" + bytes(32))],
    ids=["idle", "half open", "senseless"],  # of those that fail the engine takes ten a second
)
def test_idle_half_open_and_senseless_connections_hold_nobody_up(
    address: str, tmp_path: Path, count: int, sent: bytes
) -> None:
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    if most != resource.RLIM_INFINITY and most < 2_000:
        pytest.skip("not run: 900 connections need as many descriptors")
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (2_000, before[1]))
    host, port = address.rpartition(":")[::2]
    try:
        with ExitStack() as open_ones:
            for _ in range(count):
                one = open_ones.enter_context(socket.create_connection((host, int(port)), 5.0))
                one.sendall(sent)
            took = asyncio.run(joins(address, tmp_path))
        assert took < JOINS
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.fault("E11")
@pytest.mark.campaign
@pytest.mark.timeout(time_limit(2_400))
def test_garbage_of_many_connections_does_no_harm_and_leaves_nothing(tmp_path: Path) -> None:
    folder(tmp_path / "certificates", a="component", b="component", writer="component")
    host, port = "127.0.0.1", free_port()
    secured = {"certificates": str(tmp_path / "certificates"), "insecure": False}
    a = Linked(settings("a", sinks={"sink": tmp_path / "sink"}, listen=f"{host}:{port}", **secured), tmp_path / "a.log")
    b = Linked(settings("b", sources=["source"], connect=f"{host}:{port}", **secured), tmp_path / "b.log")
    with ended(a, b):
        b.do("connect", source="source", to="ha/a/sink.inp", full="block", timeout=None)
        a.up(1)
        b.do("write", sources=["source"], every=0.02)
        asyncio.run(joins(f"{host}:{port}", tmp_path / "certificates"))
        process, chosen = a.process.pid, random.Random(11)
        files = descriptors(process)

        def flood(count: int) -> float:
            """Seconds until this many connections are made and over."""
            began = time.monotonic()
            for _ in range(count):
                with suppress(OSError), socket.create_connection((host, port), 20.0) as one:
                    one.sendall(chosen.randbytes(chosen.randint(1, 4_000)))
            while unaccepted(port) or descriptors(process) > files + 10:
                assert time.monotonic() < began + WORKED_OFF, (unaccepted(port), descriptors(process) - files)
                time.sleep(0.2)
            return time.monotonic() - began

        for _ in range(50):  # what the program needs itself to say how it stands is there before memory is counted
            a.do("look")
        before = resident(process)
        flood(BEFORE)  # what so many at once need stays with the process, as room for the next
        memory = resident(process)
        took = flood(GARBAGE)
        joined, grown = asyncio.run(joins(f"{host}:{port}", tmp_path / "certificates")), resident(process) - memory
        print(f"{(memory - before) >> 10} KiB for the first {BEFORE}")
        print(f"{GARBAGE} connections in {took:.0f} s: {grown >> 10} KiB more, a kernel joins in {joined:.2f} s")
        ages = a.do("look")["ages"]["sink"]  # not before: its answers grow with what has come, and so does its memory
        print(f"who was linked already: oldest sample {max(ages):.3f} s")
        assert joined < JOINS
        assert memory - before < ROOM
        assert grown < GROWN + (GARBAGE - BEFORE) * PLACE
        written, ledgers = b.do("halt")["written"], settled(b)
        assert [(one["unexplained"], one["dropped"]) for one in ledgers.values()] == [(0, {})]
        assert a.do("look")["read"] == {"sink": written["source"]}
        assert [state for one in (a, b) for _, _, state in one.do("look")["changes"] if state == "down"] == []


def unaccepted(port: int) -> int:
    """Connections that a listener has not taken yet."""
    wanted = f":{port:04X} 00000000:0000 0A"
    (line,) = [line for line in Path("/proc/net/tcp").read_text().splitlines() if wanted in line]
    return int(line.split()[4].partition(":")[2], 16)


def descriptors(process: int) -> int:
    return len(os.listdir(f"/proc/{process}/fd"))


def resident(process: int) -> int:
    """Bytes of its memory."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * resource.getpagesize()
