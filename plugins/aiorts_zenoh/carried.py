"""One host's end of a session with a kernel: passes bytes between a local connection and messages of the network."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from aiorts_zenoh.envelope import Message
from aiorts_zenoh.stream import CHUNK, Stream

_LOOK_AGAIN: Final = 0.3
"""Seconds until the other end is asked again how many bytes it has used."""
_REST: Final = 2.0
"""Seconds for the other end to take what is under way, once this end sends nothing more."""


class Carried:
    """One end of a session.

    Args:
        put: gives a message to the engine.
        number: the number of the session.
    """

    def __init__(self, put: Callable[[bytes], None], number: int) -> None:
        self._stream = Stream(put, number, time.time_ns)
        self._came: deque[bytes] = deque()
        self._news = asyncio.Event()
        """Set when a message has come."""
        self._peer_gone = asyncio.Event()
        self._writer: asyncio.StreamWriter | None = None
        self._is_over = False

    def arrived(self, message: Message) -> None:
        """Handle a message from the other end."""
        if data := self._stream.arrived(message):
            self._came.append(data)
        self._news.set()

    def peer_gone(self) -> None:
        """Note that the other end is gone: the bytes that have come go to the local connection, which then ends."""
        self._peer_gone.set()

    def cut_off(self) -> None:
        """End the local connection at once, and tell the other end that the session is over."""
        self._is_over = True
        if self._writer is not None:
            with contextlib.suppress(OSError):  # it has ended
                self._writer.get_extra_info("socket").shutdown(socket.SHUT_RDWR)

    async def refuse(self, data: bytes) -> None:
        """Send these bytes, which say why there is no session, and end the session."""
        self._stream.send(data)
        looking = asyncio.ensure_future(self._look())
        try:
            await self._finish()
        finally:
            looking.cancel()

    async def run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, begun: bytes = b"") -> None:
        """Carry the bytes of either side to the other, until one of them ends.

        Args:
            begun: the bytes that were read from the local connection before.
        """
        self._writer = writer
        if self._is_over:  # cut off before there was a connection
            self.cut_off()
        ways = self._out(reader, begun), self._in(writer), self._look(), self._peer_gone.wait()
        tasks: list[asyncio.Future[Any]] = [asyncio.ensure_future(one) for one in ways]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            while self._came:  # the last words of an end that is gone, such as an answer to stop
                writer.write(self._came.popleft())
            writer.close()
            with contextlib.suppress(OSError, TimeoutError):
                async with asyncio.timeout(_REST):
                    await writer.wait_closed()

    async def _out(self, reader: asyncio.StreamReader, begun: bytes) -> None:
        stream = self._stream
        with contextlib.suppress(OSError):
            while data := begun[:CHUNK] or await reader.read(CHUNK):
                begun = begun[CHUNK:]
                while not stream.has_room:
                    await self._next_news()
                stream.send(data)
        await self._finish()

    async def _finish(self) -> None:
        self._stream.end()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_REST):
                while not self._stream.is_through:
                    await self._next_news()

    async def _in(self, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while self._came or not self._stream.ended:
                while self._came:
                    data = self._came.popleft()
                    writer.write(data)
                    await writer.drain()
                    self._stream.took(len(data))
                if not self._stream.ended:
                    await self._next_news()

    async def _next_news(self) -> None:
        self._news.clear()
        await self._news.wait()

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_AGAIN)
            self._stream.look()
