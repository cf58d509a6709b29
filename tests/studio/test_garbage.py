"""A hundred clients that send garbage, flood, do not read or say nothing: one that behaves is answered all the same."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

import studio_garbage
from campaign import CAMPAIGN, time_limit
from control_parts import WAIT, entry_of, running
from studio_parts import Site, resident, serving

COUNTER = """
from aiorts import Component, OutPort

class Counter(Component):
    out = OutPort(int)
    count = 0

    def on_execute(self):
        self.count += 1
        self.out.write_nowait(self.count)
"""
CLIENTS = 100
SECONDS = 60.0 if CAMPAIGN else 5.0
MIB = 1 << 20
SYSTEM = """
schema = 1
[components.counter0]
type = "counter.py:Counter"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["counter0"]
"""


@contextmanager
def garbage(port: int) -> Iterator[None]:
    """A hundred garbage clients, in a process of their own."""
    words = [sys.executable, studio_garbage.__file__, str(port), str(CLIENTS)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            yield
        finally:
            process.kill()


@dataclass(frozen=True)
class Look:
    """What a client that asks for statistics saw of a kernel, and what the system says of its process."""

    slowest: float
    """Seconds of the slowest answer."""
    rate: float
    """Hz of its context."""
    used: float
    """Of a processor, the share that it used."""
    waited: float
    """Of the time, the share that its threads were ready and had no processor."""


def processor(pid: int) -> tuple[float, float]:
    """Seconds for which the threads of a process had a processor, and for which they waited for one."""
    found = [path.read_text().split() for path in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    return sum(int(one[0]) for one in found) / 1e9, sum(int(one[1]) for one in found) / 1e9


async def looked(client: Site, pid: int, seconds: float) -> Look:
    before, began, slowest = processor(pid), time.monotonic(), 0.0
    first = last = (await client.call("robot", "statistics")).value
    while time.monotonic() - began < seconds:
        asked = time.monotonic()
        reply = await client.call("robot", "statistics")
        assert reply.status == 200, reply
        last, slowest = reply.value, max(slowest, time.monotonic() - asked)
        await asyncio.sleep(0.05)
    took, after = time.monotonic() - began, processor(pid)
    cycles = int(last["contexts"]["loop"]["cycles"]) - int(first["contexts"]["loop"]["cycles"])
    rate = cycles / ((int(last["at_ns"]) - int(first["at_ns"])) / 1e9)
    used, waited = ((later - earlier) / took for later, earlier in zip(after, before, strict=True))
    return Look(slowest, rate, used, waited)


@pytest.mark.slow
@pytest.mark.timeout(time_limit(300))
def test_a_client_that_behaves_is_answered_beside_a_hundred_that_do_not(tmp_path: Path) -> None:
    """That a kernel beside them misses cycles for want of a processor is no load of the studio on it."""

    async def look(server: int, kernel: int) -> None:
        await client.enter()
        alone = await looked(client, kernel, SECONDS / 5)
        before = resident(server)
        with garbage(client.port):
            beside = await looked(client, kernel, SECONDS)
            grown = resident(server) - before
        print(f"alone {alone}, beside {beside}, grown by {grown / MIB:.1f} MiB")
        assert beside.slowest < (1.0 if CAMPAIGN else WAIT)
        assert grown <= 32 * MIB
        assert beside.used <= 1.5 * alone.used + 0.01
        assert beside.rate >= (98.0 * (1.0 - beside.waited) if CAMPAIGN else 10.0)  # other tests run beside

    (tmp_path / "robot.toml").write_text(SYSTEM)
    (tmp_path / "counter.py").write_text(COUNTER)
    with running("robot", str(tmp_path / "robot.toml")), serving() as (process, client):
        asyncio.run(look(process.pid, entry_of("robot").pid))
        assert process.poll() is None
