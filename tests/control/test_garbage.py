"""Clients that say nonsense, flood, stall or vanish harm nobody but themselves."""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import garbage
from aiorts import Kernel
from aiorts.sessions import Client
from campaign import CAMPAIGN, time_limit
from control_parts import WAIT, controlled, entry_of, until

SECONDS = 10.0 if CAMPAIGN else 2.0
ANSWERED = 1.0 if CAMPAIGN else 5.0
"""Seconds within which a client has its answer; more where other tests run beside."""
KINDS = [garbage.KINDS, *((kind,) for kind in (garbage.KINDS if CAMPAIGN else ("malformed", "flood")))]


def memory() -> float:
    """MiB that this process has in memory."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@contextmanager
def clients(path: str, count: int, *kinds: str) -> Iterator[None]:
    """So many garbage clients, in a process of their own."""
    words = [sys.executable, garbage.__file__, path, str(count), *kinds]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            yield
        finally:
            process.kill()


async def asked(name: str, seconds: float) -> float:
    """The longest that a client waited for an answer, of many in so many seconds; none may fail."""
    longest, end = 0.0, time.monotonic() + seconds
    while time.monotonic() < end:
        longest = max(longest, await asyncio.to_thread(ask, name))
    return longest


def ask(name: str) -> float:
    """Seconds until a short session had its answer."""
    began = time.monotonic()
    with Client.open(entry_of(name), timeout=WAIT) as client:
        assert client.call("names", WAIT)["state"] == "open"
    return time.monotonic() - began


def lost(kernel: Kernel) -> int:
    """Samples that were written and neither delivered nor are unread, of all connectors."""
    counts = [one.statistics for one in kernel.connectors.values()]
    return sum(one.written - one.delivered - one.buffered for one in counts)


@pytest.mark.slow(kept_by="sessions/test_protocol.py::test_a_wrong_frame_ends_its_own_session_with_the_reason")
@pytest.mark.fault("E21")
@pytest.mark.timeout(time_limit(300))
@pytest.mark.anyio
@pytest.mark.parametrize("kinds", KINDS, ids="-".join)
async def test_a_hundred_garbage_clients_cost_the_system_no_sample_and_others_at_most_a_second(
    kinds: tuple[str, ...],
) -> None:
    async with controlled("garbage") as kernel:
        await asked("garbage", 0.1)
        before, cycles = memory(), kernel.contexts["loop"].statistics.cycles
        with clients(entry_of("garbage").path, 100, *kinds):
            longest = await asked("garbage", SECONDS)
            grown = memory() - before
        cycles = kernel.contexts["loop"].statistics.cycles - cycles
        assert lost(kernel) == 0
    assert longest < ANSWERED
    assert grown < 32.0
    assert cycles > 25 * SECONDS  # of 100 a second


@pytest.mark.slow
@pytest.mark.fault("E21")
@pytest.mark.anyio
@pytest.mark.parametrize("seconds", [0.2, SECONDS / 4])
async def test_one_client_that_floods_is_bounded(seconds: float) -> None:
    async with controlled("flood") as kernel:
        await asked("flood", 0.1)
        before = memory()
        with clients(entry_of("flood").path, 1, "never_reads"):
            await asked("flood", seconds)
        with clients(entry_of("flood").path, 1, "flood"):
            assert await asked("flood", seconds) < ANSWERED
        assert memory() - before < 32.0
        assert lost(kernel) == 0


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E22")
@pytest.mark.anyio
@pytest.mark.parametrize("sessions", [50, 1000])
async def test_short_sessions_leave_nothing(sessions: int) -> None:
    def many(count: int) -> None:
        for _ in range(count):
            ask("short")

    async with controlled("short") as kernel:
        await asyncio.to_thread(many, sessions // 10)
        other = asyncio.create_task(asked("short", sessions / 2000))
        gc.collect()
        descriptors, before = set(os.listdir("/proc/self/fd")), memory()
        blocks = sys.getallocatedblocks()
        files = os.listdir(Path(entry_of("short").path).parent)
        await asyncio.to_thread(many, sessions)
        await other
        await asyncio.to_thread(until, lambda: len(os.listdir("/proc/self/fd")) <= len(descriptors))
        gc.collect()
        # A process that has run 10,000 tests grows by 3 MiB of itself: blocks of Python are what sessions would leave.
        assert sys.getallocatedblocks() - blocks < 200 + sessions
        assert memory() - before <= 8.0
        assert os.listdir(Path(entry_of("short").path).parent) == files
        assert lost(kernel) == 0
