"""A kernel that answers late is there, and is operated as one that answers at once: a missing answer is none."""

from __future__ import annotations

import asyncio
import json
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

pytest.importorskip("zenoh")

import msgpack
import zenoh

from aiorts.control import Client, Entry
from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from network.network_parts import free_port

KERNEL = "far/robot/000000000000000a"
WAIT = 20.0


@contextmanager
def kernel(address: str, branches: dict[str, float], begun: list[str]) -> Iterator[None]:
    """A kernel that says hello below each branch after so many seconds, and notes below which sessions begin."""
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/{address}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:

        def answer(branch: str, query: Any) -> None:
            right = {"info": "view", "ctl": "operate"}[branch]
            key = f"aiorts/1/default/{branch}/{KERNEL}/{'/'.join(str(query.key_expr).split('/')[-2:])}"
            query.reply(key, msgpack.packb({"ok": {"right": right}}))
            query.drop()

        came: SimpleQueue[Any] = SimpleQueue()

        def answer_all() -> None:
            while (question := came.get()) is not None:
                asked_at, branch, query = question
                time.sleep(max(0.0, asked_at + branches[branch] - time.monotonic()))
                answer(branch, query)

        def asked(branch: str, query: Any) -> None:
            came.put((time.monotonic(), branch, query))  # the engine's thread is none that may wait

        answering = threading.Thread(target=answer_all)
        answering.start()

        kept: list[Any] = []
        for branch in branches:
            key = f"aiorts/1/default/{branch}/{KERNEL}/*/*"
            kept.append(session.declare_queryable(key, zenoh.handlers.Callback(partial(asked, branch), indirect=False)))
            kept.append(session.declare_subscriber(f"{key}/c", lambda one: begun.append(str(one.key_expr))))
        host, name, epoch = KERNEL.split("/")
        token = f"aiorts/1/default/live/{host}/{name}/1-{epoch}-{1:016x}"
        kept += [session.liveliness().declare_token(one) for one in (token, f"{token}/own")]
        try:
            yield
        finally:
            came.put(None)
            answering.join(WAIT)


@pytest.mark.parametrize(
    ("branches", "expected"),
    [
        ({"info": 0.0, "ctl": 0.7}, "ctl"),  # the first round is over by then
        ({"info": 0.7, "ctl": 0.9}, "ctl"),
        ({"info": 0.0}, "info"),
        ({"info": 0.7}, "info"),
    ],
)
def test_a_session_is_where_the_kernel_lets_this_client(branches: dict[str, float], expected: str) -> None:
    address, begun = f"127.0.0.1:{free_port()}", list[str]()

    async def main(folder: str) -> None:
        settings = engine_settings(NetworkSettings(connect=address, insecure=True))
        gateway = Gateway(Path(folder), ClientKeys("default", "tester"), settings)
        await gateway.open()
        try:
            assert [(peer.host, peer.kernel) for peer in gateway.peers] == [("far", "robot")]
            path = str(next(Path(folder).glob("*.sock")))
            entry = Entry("far/robot", 1, KERNEL.rpartition("/")[2], path, carried=True)
            client = await asyncio.to_thread(Client, entry)
            until = time.monotonic() + WAIT
            while not begun:
                assert time.monotonic() < until
                await asyncio.sleep(0.02)
            client.close()
        finally:
            await gateway.close()

    with tempfile.TemporaryDirectory(prefix="ai") as folder, kernel(address, branches, begun):
        asyncio.run(main(folder))
    assert begun[0].split("/")[3] == expected
