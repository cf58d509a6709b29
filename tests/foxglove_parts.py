"""A viewer as the protocol's document has it, and the command in a process of its own."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from control_parts import WAIT


class Watcher:
    """What a viewer knows."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.info: list[dict[str, Any]] = []
        self.channels: dict[str, dict[str, Any]] = {}
        self.statuses: dict[str, dict[str, Any]] = {}
        self.said: list[dict[str, Any]] = []
        self.samples: dict[str, list[Any]] = {}
        self.ops: list[str] = []
        self.times: list[int] = []
        self._topics: dict[int, str] = {}
        self._next = 100

    async def want(self, *topics: str) -> None:
        asked = []
        for topic in topics:
            self._next += 1
            self._topics[self._next] = topic
            asked.append({"id": self._next, "channelId": self.channels[topic]["id"]})
        await self.ask("subscribe", subscriptions=asked)

    async def unwant(self, topic: str) -> None:
        gone = [number for number, one in self._topics.items() if one == topic]
        await self.ask("unsubscribe", subscriptionIds=gone)

    async def ask(self, op: str, **fields: Any) -> None:
        await self.socket.send(json.dumps({"op": op, **fields}))

    async def until(self, condition: Callable[[], Any]) -> None:
        """Take what comes until the condition is true."""
        async with asyncio.timeout(WAIT):
            while not condition():
                self._take(await self.socket.recv())

    def _take(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            if message[0] == 2:
                self.times.append(int.from_bytes(message[1:], "little"))
            else:
                topic = self._topics[int.from_bytes(message[1:5], "little")]
                self.samples.setdefault(topic, []).append(json.loads(message[13:]))
            return
        found = json.loads(message)
        self.ops.append(found["op"])
        if found["op"] == "serverInfo":
            self.info.append(found)
        elif found["op"] == "advertise":
            self.channels |= {one["topic"]: one for one in found["channels"]}
        elif found["op"] == "unadvertise":
            self.channels = {topic: one for topic, one in self.channels.items() if one["id"] not in found["channelIds"]}
        elif found["op"] == "status":
            self.said.append(found)
            self.statuses[found["id"]] = found
        elif found["op"] == "removeStatus":
            for key in found["statusIds"]:
                del self.statuses[key]


@asynccontextmanager
async def viewer(url: str, subprotocol: str = "foxglove.sdk.v1", **options: Any) -> AsyncIterator[Watcher]:
    async with connect(url, subprotocols=[Subprotocol(subprotocol)], **options) as socket:
        watcher = Watcher(socket)
        await watcher.until(lambda: "advertise" in watcher.ops)
        yield watcher


@contextmanager
def serving(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`aiorts foxglove WORDS` in a process of its own, and its address; killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aiorts", "foxglove", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        found = re.search(r"ws://\S+", process.stdout.readline())
        if found is None:
            raise AssertionError(process.communicate(timeout=WAIT)[1])
        yield process, found[0]
    finally:
        process.kill()
        process.communicate(timeout=WAIT)


def counts(watcher: Watcher) -> Counter[str]:
    return Counter({topic: len(found) for topic, found in watcher.samples.items()})
