"""A hundred clients that send garbage, flood, do not read or say nothing: one that behaves is answered all the same."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

import studio_garbage
from campaign import CAMPAIGN, time_limit
from control_parts import WAIT, running
from studio_parts import serving

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


def resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096


def cycles(statistics: Mapping[str, object]) -> int:
    return int(statistics["contexts"]["loop"]["cycles"])  # type: ignore[index]


@pytest.mark.slow
@pytest.mark.timeout(time_limit(300))
def test_a_client_that_behaves_is_answered_beside_a_hundred_that_do_not(tmp_path: Path) -> None:
    async def look(pid: int) -> None:
        await client.enter()
        for _ in range(20):
            await client.call("robot", "statistics")
        before, began = resident(pid), time.monotonic()
        first = (await client.call("robot", "statistics")).value
        with garbage(client.port):
            slowest = 0.0
            while time.monotonic() - began < SECONDS:
                asked = time.monotonic()
                reply = await client.call("robot", "statistics")
                assert reply.status == 200, reply
                slowest = max(slowest, time.monotonic() - asked)
                await asyncio.sleep(0.05)
            last = reply.value
            grown = resident(pid) - before
        rate = (cycles(last) - cycles(first)) / ((int(last["at_ns"]) - int(first["at_ns"])) / 1e9)
        print(f"slowest answer {slowest:.3f} s, grown by {grown / MIB:.1f} MiB, {rate:.1f} Hz")
        assert slowest < (1.0 if CAMPAIGN else WAIT)
        assert grown <= 32 * MIB
        assert rate >= (98.0 if CAMPAIGN else 10.0)  # other tests run beside

    (tmp_path / "robot.toml").write_text(SYSTEM)
    (tmp_path / "counter.py").write_text(COUNTER)
    with running("robot", str(tmp_path / "robot.toml")), serving() as (process, client):
        asyncio.run(look(process.pid))
        assert process.poll() is None
