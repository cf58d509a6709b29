"""Two ends of a connection in one process, whose messages go over at the next turn of the loop."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Sequence

from aiorts.rings import Rings


class End:
    """One end: its rings, and what it was told."""

    def __init__(self) -> None:
        self.other: End
        self.reports: list[str] = []
        self.takes = True
        """Whether messages can be sent now."""
        self.descriptor: int | None = None
        self._loop = asyncio.get_running_loop()
        self.rooms = 0
        """How often it was told that parts which had to wait may be sent."""
        self.rings = Rings(self._loop, self._say, lambda: None, self._received, self.reports.append, self._room)

    def _room(self) -> None:
        self.rooms += 1

    def _say(self, body: bytes, descriptor: int | None) -> bool:
        if self.takes:
            self._loop.call_soon(self.other.hear, body, None if descriptor is None else os.dup(descriptor))
        return self.takes

    def hear(self, body: bytes, descriptor: int | None) -> None:
        self.descriptor = descriptor
        self.rings.heard(body)

    def _received(self) -> int | None:
        found, self.descriptor = self.descriptor, None
        return found

    def send(self, *parts: bytes) -> tuple[memoryview, ...]:
        """The parts of a frame as the other end has them."""
        views = [memoryview(part) for part in parts]
        put = self.rings.put(views)
        if put is None or not put.places:
            return tuple(views)
        places, beside = put
        head, found = self.other.rings.frame_of(memoryview(self.rings.frame(places, b"head")), beside)
        assert head == b"head"
        return found

    async def through_ring(self, *parts: bytes) -> tuple[memoryview, ...]:
        """The same, once there is a ring with room for them."""
        async with asyncio.timeout(5):
            while True:
                found = self.send(*parts)
                if any(not isinstance(view.obj, bytes) for view in found):
                    return found
                await turns()


def pair(*, trust: bool = True) -> tuple[End, End]:
    """Two ends; with `trust` each is of the other's program."""
    one, two = End(), End()
    one.other, two.other = two, one
    if trust:
        one.rings.trust()
        two.rings.trust()
    return one, two


def close(ends: Sequence[End]) -> None:
    for end in ends:
        end.rings.close()


async def turns(count: int = 20) -> None:
    """Let everything that was said arrive, also what was said because of it."""
    for _ in range(count):
        await asyncio.sleep(0)
