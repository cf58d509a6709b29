"""A kernel that answers late is there, and is operated as one that answers at once: a missing answer is none."""

from __future__ import annotations

import asyncio
import json
import tempfile
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

pytest.importorskip("zenoh")

import msgpack
import zenoh

from aiorts.sessions import Client, Entry, framed
from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from network.network_parts import free_port

pytestmark = pytest.mark.slow

KERNEL = "far/robot/000000000000000a"
WAIT = 20.0


@contextmanager
def kernel(address: str, branches: dict[str, float], begun: list[str]) -> Iterator[Callable[[], object]]:
    """A kernel that says hello below each branch after so many seconds, and notes below which sessions begin.

    It is gone with what is yielded.
    """
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
        timers: list[threading.Timer] = []

        def answer_all() -> None:
            while (question := came.get()) is not None:
                timers.append(threading.Timer(branches[question[0]], answer, question))
                timers[-1].start()

        def asked(branch: str, query: Any) -> None:
            came.put((branch, query))  # the engine's thread is none that may wait

        answering = threading.Thread(target=answer_all)
        answering.start()

        kept: list[Any] = []
        for branch in tuple(branches):
            key = f"aiorts/1/default/{branch}/{KERNEL}/*/*"
            kept.append(session.declare_queryable(key, zenoh.handlers.Callback(partial(asked, branch), indirect=False)))
            kept.append(session.declare_subscriber(f"{key}/c", lambda one: begun.append(str(one.key_expr))))
        host, name, epoch = KERNEL.split("/")
        token = f"aiorts/1/default/live/{host}/{name}/1-{epoch}-{1:016x}"
        tokens: list[Any] = [session.liveliness().declare_token(one) for one in (token, f"{token}/own")]
        try:
            yield lambda: [one.undeclare() for one in tokens]
        finally:
            came.put(None)
            answering.join(WAIT)
            for timer in timers:
                timer.cancel()
                timer.join(WAIT)


@asynccontextmanager
async def gateway(address: str) -> AsyncIterator[Entry]:
    """What a client reaches the kernel by."""
    with tempfile.TemporaryDirectory(prefix="ai") as folder:
        settings = engine_settings(NetworkSettings(connect=address, insecure=True))
        made = Gateway(Path(folder), ClientKeys("default", "tester"), settings)
        await made.open()
        try:
            assert [(peer.host, peer.kernel) for peer in made.peers] == [("far", "robot")]
            path = str(next(Path(folder).glob("*.sock")))
            yield Entry("far/robot", 1, KERNEL.rpartition("/")[2], path, carried=True)
        finally:
            await made.close()


async def begins(entry: Entry, begun: list[str]) -> str:
    """Below which branch a session begins."""
    before = set(begun)
    client = await asyncio.to_thread(Client, entry)
    async with asyncio.timeout(WAIT):
        while not (new := set(begun) - before):
            await asyncio.sleep(0.02)
    client.close()
    return new.pop().split("/")[3]


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

    async def main() -> str:
        async with gateway(address) as entry:
            return await begins(entry, begun)

    with kernel(address, branches, begun):
        assert asyncio.run(main()) == expected


def test_a_client_that_was_let_operate_too_late_once_operates_in_the_next_session() -> None:
    address, begun = f"127.0.0.1:{free_port()}", list[str]()
    branches = {"info": 0.0, "ctl": 2.5}

    async def main() -> str:
        async with gateway(address) as entry:
            await begins(entry, begun)
            branches["ctl"] = 0.0
            return await begins(entry, begun)

    with kernel(address, branches, begun):
        assert asyncio.run(main()) == "ctl"


def test_a_session_ends_whose_kernel_goes_before_it_has_said_what_a_client_may_do() -> None:
    address = f"127.0.0.1:{free_port()}"

    async def main(leave: Callable[[], object]) -> bytes:
        async with gateway(address) as entry:
            reader, writer = await asyncio.open_unix_connection(entry.path)
            writer.write(framed({"hello": {"to": [entry.address, entry.epoch]}}))
            await asyncio.sleep(1.0)  # it is asked
            await asyncio.to_thread(leave)
            async with asyncio.timeout(WAIT):
                said = await reader.read()
            writer.close()
            return said

    with kernel(address, {"info": 60.0}, []) as leave:
        assert asyncio.run(main(leave)) == b""
