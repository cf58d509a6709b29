"""A kernel's session with another one, through whose control table it asks: `ClientSession` on an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, Self

from aiorts.errors import AiortsError, ClosedError, NoAnswerError, WireError
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.sessions import Call, ClientSession

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
        lost: called once when it has ended, unless this end closed it.
    """

    def __init__(self, address: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.address = address
        self.lost: Callable[[], object] = _nothing
        self._session = ClientSession(address, longest=_LONGEST)
        self._reader, self._writer = reader, writer
        self._greeted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._answers: dict[Call, asyncio.Future[Any]] = {}
        """The calls that wait for their answer."""
        self._items: dict[Call, Callable[[Any], object]] = {}
        """The functions that take the items of streams."""
        self._closed = False
        self._reading = kernel_task(asyncio.get_running_loop(), self._read(), f"aiorts session {address}")

    @classmethod
    async def open(cls, connected: socket.socket, address: str, who: str) -> Self:
        """A session over a connected socket. AiortsError: the other kernel refuses it, or does not answer."""
        reader, writer = await asyncio.open_unix_connection(sock=connected)
        session = cls(address, reader, writer)
        writer.write(session._session.greeting(who))
        try:
            async with asyncio.timeout(_GREETS):
                await session._greeted
        except TimeoutError:
            session.close()
            raise NoAnswerError(f"{address}: no answer") from None
        except BaseException:
            session.close()
            raise
        return session

    @property
    def hello(self) -> Mapping[str, Any]:
        """The epoch of the other kernel, the right that it gives, and its names; empty before its hello."""
        return self._session.hello

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
        call = self._begin(operation, arguments)
        try:
            return await self._answer(call, operation)
        finally:
            self._session.leave(call)

    async def follow(self, operation: str, take: Callable[[Any], object], **arguments: object) -> None:
        """Begin an operation that streams, and have `take` called with each item; errors as `call`."""
        call = self._begin(operation, arguments, streams=True)
        self._items[call] = take
        try:
            await self._answer(call, operation)
        except BaseException:
            del self._items[call]
            if not self._closed:
                self._writer.write(self._session.cancel(call))  # one that is left runs on there
            raise

    def close(self) -> None:
        """End it in order; idempotent."""
        self.lost = _nothing
        if not self._closed:
            self._writer.write(self._session.bye())  # or it were lost, and the component did what it says for that
        self._end(ClosedError(f"{self.address}: the session was closed"))

    def _begin(self, operation: str, arguments: Mapping[str, object], *, streams: bool = False) -> Call:
        if self._closed:
            raise ClosedError(f"{self.address}: the session has ended")
        call, frame = self._session.begin(operation, arguments, streams=streams)
        self._writer.write(frame)
        return call

    async def _answer(self, call: Call, operation: str) -> Any:
        answer = self._answers[call] = asyncio.get_running_loop().create_future()
        try:
            async with asyncio.timeout(WITHIN):
                return await answer
        except TimeoutError:
            raise NoAnswerError(f"{self.address}: {operation}: no answer within {WITHIN:g} s") from None
        finally:
            del self._answers[call]

    async def _read(self) -> None:
        error: AiortsError = ClosedError(f"{self.address}: has ended")
        try:
            while self._session.error is None and (data := await self._reader.read(_CHUNK)):
                for call in self._session.receive(data):
                    self._take(call)
                if self.hello and not self._greeted.done():
                    self._greeted.set_result(None)
        except OSError:
            pass  # as at the end
        except (LookupError, TypeError, ValueError) as fault:
            error = WireError(f"{self.address}: says what is no answer: {fault!r}")
        finally:
            self._end(error)

    def _take(self, call: Call) -> None:
        answer, waiting = call.take(), self._answers.get(call)
        if answer.said == "item":
            self._items[call](answer.value)
        elif waiting is None or waiting.done():
            self._session.leave(call)  # a stream has ended
            self._items.pop(call, None)
        elif answer.said == "error":
            waiting.set_exception(answer.value)
        else:
            waiting.set_result(answer.value)

    def _end(self, error: AiortsError) -> None:
        """End it; a fault that the session has found says more than `error`."""
        if self._closed:
            return
        self._closed = True
        self._session.end(error)
        self._reading.cancel()
        self._writer.close()
        for answer in (self._greeted, *self._answers.values()):
            if not answer.done():
                answer.set_exception(self._session.error or error)
                answer.exception()  # whether or not somebody waits for it
        lost, self.lost = self.lost, _nothing
        lost()


def _nothing() -> None:
    """Nobody is to be told."""
