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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pytest

from aiorts import Kernel
from aiorts.errors import AiortsError
from aiorts.sessions import Client, entries, open_all
from campaign import cases, time_limit
from control_parts import WAIT, controlled, entry_of, running, until

ROOT = Path(__file__).parents[2]
SYSTEM = str(ROOT / "examples/pid/system.toml")
_SILENT: Final[dict[str, Any]] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
CLIENT = """
import sys
from aiorts.sessions import Client, entries
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


@pytest.mark.slow(kept_by="control/test_socket.py::test_what_a_killed_kernel_left_is_removed_by_the_next_reader")
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


@pytest.mark.slow(kept_by="control/test_socket.py::test_what_a_killed_kernel_left_is_removed_by_the_next_reader")
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


TOOLS = (
    ("print", "victim/counter0.out"),
    ("inject", "victim/reader0.in", "1.5", "--rate", "300"),
    ("flexidump", "-p", "TimedDouble", "--connect", "victim/counter0.out"),
)


@pytest.mark.slow(kept_by="control/test_samples.py::test_what_a_session_injects_by_ends_with_it")
@pytest.mark.timeout(time_limit(1200))
@pytest.mark.anyio
async def test_readers_and_writers_that_are_killed_at_any_moment_leave_exact_ledgers(runtime: str) -> None:
    """Some are killed while they start; a third, at least, while they take or give samples."""
    chosen, busy = random.Random(18), 0
    async with controlled("victim", rate=500.0) as kernel:
        counter, reader = kernel.components["counter0"], kernel.components["reader0"]
        before, connectors = repr(kernel.profile().structure()), tuple(kernel.connectors)
        descriptors = len(os.listdir("/proc/self/fd"))
        for _ in range(cases(70)):
            victims = [
                subprocess.Popen([sys.executable, "-m", "aiorts", *words], **_SILENT)
                for words in chosen.sample(TOOLS, len(TOOLS))
            ]
            for victim in victims:
                if chosen.random() < 0.6:
                    await _connected(kernel, victim)
                await asyncio.sleep(chosen.random() * 0.2)
                busy += any(_is_of(one, victim.pid) for one in _tools(kernel))
                victim.kill()
                await asyncio.to_thread(victim.wait)
        async with asyncio.timeout(WAIT):
            while _tools(kernel) or len(os.listdir("/proc/self/fd")) > descriptors:
                await asyncio.sleep(0.02)
        (wire,) = kernel.connectors.values()
        counts = wire.statistics
        assert tuple(kernel.connectors) == connectors
        assert repr(kernel.profile().structure()) == before
        assert counts.balanced
        assert counts.written == counter.count
        for port in (counter.ports["out"], reader.ports["in"]):
            assert repr(port).endswith("1 connectors>")
        assert len(os.listdir(Path(runtime, "aiorts"))) == 2
    assert busy >= cases(70)
    assert os.listdir(Path(runtime, "aiorts")) == []


@pytest.mark.slow(kept_by="control/test_filters.py::test_what_does_not_run_is_absent")
@pytest.mark.timeout(time_limit(1200))
def test_a_source_that_is_killed_at_any_moment_is_told_by_its_readers(runtime: str) -> None:
    chosen = random.Random(19)
    constant = ("flexiconst", "-p", "TimedDouble", "-c", "1", "-r", "500", "--name", "src")
    for number in range(cases(30)):
        words = (("flexidump", "-p", "TimedDouble", "--connect", "src.output"), ("print", "src.output"))[number % 2]
        with subprocess.Popen([sys.executable, "-m", "aiorts", *constant], **_SILENT) as source:
            until(lambda: any(one.name == "src" for one in entries()))
            with subprocess.Popen(
                [sys.executable, "-m", "aiorts", *words], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.PIPE, text=True,
            ) as reader:  # fmt: skip
                assert reader.stdout is not None
                first = reader.stdout.readline()
                time.sleep(chosen.random() * 0.1)
                source.kill()
                rest, told = reader.communicate(timeout=WAIT)
        assert "src: has ended" in told
        assert reader.returncode == (1 if number % 2 == 0 else 0)
        assert first
        assert rest == "" or rest.endswith("\n")
        for entry in entries():
            with contextlib.suppress(AiortsError):
                Client.open(entry)
        assert os.listdir(Path(runtime, "aiorts")) == []


def _tools(kernel: Kernel) -> Sequence[Mapping[str, Any]]:
    found: Sequence[Mapping[str, Any]] = kernel.profile().services.get("tool", {}).get("connectors", ())
    return found


def _is_of(tool: Mapping[str, Any], pid: int) -> bool:
    return f"process {pid}]" in tool["client"]


async def _connected(kernel: Kernel, tool: subprocess.Popen[bytes]) -> None:
    """Wait until it takes or gives samples, or has given up, as beside much other work."""
    async with asyncio.timeout(WAIT):
        while tool.poll() is None and not any(_is_of(one, tool.pid) for one in _tools(kernel)):
            await asyncio.sleep(0.01)


def _all_stopped(pid: int) -> None:
    """Wait until each of its threads has stopped, which is some time after the signal was sent."""
    until = time.monotonic() + WAIT
    while any(one.read_text().rpartition(")")[2].split()[0] != "T" for one in Path(f"/proc/{pid}/task").glob("*/stat")):
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.slow(kept_by="control/test_socket.py::test_what_a_killed_kernel_left_is_removed_by_the_next_reader")
def test_a_process_that_is_stopped_delays_nobody_else_and_is_named() -> None:
    with running("stopped", SYSTEM) as stopped, running("alive", SYSTEM):
        stopped.send_signal(signal.SIGSTOP)
        try:
            _all_stopped(stopped.pid)
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
