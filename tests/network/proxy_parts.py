"""A TCP proxy on the loopback: what goes through it can be delayed, slowed down, held up one way, cut and refused."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final, Literal

Way = Literal["there", "back"]
"""From who connects to the target, or to it."""
_CHUNK: Final = 4_096
_BUFFER: Final = 65_536
_MOST: Final = 4 << 20
"""Bytes that are on their way at the most; beyond them nothing more is received."""


class Proxy:
    """Connections to `port` go on to a port of the loopback, from a thread of its own. Its methods are for others."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.delay = 0.0
        """Seconds that all take on their way, each way."""
        self.rate = 0.0
        """Bytes of a second that go through, each way; 0: all."""
        self._open: dict[Way, asyncio.Event] = {"there": asyncio.Event(), "back": asyncio.Event()}
        self._serving: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self.port = 0
        self.release()
        self.mend()

    @property
    def address(self) -> str:
        """Where it listens."""
        return f"127.0.0.1:{self.port}"

    def hold(self, *ways: Way) -> None:
        """Let nothing through these ways, also not the end of a connection; what comes waits, as for a repetition."""
        self._call(lambda: [self._open[way].clear() for way in ways])

    def release(self) -> None:
        """Let all through again."""
        self._call(lambda: [one.set() for one in self._open.values()])

    def cut(self) -> None:
        """End all connections, and refuse others."""
        self._wait(self._cut())

    def mend(self) -> None:
        """Take connections again."""
        self._wait(self._listen())

    def close(self) -> None:
        """End it."""
        self.cut()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    def _call(self, change: Callable[[], object]) -> None:
        async def work() -> None:
            change()

        self._wait(work())

    def _wait(self, work: object) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result(10)  # type: ignore[arg-type]

    async def _listen(self) -> None:
        if self._server is None:
            listener = socket.socket()
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)  # what is accepted has it, too
            listener.bind(("127.0.0.1", self.port))
            self.port = int(listener.getsockname()[1])
            self._server = await asyncio.start_server(self._came, sock=listener)

    async def _cut(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for task in tuple(self._serving):
            task.cancel()
        await asyncio.gather(*self._serving, return_exceptions=True)

    async def _came(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._serving.add(task)
        writers = [writer]
        try:
            on = socket.socket()
            on.setblocking(False)
            on.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            try:
                await self._loop.sock_connect(on, ("127.0.0.1", self._target))
            except BaseException:
                on.close()
                raise
            far_reader, far_writer = await asyncio.open_connection(sock=on)
            writers.append(far_writer)
            both = self._carry("there", reader, far_writer), self._carry("back", far_reader, writer)
            carrying = [asyncio.ensure_future(one) for one in both]
            try:
                await asyncio.wait(carrying, return_when=asyncio.FIRST_EXCEPTION)
            finally:
                for one in carrying:
                    one.cancel()
                await asyncio.gather(*carrying, return_exceptions=True)
        except (OSError, asyncio.CancelledError):
            pass  # the target is not there, or this connection is cut
        finally:
            self._serving.discard(task)
            for one in writers:
                one.transport.abort()

    async def _carry(self, way: Way, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry what comes one way, and its end."""
        waiting: deque[tuple[float, bytes]] = deque()
        came = asyncio.Event()

        async def receive() -> None:
            data = b"begins"
            while data:
                try:
                    data = await reader.read(_CHUNK)
                except OSError:
                    data = b""
                while len(waiting) * _CHUNK > _MOST:
                    await asyncio.sleep(0.01)
                waiting.append((self._loop.time() + self.delay, data))
                came.set()

        receiving = asyncio.ensure_future(receive())
        try:
            while True:
                await came.wait()
                due, data = waiting.popleft()
                if not waiting:
                    came.clear()
                if (left := due - self._loop.time()) > 0:
                    await asyncio.sleep(left)
                if self.rate:
                    await asyncio.sleep(len(data) / self.rate)
                await self._open[way].wait()
                if not data:
                    writer.write_eof()
                    return
                writer.write(data)
                await writer.drain()
        except OSError:  # it takes nothing any more, and says so the other way
            await self._open["back" if way == "there" else "there"].wait()
            raise
        finally:
            receiving.cancel()


@contextlib.contextmanager
def proxied(target: int) -> Iterator[Proxy]:
    """A proxy, until the end of the block."""
    proxy = Proxy(target)
    try:
        yield proxy
    finally:
        proxy.close()
