"""What the engine's callbacks bring while the loop is busy: nothing hangs, and nothing grows beyond the bound."""

from __future__ import annotations

import asyncio
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from aiorts import run
from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.engine import Engine, Inbox, in_thread
from aiorts_zenoh.network import engine_settings
from campaign import CAMPAIGN, time_limit
from network.network_parts import free_port

CALLBACKS = 10_000_000 if CAMPAIGN else 240_000
BOUND = 128 << 10
"""KiB by which the process may grow: 100,000 messages with their keys, and what the engine holds."""


class Counting(Inbox):
    """Counts the callbacks."""

    callbacks = 0

    def put(self, handle: Callable[..., None], *arguments: Any, size: int = 0) -> None:
        self.callbacks += 1  # the messages of one neighbour come in one thread
        super().put(handle, *arguments, size=size)


@pytest.mark.slow(kept_by="network/test_network.py::test_what_is_beyond_the_bounds_is_left_out_and_counted")
@pytest.mark.fault("E24")
@pytest.mark.timeout(time_limit(3_600))
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_a_flood_of_callbacks_beside_a_busy_loop(loop: str) -> None:
    pytest.importorskip(loop)
    callbacks, handled, left_out, grown = run(_flooded, loop=loop)
    assert callbacks >= CALLBACKS
    assert handled + left_out == callbacks
    assert handled > 100_000
    assert grown < BOUND


async def _flooded() -> tuple[int, int, int, int]:
    """How many callbacks there were, how many were handled and left out, and by how many KiB the process grew."""
    address, program = f"127.0.0.1:{free_port()}", Path(__file__).with_name("flooding_program.py")
    engine, inbox, handled = Engine(), Counting(asyncio.get_running_loop()), 0

    def arrived(_key: str, _data: bytes) -> None:
        nonlocal handled
        handled += 1

    def declare() -> None:
        engine.open(engine_settings(NetworkSettings(listen=address, insecure=True)), inbox)
        engine.subscribe("flood", arrived)

    await in_thread(declare)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    sender = subprocess.Popen([sys.executable, str(program), address], stdin=subprocess.PIPE)
    try:
        until = time.monotonic() + time_limit(3_000) - 20
        while inbox.dropped < CALLBACKS // 2:  # the loop is blocked, and half of all comes
            assert time.monotonic() < until, f"{inbox.callbacks} callbacks"
            time.sleep(0.01)
        while inbox.callbacks < CALLBACKS:  # it is busy, and the other half comes
            assert time.monotonic() < until, f"{inbox.callbacks} callbacks"
            time.sleep(0.005)
            await asyncio.sleep(0)
    finally:
        await asyncio.to_thread(sender.communicate, timeout=20)
        await in_thread(engine.close)
    async with asyncio.timeout(20.0):
        while handled + inbox.dropped < inbox.callbacks:
            await asyncio.sleep(0.01)
    return inbox.callbacks, handled, inbox.dropped, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
