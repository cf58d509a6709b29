"""A page of the studio without a browser: what it is told, and what that adds up to."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.client import ClientConnection, connect

from control_parts import WAIT
from studio_parts import Site

KINDS = ("frames", "boxes", "edges")
ALL = [-1e6, -1e6, 1e6, 1e6]


@dataclass
class Seen:
    """What one page has been told."""

    socket: ClientConnection
    kernels: dict[str, Any] = field(default_factory=dict)
    frames: dict[int, Any] = field(default_factory=dict)
    boxes: dict[int, Any] = field(default_factory=dict)
    edges: dict[int, Any] = field(default_factory=dict)
    figures: dict[int, list[Any]] = field(default_factory=dict)
    at: dict[str, int] = field(default_factory=dict)
    messages: list[Any] = field(default_factory=list)
    """All but pictures, changes and figures."""
    missed: list[int] = field(default_factory=list)
    """Of each picture."""

    async def say(self, kind: str, **said: Any) -> None:
        await self.socket.send(json.dumps({"t": kind, **said}))

    async def next(self) -> Any:
        """Take the next message."""
        message = json.loads(await self.socket.recv())
        match message["t"]:
            case "picture":
                self.missed.append(message["missed"])
                self.kernels = {one["address"]: one for one in message["kernels"]}
                for kind in KINDS:
                    setattr(self, kind, {one["id"]: one for one in message[kind]})
            case "change":
                self.kernels |= {one["address"]: one for one in message.get("kernels", ())}
                gone = message.get("gone", {})
                for address in gone.get("kernels", ()):
                    del self.kernels[address]
                for kind in KINDS:
                    things = getattr(self, kind)
                    things |= {one["id"]: one for one in message.get(kind, ())}
                    for number in gone.get(kind, ()):
                        del things[number]
            case "figures":
                self.at |= {kernel: int(at) for kernel, at in message["at"].items()}
                self.figures |= {int(number): row for number, row in message["e"].items()}
            case _:
                self.messages.append(message)
        return message

    async def until(self, condition: Callable[[], Any], seconds: float = WAIT) -> Any:
        """What the condition gives once it is true, after a message or at once."""
        async with asyncio.timeout(seconds):
            while not (found := condition()):
                await self.next()
        return found

    async def heard(self, kind: str, condition: Callable[[Any], Any] = bool, seconds: float = WAIT) -> Any:
        """The first message of this kind for which the condition is true; it is heard once."""

        def found() -> Any:
            return next((one for one in self.messages if one["t"] == kind and condition(one)), None)

        message = await self.until(found, seconds)
        self.messages.remove(message)
        return message

    def box(self, name: str) -> Any:
        return next((one for one in self.boxes.values() if one["name"] == name), None)

    def kernel(self, name: str) -> Any:
        return next((one for one in self.kernels.values() if one["name"] == name), None)

    def is_live(self, name: str) -> bool:
        found = self.kernel(name)
        return found is not None and found["state"] == "live"

    async def whole(self, *names: str) -> None:
        """Wait until all of these boxes are there and have stood still for a second: they are laid out."""
        await self.until(lambda: all(map(self.box, names)))
        while True:
            before = self.places()
            try:
                async with asyncio.timeout(1.0):
                    while self.places() == before:
                        await self.next()
            except TimeoutError:
                return

    def places(self) -> dict[int, tuple[float, float]]:
        return {number: (one["x"], one["y"]) for number, one in self.boxes.items()}


@asynccontextmanager
async def paging(client: Site) -> AsyncIterator[Seen]:
    """A page that is open, with all in view."""
    address = f"ws://{client.host}/api/page"
    async with connect(address, origin=client.origin, max_size=None) as socket:  # type: ignore[arg-type]
        await socket.send(json.dumps({"token": client.token}))
        page = Seen(socket)
        async with asyncio.timeout(WAIT):
            while not page.missed:
                await page.next()
        await page.say("view", rect=ALL, scale=1.0)
        yield page
