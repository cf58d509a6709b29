"""The rings of one connection, one in each direction, and the order of their messages.

    sender                                receiver
    OFFER: a ring is there        ->      expects a descriptor from now on
                                  <-      READY
    RING, with the descriptor     ->      checks and maps it
                                  <-      MAPPED, or CANNOT
    frames with places            ->      arrays look into the ring
                                  <-      FREED: nothing looks into these extents any more

A descriptor is only received where one is expected: all others are closed by the system, which never gives them to this
process. That also leaves the receiving of small messages as it is.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence

from aiorts.errors import LinkError
from aiorts.rings.frames import CANNOT, FREED, MAPPED, OFFER, READY, RING, Place, Put, places_bytes, places_of
from aiorts.rings.memory import AVAILABLE
from aiorts.rings.receiving import Receiving
from aiorts.rings.sending import Sending


class Rings:
    """Both rings of a connection.

    Args:
        say: sends a message, with a descriptor or without; False: the connection takes none any more.
        expect: lets the stream receive one descriptor.
        received: gives the descriptor that has come, which the caller then owns; None: none has come.
        report: says why there is no ring.
        room: called when parts that had to wait may be sent.
    """

    available = AVAILABLE

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        say: Callable[[bytes, int | None], bool],
        expect: Callable[[], None],
        received: Callable[[], int | None],
        report: Callable[[str], None],
        room: Callable[[], None],
    ) -> None:
        self._say, self._expect, self._received, self._report = say, expect, received, report
        self._sending = Sending(loop, say, report, room)
        self._receiving = Receiving(loop, lambda body: say(body, None))
        self._expects = False
        self._unsaid: list[bytes] = []
        """Answers that could not be sent yet."""

    def trust(self) -> None:
        """Let readers use the other end's memory without a copy: the other end has proved to be of this program."""
        self._receiving.trusts = True

    def put(self, parts: Sequence[memoryview]) -> Put | None:
        """The places of the parts of a frame; None: there is none yet, and the frame has to wait for `room`."""
        return self._sending.put(parts)

    def take_back(self, places: Sequence[Place]) -> None:
        """Take back the last `put`, which was not sent."""
        self._sending.take_back(places)

    def frame(self, places: Sequence[Place], head: bytes) -> bytes:
        """A frame that says where its parts are."""
        return places_bytes(places) + head

    def frame_of(self, body: memoryview, beside: Sequence[memoryview]) -> tuple[memoryview, tuple[memoryview, ...]]:
        """The frame and its parts, which look into the ring.

        Raises:
            LinkError: the parts cannot be in the ring.
        """
        places, head = places_of(body)
        return head, self._receiving.views(places, beside)

    def flush(self) -> None:
        """Send the answers that wait: messages can be sent again."""
        while self._unsaid and self._say(self._unsaid[0], None):
            del self._unsaid[0]
        self._receiving.flush()

    def _answer(self, what: int) -> None:
        self._unsaid.append(bytes((what,)))
        self.flush()

    def heard(self, body: bytes) -> None:
        """Handle a message of the other end.

        Raises:
            LinkError: the message breaks what both ends have agreed on.
        """
        what = body[0] if body else 0
        if self._receiving.closed:
            return
        if what == FREED:
            self._sending.freed(body)
        elif what == OFFER:
            if self._expects or self._receiving.is_full:
                raise LinkError("more rings than are allowed")
            self._expects = True
            self._expect()
            self._answer(READY)
        elif what == RING:
            self._take()
        else:
            self._sending.heard(what, body)

    def _take(self) -> None:
        descriptor = self._received()
        if descriptor is None or not self._expects:
            raise LinkError("a ring without a descriptor")
        self._expects = False
        try:
            why = self._receiving.take(descriptor)
        finally:
            os.close(descriptor)  # what is mapped stays
        if why:
            self._report(f"cannot look into the memory of arrays, which come through the socket: {why}")
        self._answer(CANNOT if why else MAPPED)

    def close(self) -> None:
        """End both rings with the connection; arrays in the other end's memory stay as they are."""
        self._sending.close()
        self._receiving.close()
