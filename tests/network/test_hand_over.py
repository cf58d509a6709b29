"""What the engine's callbacks bring while the loop is busy: nothing hangs, and nothing grows beyond the bound."""

from __future__ import annotations

import asyncio
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from aiorts import run
from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.network import engine_settings
from campaign import CAMPAIGN, time_limit
from network.network_parts import free_port

CALLBACKS = 10_000_000 if CAMPAIGN else 1_000_000
BOUND = 128 << 10
"""KiB by which the process may grow: 100,000 messages with their keys, and what the engine holds."""


@pytest.mark.timeout(time_limit(3_600))
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_a_million_callbacks_beside_a_busy_loop(loop: str) -> None:
    pytest.importorskip(loop)
    handled, left_out, grown = run(lambda: _flooded(CALLBACKS), loop=loop)
    assert handled + left_out == CALLBACKS
    assert handled > 100_000
    assert grown < BOUND


async def _flooded(count: int) -> tuple[int, int, int]:
    """How many were handled, how many left out, and by how many KiB the process grew."""
    address, program = f"127.0.0.1:{free_port()}", Path(__file__).with_name("flooding_program.py")
    engine, inbox, handled = Engine(), Inbox(asyncio.get_running_loop()), 0
    last = asyncio.Event()

    def arrived(_key: str, data: bytes) -> None:
        nonlocal handled
        if data == b"last":
            last.set()
        else:
            handled += 1

    def declare() -> None:
        engine.open(engine_settings(NetworkSettings(listen=address, insecure=True)), inbox)
        engine.subscribe("flood", arrived)

    await in_thread(declare)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sender = subprocess.Popen([sys.executable, str(program), address, str(count)], stdin=subprocess.PIPE)
    try:
        until = time.monotonic() + time_limit(3_000) - 20
        while inbox.dropped < count // 2:  # the loop is blocked, and half of all comes
            assert time.monotonic() < until, f"{inbox.dropped} of {count} were left out"
            time.sleep(0.01)
        while not last.is_set():  # it is busy, and the other half comes
            assert time.monotonic() < until, f"{handled} and {inbox.dropped} of {count}"
            time.sleep(0.005)
            await asyncio.sleep(0)
    finally:
        sender.communicate(timeout=20)
        await in_thread(engine.close)
    return handled, inbox.dropped, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
