"""A kernel's session with another one, through whose control table it asks: `control/client.py` for an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, Self

from aiorts.errors import AiortsError, ClosedError, NoAnswerError, WireError
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.sessions import BYE, NEWEST, OLDEST, answer_in, error_in, framed, frames

if TYPE_CHECKING:
    import socket

_CHUNK: Final = 1 << 16
_LONGEST: Final = 8 << 20
"""Bytes of an answer."""
_GREETS: Final = 4.0
"""Seconds that a kernel has to say hello: longer than another host is asked what this kernel may do there."""
WITHIN: Final = 4.5
"""Seconds that a call waits: less than who asks for a transition waits for it."""


class KernelSession:
    """What this kernel asks another one.

    Attributes:
        address: the other's, "host/kernel".
        hello: what it says of itself: its right, its epoch.
        lost: called once when it has ended, unless this end closed it.
    """

    def __init__(self, address: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.address = address
        self.hello: Mapping[str, Any] = {}
        self.lost: Callable[[], object] = _nothing
        self._reader, self._writer = reader, writer
        self._greeted: asyncio.Future[Mapping[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._items: dict[int, Callable[[Any], object]] = {}
        """Of operations that stream: what takes their items."""
        self._last = 0
        self._closed = False
        self._reading = kernel_task(asyncio.get_running_loop(), self._read(), f"aiorts session {address}")

    @classmethod
    async def open(cls, connected: socket.socket, address: str, who: str) -> Self:
        """A session over a connected socket. AiortsError: the other kernel refuses it, or does not answer."""
        reader, writer = await asyncio.open_unix_connection(sock=connected)
        session = cls(address, reader, writer)
        session._send({"hello": {"oldest": OLDEST, "newest": NEWEST, "who": who}})
        try:
            async with asyncio.timeout(_GREETS):
                session.hello = await session._greeted
        except TimeoutError:
            session.close()
            raise NoAnswerError(f"{address}: no answer") from None
        except BaseException:
            session.close()
            raise
        return session

    @property
    def is_open(self) -> bool:
        """Whether it can be asked."""
        return not self._closed

    async def call(self, operation: str, **arguments: object) -> Any:
        """What an operation gives there.

        Raises:
            NoAnswerError: there was no answer in time.
            ClosedError: the session has ended.
            AiortsError: what refused it, by its code.
        """
        number, answer = self._begin(operation, arguments)
        try:
            async with asyncio.timeout(WITHIN):
                return await answer
        except TimeoutError:
            raise NoAnswerError(f"{self.address}: {operation}: no answer within {WITHIN:g} s") from None
        finally:
            self._answers.pop(number, None)

    async def follow(self, operation: str, take: Callable[[Any], object], **arguments: object) -> None:
        """Begin an operation that streams, and have `take` called with each item; errors as `call`."""
        self._items[self._last + 1] = take
        await self.call(operation, **arguments)

    def close(self) -> None:
        """End it in order; idempotent."""
        self.lost = _nothing
        if not self._closed:
            self._writer.write(BYE)  # it is not lost, which would have the component do what it says for that
        self._end(ClosedError(f"{self.address}: the session was closed"))

    def _begin(self, operation: str, arguments: Mapping[str, object]) -> tuple[int, asyncio.Future[Any]]:
        if self._closed:
            raise ClosedError(f"{self.address}: the session has ended")
        self._last += 1
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._answers[self._last] = answer
        self._send({"id": self._last, "op": operation, "epoch": self.hello.get("epoch", ""), "args": arguments})
        return self._last, answer

    def _send(self, message: Mapping[str, Any]) -> None:
        self._writer.write(framed(message))

    async def _read(self) -> None:
        buffer = bytearray()
        error: AiortsError = ClosedError(f"{self.address}: has ended")
        try:
            while data := await self._reader.read(_CHUNK):
                buffer += data
                for frame in frames(buffer, _LONGEST):
                    self._take(answer_in(frame))
        except OSError:
            pass  # as at the end
        except AiortsError as fault:
            error = fault
        except (LookupError, TypeError, ValueError) as fault:
            error = WireError(f"{self.address}: says what is no answer: {fault!r}")
        finally:
            self._end(error)

    def _take(self, frame: Mapping[Any, Any]) -> None:
        number = frame.get("id")
        answer = self._greeted if "hello" in frame or number is None else self._answers.get(number)
        if "item" in frame and number in self._items:
            self._items[number](frame["item"])
        elif answer is None or answer.done():
            return
        elif "error" in frame:
            answer.set_exception(error_in(frame["error"], self.address))
        elif "hello" in frame or "ok" in frame:
            answer.set_result(frame.get("hello", frame.get("ok")))

    def _end(self, error: AiortsError) -> None:
        if self._closed:
            return
        self._closed = True
        self._reading.cancel()
        self._writer.close()
        for answer in (self._greeted, *self._answers.values()):
            if not answer.done():
                answer.set_exception(error)
                answer.exception()  # whether or not somebody waits for it
        lost, self.lost = self.lost, _nothing
        lost()


def _nothing() -> None:
    """Nobody is to be told."""
