"""The client on the running loop: calls and streams of one session at once, without a thread or a task of its own.

async with AsyncClient.connect("robot") as client:
    await client.call("activate", component="pid0")
    async for item in client.stream("changes"):
        ...
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, Final, Self, cast

from anyio import to_thread

from aiorts.errors import AiortsError, ClosedError, NoAnswerError, WireError
from aiorts.sessions.base_client import END, TIMEOUT, BaseClient, refusal
from aiorts.sessions.folder import CLOSING_SECONDS, Entry, is_listed
from aiorts.sessions.protocol import ANSWERS, RightName
from aiorts.sessions.session import ITEMS, WINDOW, Answer, Call
from aiorts.sessions.target import entry_named

_LAST: Final = 1.0
"""Seconds within which a kernel should take the last bytes of a session."""
_RETRY: Final = 0.005


class AsyncClient(BaseClient):
    """A session with one kernel on the running loop. `connect` or `open` makes it.

    Its members are `connect`, `open`, `call`, `stream`, `close`, `aclose`, and `hello`, `right`, `entry`, `is_open`,
    `silence`, `lost`. A stream has `async for`, `async with`, `open`, `next`, `close`, and the attributes of
    `AsyncStream`.

    Any number of calls and streams run at once. A call that is cancelled, and a stream that is left, end in the
    kernel, too. A stream that is not read holds up nothing else. When the kernel ends, all calls and streams raise
    ClosedError after the earlier answers are taken; where the kernel ended only this session, they raise `CutOff`.

    Attributes:
        entry: the kernel's entry; its epoch is that of the session.
        lost: called once when the session has ended, unless this end closed it.

    Args:
        entry, who, right: as `open`.
        longest: bytes of the longest frame that is accepted.
    """

    def __init__(self, entry: Entry, who: str = "", *, right: RightName = "", longest: int = ANSWERS) -> None:
        super().__init__(entry, who, right, longest=longest)
        self.lost: Callable[[], object] = _nothing
        self._session.credit = ITEMS
        self._wire = _Wire(self._heard, self._hung_up)
        self._awaited: dict[Call | None, Callable[[], object]] = {}
        """By call, the function to call when an answer comes or the session ends; None: the kernel's hello."""

    @classmethod
    @asynccontextmanager
    async def connect(
        cls, target: Entry | str = "", *, timeout: float = TIMEOUT, who: str = "", right: RightName = ""
    ) -> AsyncIterator[Self]:
        """Open a session until the end of the block; arguments and errors as `open`."""
        client = await cls.open(target, timeout=timeout, who=who, right=right)
        try:
            yield client
        finally:
            await client.aclose()

    @classmethod
    async def open(
        cls, target: Entry | str = "", *, timeout: float = TIMEOUT, who: str = "", right: RightName = ""
    ) -> Self:
        """Open a session that is ready for calls; `aclose` ends it.

        Args:
            target: the kernel's entry, name, address ("host/kernel") or the path of its socket; "" is the only one
                that runs.
            timeout: seconds within which the kernel answers.
            who: this end, for the kernel's log; the command by default.
            right: the highest right wanted: "view", "operate" or "code"; by default all that the kernel allows. The
                attribute `right` is the right that the kernel gave.

        Raises:
            NoAnswerError: the kernel does not answer within `timeout` seconds.
            AbsentError: no running kernel has this name, or the kernel is gone.
            AmbiguousError: several kernels have this name; the text lists them.
            ControlError: the kernel refuses the session, or speaks another protocol.
        """
        loop = asyncio.get_running_loop()
        until = loop.time() + timeout
        entry = target if isinstance(target, Entry) else await to_thread.run_sync(entry_named, target)
        connected = await _connected(entry, until)
        return await cls(entry, who, right=right).begin(connected, until - loop.time())

    async def begin(self, connected: socket.socket, timeout: float) -> Self:
        """Begin the session over a connected socket, which the client owns from then on; errors as `open`."""
        loop = asyncio.get_running_loop()
        try:
            await loop.create_unix_connection(lambda: self._wire, sock=connected)
        except BaseException:
            connected.close()
            raise
        try:
            self._write(self._greeting())
            await self._until(None, lambda: bool(self.hello), timeout)
        except BaseException:
            self.close()
            raise
        return self

    @property
    def is_open(self) -> bool:
        """Whether the session accepts calls."""
        return self._session.error is None

    # -- calls -----------------------------------------------------------------------------------------------------

    async def call(self, operation: str, wait: float | None = TIMEOUT, /, **arguments: object) -> Any:
        """Call an operation; returns its result as plain data.

        Args:
            operation: the name of the operation in the table.
            wait: seconds; None waits without limit. By position only, since an argument may have this name.
            arguments: the arguments of the operation.

        Raises:
            NoAnswerError: no answer came in time; the kernel still carries the call out.
            ClosedError: the session has ended.
            AiortsError: the error that the operation raised, as the class of its code.
        """
        call = await self._begin(operation, wait, arguments)
        try:
            answer = await self._next(call, wait)
        except asyncio.CancelledError:
            self._cancel(call)
            raise
        finally:
            self._session.leave(call)
        return answer.result()

    def stream(self, operation: str, wait: float | None = TIMEOUT, /, **arguments: object) -> AsyncStream:
        """The stream of an operation, which begins at the first wait for an item. Arguments as `call`."""
        return AsyncStream(self, operation, wait, arguments)

    async def follow(self, operation: str, take: Callable[[Any], object], /, **arguments: object) -> None:
        """Begin an operation that streams and call `take` with each item as it comes, until the session ends.

        Raises as `call`. A LookupError, TypeError or ValueError of `take` means a malformed item and ends the session.
        """
        call = await self._begin(operation, TIMEOUT, arguments, streams=True)
        try:
            (await self._next(call, TIMEOUT)).result()
        except BaseException:
            self._cancel(call)
            raise
        self._awaited[call] = partial(self._pass_on, call, take)
        self._pass_on(call, take)

    def _pass_on(self, call: Call, take: Callable[[Any], object]) -> None:
        while call:
            if (answer := call.take()).said == "item":
                take(answer.value)
            else:
                self._session.leave(call)
                self._awaited.pop(call, None)

    async def _begin(
        self,
        operation: str,
        wait: float | None,
        arguments: Mapping[str, object],
        *,
        streams: bool = False,
        window: int = 0,
    ) -> Call:
        self._session.check()
        if not self._wire.takes.is_set():
            await self._in_time(self._wire.takes.wait(), wait, "does not take what is sent")
        call, frame = self._session.begin(operation, arguments, streams=streams, window=window)
        self._write(frame)
        return call

    async def _next(self, call: Call, wait: float | None) -> Answer:
        """Wait for the next answer of a call. When the session has ended, earlier answers come before its error.

        Raises:
            ClosedError: the call was given up meanwhile, or the session has ended.
        """
        if not call:
            await self._until(call, lambda: bool(call) or call.given_up, wait)
        if not call:
            raise ClosedError(f"{self.entry.address}: the stream was closed")
        answer, credit = self._session.take(call)
        self._write(credit)
        return answer

    async def _until(self, call: Call | None, there: Callable[[], bool], wait: float | None) -> None:
        await self._in_time(self._came(call, there), wait)

    async def _came(self, call: Call | None, there: Callable[[], bool]) -> None:
        while not there():
            self._session.check()
            if call in self._awaited:
                raise RuntimeError("two tasks wait for the items of one stream")
            news = asyncio.get_running_loop().create_future()
            self._awaited[call] = partial(_tell, news)
            try:
                await news
            finally:
                self._awaited.pop(call, None)

    async def _in_time(self, awaited: Awaitable[object], wait: float | None, why: str = "") -> None:
        """Wait for an awaitable, at most `wait` seconds; then NoAnswerError with the text `why` or `silence`."""
        limit = asyncio.timeout(wait)
        try:
            async with limit:
                await awaited
        except TimeoutError:
            if not limit.expired():
                raise
            raise NoAnswerError(f"{self.entry.address}: {why or self.silence}") from None

    def _cancel(self, call: Call) -> None:
        self._write(self._session.cancel(call))
        self._wake(call)

    # -- the socket ------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """End the session in order, without waiting: its calls in the kernel end, too. Idempotent."""
        self.lost = _nothing
        if self.is_open:
            bye = self._session.bye()
            self._write(bye)
        self._end()

    async def aclose(self) -> None:
        """End the session in order and wait until its socket is closed. Idempotent."""
        self.close()
        await self._wire.wait_closed()

    def _write(self, data: bytes) -> None:
        if data and not self._wire.transport.is_closing():
            self._wire.transport.write(data)

    def _heard(self, data: bytes) -> None:
        try:
            for call in self._hear(self._session.decode(data)):
                self._wake(call)
            if self.hello:
                self._wake(None)
        except (LookupError, TypeError, ValueError) as fault:  # of a `take` of `follow`
            self._session.end(WireError(f"{self.entry.address}: says what is no answer: {fault!r}"))
        if not self.is_open:
            self._end()

    def _wake(self, call: Call | None) -> None:
        if (wake := self._awaited.get(call)) is not None:
            wake()

    def _hung_up(self, error: Exception | None) -> None:
        """End the session of a socket that the other end has closed.

        A kernel that still listens is checked a second time: a killed process closes its sockets one after the other.
        """
        if self.is_open and error is None and self.hello and is_listed(self.entry):
            asyncio.get_running_loop().call_later(CLOSING_SECONDS, self._look_again)
        else:
            self._end(self._ended(served=False))

    def _look_again(self) -> None:
        self._end(self._ended(served=is_listed(self.entry)))

    def _end(self, error: AiortsError | None = None) -> None:
        """End the session with an error, unless it has one: all waiting calls wake and raise it."""
        if error is not None:
            self._session.end(error)
        self._wire.close()
        awaited, self._awaited = self._awaited, {}
        for wake in awaited.values():
            wake()
        lost, self.lost = self.lost, _nothing
        lost()


class AsyncStream:
    """The items of an operation that streams, in order; `async for` waits for the next.

    `close()`, the end of `async with`, and the loss of the last reference to the stream end the operation in the
    kernel: so does `break` or an exception in `async for item in client.stream(...)`.

    Attributes:
        began: the first answer of the operation, from before its items.
        missed: items that were dropped so far, in the kernel or here, since this end was too slow.
        ended: whether the stream is over: no item comes any more.
        result: the last answer of the operation.
    """

    def __init__(
        self, client: AsyncClient, operation: str, wait: float | None, arguments: Mapping[str, object]
    ) -> None:
        self.client = client
        self.began: Any = None
        self.missed = 0
        self.result: Any = None
        self.ended = False
        self._asked = operation, wait, arguments
        self._call: Call | None = None
        self._loop = asyncio.get_running_loop()

    async def open(self) -> Self:
        """Begin the operation, if it has not begun; errors as `AsyncClient.call`."""
        await self._open()
        return self

    async def _open(self) -> Call:
        if self._call is not None:
            return self._call
        operation, wait, arguments = self._asked
        call = self._call = await self.client._begin(operation, wait, arguments, streams=True, window=WINDOW)
        if self.ended:  # by `close`, while the socket took nothing
            self.client._cancel(call)
        try:
            self.began = (await self.client._next(call, wait)).result()
        except BaseException:
            self.close()
            raise
        return call

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Any:
        try:
            item = await self.next()
        except asyncio.CancelledError:
            self.close()
            raise
        if item is END:
            raise StopAsyncIteration
        return item

    async def next(self, timeout: float | None = None) -> Any:
        """Wait for the next item; END when there are no more. A wait that is cancelled loses no item.

        Raises:
            NoAnswerError: no item came within `timeout` seconds.
            ClosedError: the session has ended.
        """
        if self.ended:
            return END
        call = await self._open()
        try:
            answer = await self.client._next(call, timeout)
        except ClosedError:
            if self.ended:  # by `close`, meanwhile
                return END
            self.missed += call.missed_last()
            raise
        self.missed += answer.missed
        if answer.said == "item":
            return answer.value
        self.close()
        self.result = answer.result()
        return END

    def close(self) -> None:
        """End the operation; idempotent."""
        if not self.ended:
            self.ended = True
            if self._call is not None:
                self.client._cancel(self._call)

    def __del__(self) -> None:
        if self.ended or self._call is None or self._loop.is_closed():
            return
        try:
            here = asyncio.get_running_loop() is self._loop
        except RuntimeError:
            here = False
        if here:
            self.close()
        else:  # collected in another thread
            self._loop.call_soon_threadsafe(self.client._cancel, self._call)


class _Wire(asyncio.Protocol):
    """The socket of a session.

    Args:
        heard: takes the bytes that come.
        over: called once with the reason, when the connection is lost.
    """

    def __init__(self, heard: Callable[[bytes], None], over: Callable[[Exception | None], None]) -> None:
        self.transport: asyncio.WriteTransport
        self.takes = asyncio.Event()
        """Set while the other end reads; cleared while sent bytes pile up."""
        self.takes.set()
        self._heard, self._over = heard, over
        self._closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._abort: asyncio.TimerHandle | None = None

    def close(self) -> None:
        """Close the socket once all is sent, after `_LAST` seconds at the latest."""
        if self._abort is None and not self._closed.done():
            self._abort = self._closed.get_loop().call_later(_LAST, self.transport.abort)
            self.transport.close()

    async def wait_closed(self) -> None:
        """Wait until the socket is closed; a cancelled wait closes it at once."""
        try:
            if not self._closed.done():
                await asyncio.wait([self._closed])
        except asyncio.CancelledError:
            self.transport.abort()
            raise

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.WriteTransport", transport)

    def data_received(self, data: bytes) -> None:
        self._heard(data)

    def pause_writing(self) -> None:
        self.takes.clear()

    def resume_writing(self) -> None:
        self.takes.set()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._abort is not None:
            self._abort.cancel()
        self._closed.set_result(None)
        self.takes.set()
        self._over(exc)


async def _connected(entry: Entry, until: float) -> socket.socket:
    """Connect a socket to the kernel of an entry; errors as `AsyncClient.open`."""
    loop = asyncio.get_running_loop()
    connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connected.setblocking(False)
    try:
        while True:
            try:
                connected.connect(entry.path)
                return connected
            except BlockingIOError:  # the listener's backlog is full
                if loop.time() >= until:
                    raise NoAnswerError(f"{entry.address}: no answer") from None
                await asyncio.sleep(_RETRY)
            except OSError as error:
                raise refusal(entry, error) from None
    except BaseException:
        connected.close()
        raise


def _tell(news: asyncio.Future[None]) -> None:
    if not news.done():
        news.set_result(None)


def _nothing() -> None:
    """Do nothing: the default of `AsyncClient.lost`."""
