"""Connections that come to nothing hold up no kernel with a certificate."""

from __future__ import annotations

import asyncio
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.links import Links

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from network.certificate_parts import folder
from network.network_parts import free_port

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
    where = f"127.0.0.1:{free_port()}"
    command = [sys.executable, "-c", LISTENS, where, str(tmp_path)]
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
