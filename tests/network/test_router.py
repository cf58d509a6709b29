"""`aiorts router`: kernels that listen nowhere meet there, also after it was killed and started anew."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedLong

pytest.importorskip("zenoh")

from aiorts_zenoh import Network
from network.certificate_parts import folder
from network.network_parts import free_port

pytestmark = pytest.mark.slow

WAIT = 20.0


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong, length=1_000)


def start(address: str, *security: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "aiorts", "router", "--listen", address, *(security or ("--insecure-network",))]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline() == f"aiorts router: listens at {address}\n"
    return process


@pytest.mark.row(56)
@pytest.mark.parametrize("certified", [False, True])
def test_kernels_meet_in_a_router_and_again_after_it_was_killed(certified: bool, tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    folder(tmp_path, hub="router", reader="component", writer="component")
    security = ("--certs", str(tmp_path), "--name", "hub") if certified else ()
    given_too = {"certificates": tmp_path} if certified else {"insecure": True}
    router = start(address, *security)

    async def main() -> None:
        nonlocal router
        given = [{"zenoh": {"connect": address, "host": host, **given_too}} for host in ("far", "near")]
        async with Kernel("reader", services=given[0]) as reader, Kernel("writer", services=given[1]) as writer:
            await asyncio.gather(reader.service(Network).opened(), writer.service(Network).opened())
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await writer.connect(source.out, "far/reader/sink.inp", length=20_000)
            links, number, came = writer.service(Links), 0, []
            for last in (False, True):
                until = time.monotonic() + WAIT
                before = len(came)
                while len(came) < before + 100:
                    assert time.monotonic() < until
                    source.out.write_nowait(TimedLong(number, number))
                    number += 1
                    await asyncio.sleep(0.002)
                    came += [sample.tm for sample in sink.inp.drain()]
                if not last:
                    router.kill()
                    router.communicate(timeout=WAIT)
                    router = start(address, *security)
            async with asyncio.timeout(WAIT):
                while connector.statistics.in_flight:
                    await asyncio.sleep(0.01)
            came += [sample.tm for sample in sink.inp.drain()]
            ledger = await links.ledger(connector)
            assert came == sorted(set(came))
            assert ledger.unexplained == 0
            assert len(came) == ledger.delivered

    try:
        asyncio.run(main())
    finally:
        router.kill()
        router.communicate(timeout=WAIT)


def test_of_a_kernel_that_shows_its_name_nothing_is_said(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    folder(tmp_path, hub="router", robot="component")
    router = start(address, "--certs", str(tmp_path), "--name", "hub")

    async def main() -> None:
        given = {"zenoh": {"connect": address, "host": "far", "certificates": tmp_path}}
        async with Kernel("robot", services=given) as kernel:
            await kernel.service(Network).opened()
            await asyncio.sleep(7)  # a name that is not shown is said after five seconds

    try:
        asyncio.run(main())
        router.terminate()
        assert router.communicate(timeout=WAIT)[1] == ""
    finally:
        router.kill()


def test_it_ends_in_order_with_a_signal() -> None:
    router = start(f"127.0.0.1:{free_port()}")
    try:
        router.terminate()
        assert router.wait(WAIT) == 0
    finally:
        router.kill()
        router.communicate(timeout=WAIT)


def test_a_port_that_is_taken_is_an_error() -> None:
    address = f"127.0.0.1:{free_port()}"
    router = start(address)
    try:
        command = [sys.executable, "-m", "aiorts", "router", "--listen", address, "--insecure-network"]
        second = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WAIT)
        assert second.returncode == 2
        assert f"E-CONFIG: listen: {address}: Address already in use; choose another port" in second.stderr
    finally:
        router.kill()
        router.communicate(timeout=WAIT)
