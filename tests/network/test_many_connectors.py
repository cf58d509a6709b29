"""Thousands of connectors between two kernels, over one session of the engine."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from aiorts import Component, Connector, Kernel, OutPort
from aiorts.links import Links
from aiorts.types import TimedLong
from aiorts_zenoh import Network
from campaign import CAMPAIGN, time_limit
from network.network_parts import free_port

PROGRAM = Path(__file__).with_name("connected_program.py")
SOURCES = 100
SINKS = 100 if CAMPAIGN else 20
COUNT = SOURCES * SINKS
SECONDS = 30.0 * COUNT / 10_000
"""In which all are to be made on a machine that does nothing else."""
SLOW = 8
"""How many times as long it may take on one that has other things to do."""


class Source(Component):
    out = OutPort(TimedLong)


class Far:
    """The process of the readers."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    async def counts(self) -> tuple[int, int]:
        """Its connectors, and the samples that it has read."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        connectors, read = (await self.line()).split()
        return int(connectors), int(read)

    async def line(self) -> str:
        assert self._process.stdout is not None
        return await asyncio.wait_for(asyncio.to_thread(self._process.stdout.readline), 60.0)

    async def until(self, wanted: tuple[int, int]) -> None:
        """Wait until it has so many."""
        until = time.monotonic() + SLOW * SECONDS
        while (found := await self.counts()) != wanted:
            assert time.monotonic() < until, (found, wanted)
            await asyncio.sleep(0.1)


def timed(what: str) -> Callable[[], float]:
    """Prints how long something took; returns what ends it."""
    began = time.monotonic()

    def over() -> float:
        took = time.monotonic() - began
        print(f"{COUNT:,} connectors: {what}: {took:.1f} s")
        return took

    return over


async def connected(kernel: Kernel, sources: list[Source]) -> list[Connector]:
    """Connectors from each source to each sink."""
    made: list[Connector] = []
    for number in range(SINKS):
        made += await asyncio.gather(*(kernel.connect(one.out, f"far/reader/s{number}.inp") for one in sources))
    until = time.monotonic() + SLOW * SECONDS
    while states := {state for state in kernel.service(Links).report().values() if state != "up"}:
        assert time.monotonic() < until, states
        await asyncio.sleep(0.05)
    return made


async def write_and_end(address: str, far: Far) -> None:
    assert await far.line() == "ready\n"
    services = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
    async with Kernel("writer", services=services) as kernel:
        await kernel.service(Network).opened()
        sources = [await kernel.add(Source(f"w{number}")) for number in range(SOURCES)]
        over = timed("made")
        made = await connected(kernel, sources)
        assert over() < SLOW * SECONDS
        assert await far.counts() == (COUNT, 0)

        over = timed("one sample over each")
        for one in sources:
            await one.out.write(TimedLong(data=1))
        await far.until((COUNT, COUNT))
        over()

        over = timed("every other one ended")
        for connector in made[::2]:
            await kernel.disconnect(connector)
        await far.until((COUNT // 2, COUNT))
        over()
        for one in sources:
            await one.out.write(TimedLong(data=2))
        await far.until((COUNT // 2, COUNT + COUNT // 2))
        over = timed("the others ended with their kernel")
    assert over() < SLOW * SECONDS


@pytest.mark.slow
@pytest.mark.fault("G08")
@pytest.mark.timeout(time_limit(1_200))
def test_thousands_are_made_carry_and_end() -> None:
    address = f"127.0.0.1:{free_port()}"
    command = [sys.executable, str(PROGRAM), address, str(SINKS)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            asyncio.run(write_and_end(address, Far(process)))
        finally:
            process.kill()
