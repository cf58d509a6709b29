"""What the engine is told, so that nobody who reaches it holds it up for long or finds it open."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.links import Links

pytest.importorskip("zenoh")

import zenoh

from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.network import LEASE, engine_settings
from network.network_parts import free_port

WAIT = 20.0


@contextmanager
def session(settings: dict[str, Any]) -> Iterator[Any]:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as opened:
        yield opened


def own(**given: str) -> dict[str, Any]:
    """The engine's settings of a kernel without certificates."""
    return dict(engine_settings(NetworkSettings(insecure=True, **given)))


@pytest.mark.slow(kept_by="test_the_engine_has_taken_all_settings")
@pytest.mark.fault("E06")
def test_a_kernel_that_was_stopped_is_gone_within_two_leases_and_comes_back() -> None:
    address, program = f"127.0.0.1:{free_port()}", Path(__file__).with_name("reading_program.py")

    async def main() -> float:
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("writer", services=near) as kernel, asyncio.timeout(3 * WAIT):
            links = kernel.service(Links)
            reader = subprocess.Popen([sys.executable, str(program), address])
            try:
                while not links.peers:
                    await asyncio.sleep(0.01)
                reader.send_signal(signal.SIGSTOP)
                stopped = time.monotonic()
                while links.peers:
                    await asyncio.sleep(0.01)
                took = time.monotonic() - stopped
                reader.send_signal(signal.SIGCONT)
                while not links.peers:
                    await asyncio.sleep(0.01)
            finally:
                reader.kill()
                reader.wait(WAIT)
            return took

    assert asyncio.run(main()) < 2 * LEASE


@pytest.mark.slow(kept_by="test_the_engine_has_taken_all_settings")
def test_who_connects_and_says_nothing_is_put_out_soon() -> None:
    port = free_port()
    with session(own(listen=f"127.0.0.1:{port}")), socket.create_connection(("127.0.0.1", port), WAIT) as silent:
        began = time.monotonic()
        assert silent.recv(1) == b""
        assert time.monotonic() - began < 5.0, "the engine's own time is ten seconds"


def test_nobody_looks_into_or_changes_the_engine_itself() -> None:
    address = f"127.0.0.1:{free_port()}"

    async def main() -> list[str]:
        far = {"zenoh": {"listen": address, "host": "far", "insecure": True}}
        async with Kernel("reader", services=far) as kernel:
            await kernel.service(Network).opened()
            return await asyncio.to_thread(look)

    def look() -> list[str]:
        with session(own(connect=address)) as opened:
            assert [one for one in opened.liveliness().get("aiorts/1/**", timeout=WAIT) if one.ok], "it is reached"
            opened.put("@/*/peer/config/mode", b'"router"')
            found = [str(one.ok.key_expr) for one in opened.get("@/**", timeout=2.0) if one.ok]
            return [key for key in found if not key.startswith(f"@/{opened.info.zid()}/")]  # of its own

    assert asyncio.run(main()) == []


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E10")
def test_a_message_beyond_what_is_taken_is_left_out_and_the_next_arrives() -> None:
    address, came = f"127.0.0.1:{free_port()}", []
    with session(own(listen=address)) as receives, session({**own(connect=address), "mode": "peer"}) as sends:
        kept = receives.declare_subscriber(
            "one", zenoh.handlers.Callback(lambda one: came.append(len(one.payload.to_bytes())), indirect=False)
        )
        until = time.monotonic() + WAIT
        while 1 not in came and time.monotonic() < until:  # until the sender knows of the receiver
            sends.put("one", b"1")
            time.sleep(0.01)
        came.clear()
        for size in (17 << 20, 15 << 20, 2):
            sends.put("one", bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
        while 2 not in came and time.monotonic() < until:
            time.sleep(0.01)
        assert [size for size in came if size > 1] == [15 << 20, 2]
        assert len(list(sends.info.peers_zid())) == 1, "the connection is there"
        del kept


def test_the_engine_has_taken_all_settings() -> None:
    config = zenoh.Config()
    wanted = own(listen=f"127.0.0.1:{free_port()}")
    for key, value in wanted.items():
        config.insert_json5(key, json.dumps(value))
    for key, value in wanted.items():
        found = json.loads(config.get_json(key))
        assert found == value or (isinstance(value, dict) and value.items() <= found.items()), key
