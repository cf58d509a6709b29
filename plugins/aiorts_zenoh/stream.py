"""Both directions of a session with a kernel, over messages that may be lost. It knows no engine and no loop.

Each end numbers the bytes that it sends, keeps them until the other end has used them, and sends them again from the
first that is missing there. So the bytes under way are bounded, and the bytes that come are whole and in order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from aiorts_zenoh.envelope import END, FRAME, HAVE, LOOK, TAKEN, Message, message

WINDOW: Final = 128 * 1024
"""The most bytes that are under way, or wait at the other end."""
CHUNK: Final = 32 * 1024
"""The most bytes of one message."""


class Stream:
    """One end of a session.

    Args:
        put: gives a message to the engine.
        number: the number of the session; goes with each message.
        now: ns since 1970.
    """

    def __init__(self, put: Callable[[bytes], None], number: int, now: Callable[[], int]) -> None:
        self._put, self._number, self._now = put, number, now
        self._kept: deque[tuple[int, int, bytes]] = deque()
        """Messages that the other end has not used: first number, kind, bytes."""
        self._sent = self._used = 0
        self._came = self._told = self._took = 0
        self.ended = False
        """Whether the other end has said that nothing comes any more."""

    @property
    def has_room(self) -> bool:
        """Whether more may be sent now."""
        return self._sent - self._used < WINDOW

    @property
    def is_through(self) -> bool:
        """Whether the other end has used all that was sent."""
        return not self._kept

    def send(self, data: bytes) -> None:
        """Send bytes, at most CHUNK, for which there is room."""
        self._send(FRAME, data)

    def end(self) -> None:
        """Say that nothing comes any more; the end counts as one byte in the numbers."""
        self._send(END, b"")

    def _send(self, kind: int, data: bytes) -> None:
        self._kept.append((self._sent, kind, data))
        self._say(kind, self._sent, data)
        self._sent += len(data) or 1

    def look(self) -> None:
        """Ask how far the other end has come, if anything is under way: an answer or a message may have been lost."""
        if self._kept:
            self._say(LOOK, self._sent)

    def arrived(self, came: Message) -> bytes:
        """Handle a message; return the bytes that now come next in order, or b""."""
        if came.epoch != self._number:
            return b""
        if came.kind == TAKEN:
            self._free(came.first)
        elif came.kind == HAVE:
            for first, kind, data in self._kept:
                if first >= came.first:
                    self._say(kind, first, data)
        elif came.kind == LOOK:
            self._tell()
            if self._came < came.first:
                self._say(HAVE, self._came)
        elif came.first == self._came and not self.ended:
            return self._next(came)
        return b""

    def _next(self, came: Message) -> bytes:
        if came.kind == END:
            self.ended = True
            self._came += 1
            self.took(1)
            self._tell()
            return b""
        if came.kind != FRAME or len(came.blocks) != 1 or self._came - self._took > WINDOW:
            return b""  # an end that keeps to the window sends no more
        data = bytes(came.blocks[0][:CHUNK])
        self._came += len(data)
        return data

    def took(self, count: int) -> None:
        """Count so many bytes that have come as used: the other end may send as many more."""
        self._took += count
        if self._took - self._told >= WINDOW // 4:
            self._tell()

    def _tell(self) -> None:
        self._told = self._took
        self._say(TAKEN, self._took)

    def _free(self, used: int) -> None:
        if self._used < used <= self._sent:
            self._used = used
            while self._kept and self._kept[0][0] + (len(self._kept[0][2]) or 1) <= used:
                self._kept.popleft()

    def _say(self, kind: int, first: int, data: bytes = b"") -> None:
        self._put(message(kind, self._number, first, self._now(), [data] if data else []))
