"""Kernels and clients that are killed or stopped at any moment leave nothing, and harm nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aiorts.control import Client, entries, open_all
from aiorts.errors import AiortsError
from campaign import cases, time_limit
from control_parts import WAIT, controlled, entry_of, running, until

ROOT = Path(__file__).parents[2]
SYSTEM = str(ROOT / "examples/pid/system.toml")
CLIENT = """
import sys
from aiorts.control import Client, entries
entry = next(one for one in entries() if one.name == sys.argv[1])
print("ready", flush=True)
while True:
    with Client.open(entry) as client:
        streams = [client.stream("events"), client.stream("changes"), client.stream("log", follow=True)]
        client.call("log_level", level="debug", lasting=False)
        for _ in range(20):
            client.call("names")
            client.begin("deactivate", component="reader0")
            client.begin("activate", component="reader0")
"""


@pytest.mark.timeout(time_limit(1200))
@pytest.mark.anyio
async def test_clients_that_are_killed_at_any_moment_leave_nothing() -> None:
    chosen = random.Random(16)
    async with controlled("victim") as kernel:
        descriptors = len(os.listdir("/proc/self/fd"))
        for _ in range(cases(150)):
            with subprocess.Popen([sys.executable, "-c", CLIENT, "victim"], stdout=subprocess.PIPE) as process:
                assert process.stdout is not None
                await asyncio.to_thread(process.stdout.readline)
                await asyncio.sleep(chosen.random() * 0.1)
                process.kill()
        await asyncio.to_thread(until, lambda: len(os.listdir("/proc/self/fd")) <= descriptors)
        await asyncio.to_thread(
            until, lambda: not [one for one in asyncio.all_tasks(kernel.loop) if "control" in one.get_name()]
        )
        for one in kernel.connectors.values():
            counts = one.statistics
            assert counts.written == counts.delivered + sum(counts.dropped.values()) + counts.buffered
        with await asyncio.to_thread(Client.open, entry_of("victim")) as client:
            levels = await asyncio.to_thread(client.call, "log_levels")
        assert {one["level"] for one in levels.values()} != {"debug"}


@pytest.mark.timeout(time_limit(1200))
def test_kernels_that_are_killed_at_any_moment_leave_nothing_to_the_next_reader(runtime: str) -> None:
    chosen = random.Random(17)
    place = Path(runtime, "aiorts")
    words = [sys.executable, "-m", "aiorts", "run", "--name", "killed", SYSTEM]
    for _ in range(cases(50)):
        with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
            until(lambda: (place.is_dir() and os.listdir(place)) or process.poll() is not None, 60.0)
            time.sleep(chosen.random() * 0.02)
            process.kill()
        for entry in entries():
            with contextlib.suppress(AiortsError):
                Client.open(entry)
        assert entries() == ()
        assert os.listdir(place) == []


def test_a_process_that_is_stopped_delays_nobody_else_and_is_named() -> None:
    with running("stopped", SYSTEM) as stopped, running("alive", SYSTEM):
        stopped.send_signal(signal.SIGSTOP)
        try:
            began = time.monotonic()
            opened, silent = open_all(entries(), "names", timeout=WAIT, grace=0.25)
            took = time.monotonic() - began
        finally:
            stopped.send_signal(signal.SIGCONT)
        for client, _ in opened:
            client.close()
    assert [client.entry.name for client, _ in opened] == ["alive"]
    assert [(one.entry.name, one.why) for one in silent] == [("stopped", "no answer")]
    assert took < WAIT / 2
