"""A profile through the network: in numbered pieces below 64 KiB, whole; and anew from its beginning after a loss."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

import zenoh

from aiorts import Component, Kernel, Param, PeriodicContext
from aiorts.model.plain import plain
from aiorts.sessions import FURTHER, Client, entries, framed
from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.envelope import FRAME, read
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from network.network_parts import free_port
from network.test_other_hosts import WAIT, Far, far

__all__ = ("far",)

MIB = 1 << 20
PROGRAM = Path(__file__).with_name("watching_program.py")


class Long(Component):
    """Has a value of 60,000 letters."""

    text: str = Param("x" * 60_000)


def _listener(address: str, came: list[tuple[str, bytes]]) -> Any:
    """Another session that hears what is sent in sessions."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/{address}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    session.declare_subscriber(
        "aiorts/1/default/info/**", lambda one: came.append((str(one.key_expr), one.payload.to_bytes()))
    )
    return session


@pytest.mark.slow(kept_by="first")
def test_a_profile_of_more_than_a_mebibyte_arrives_whole_in_numbered_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    address, came = f"127.0.0.1:{free_port()}", list[tuple[str, bytes]]()

    def profile() -> Any:
        entry = next(one for one in entries() if one.carried)
        with Client.open(entry, timeout=WAIT) as client:
            return client.call("profile", WAIT)

    async def main(folder: str) -> tuple[Any, Any]:
        services = {"control": {"name": "big"}, "zenoh": {"listen": address, "insecure": True, "host": "far"}}
        async with Kernel(services=services) as kernel:
            made = [await kernel.create(Long) for _ in range(20)]
            await kernel.start(PeriodicContext(rate=10.0, name="loop"), *made)
            await kernel.service(Network).opened()
            settings = engine_settings(NetworkSettings(connect=address, insecure=True))
            gateway = Gateway(Path(folder), ClientKeys("default", "tester"), settings)
            await gateway.open()
            other = await asyncio.to_thread(_listener, address, came)
            try:
                async with asyncio.timeout(WAIT):
                    while not gateway.peers:
                        await asyncio.sleep(0.02)
                return plain(kernel.profile()), await asyncio.to_thread(profile)
            finally:
                await gateway.close()
                await asyncio.to_thread(other.close)

    with tempfile.TemporaryDirectory(prefix="ai") as folder:
        monkeypatch.setenv(FURTHER, folder)
        expected, found = asyncio.run(main(folder))
    assert len(framed(found)) > MIB
    assert _texts(found) == _texts(expected) == {f"long{number}": 60_000 for number in range(20)}
    frames = [one for key, data in came if key.endswith("/s") and (one := read(data)).kind == FRAME]
    pieces = sorted({one.first: len(one.blocks[0]) for one in frames}.items())
    assert max(len(data) for _, data in came) < 64 * 1024
    assert len(pieces) > 30
    assert [first + size for first, size in pieces[:-1]] == [first for first, _ in pieces[1:]]


def _texts(profile: Any) -> dict[str, int]:
    """Of each component how long its value is."""
    components = profile["components"]
    return {name: len(one["configuration"]["sets"]["default"]["text"]) for name, one in components.items()}


@contextmanager
def _watching(far: Far) -> Iterator[tuple[subprocess.Popen[str], Iterator[list[Any]]]]:
    """`aiorts at` with a client that follows the profile, and what it says."""
    with far.start(stdin=subprocess.PIPE, start_new_session=True) as at:
        assert at.stdin is not None
        assert at.stdout is not None
        at.stdin.write(f"exec {sys.executable} {PROGRAM} robot\n")
        at.stdin.flush()
        ending = threading.Timer(WAIT, at.kill)
        ending.start()
        try:
            yield at, map(json.loads, at.stdout)
        finally:
            ending.cancel()
            os.killpg(at.pid, signal.SIGKILL)


@pytest.mark.slow(kept_by="test_a_profile_of_more_than_a_mebibyte_arrives_whole_in_numbered_pieces")
def test_who_watches_begins_with_a_fresh_profile_also_after_its_network_was_cut(far: Far) -> None:
    with _watching(far) as (_, said):
        kind, first, _ = next(said)
        assert kind == "ProfileSnapshot"
        far.do("conf", "counter", "hold=0.001")
        _, sequence, _ = next(said)
        assert sequence > first
    far.do("conf", "counter", "hold=0.125")  # while nobody watches
    with _watching(far) as (_, said):
        kind, again, has_it = next(said)
        assert (kind, again > sequence, has_it > 0) == ("ProfileSnapshot", True, True)
        far.do("conf", "counter", "hold=0.001")
        assert next(said)[1] > again
