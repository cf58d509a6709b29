"""One WebSocket for each client: many streams at once, each with a credit of items that the client takes.

The client sends `{"token": ...}` first, then `{"subscribe": id, "kernel": ..., "operation": ..., "arguments": {...},
"credit": n}`, `{"credit": id, "items": n}` and `{"unsubscribe": id}`. The server sends `{"right": ...}`, and for each
stream, with its id, what the lines of a stream over HTTP contain.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from aiorts.control import Operation
from aiorts.errors import AiortsError, RecordError
from aiorts_studio.kernels import Visitor, entry_of, lines_of
from aiorts_studio.offered import asked_in, patience
from aiorts_studio.plain.problems import HttpError, problem_of
from aiorts_studio.plain.values import LARGEST, json_in, json_out

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from aiorts_studio.api import Api

GREETING_SECONDS: Final = 5.0
"""Seconds within which a client has to send its token."""
STRANGERS: Final = 32
"""The most WebSockets that have sent no token; for another the oldest gives way."""
CREDIT: Final = 4_096
"""The most items that a stream may send beyond those that its client has taken."""
REFUSED: Final = 1008
"""The status of a WebSocket that is refused."""
OVER: Final = 1001
"""The status of a WebSocket that has ended."""


class Sockets:
    """The WebSockets of one server."""

    def __init__(self, api: Api) -> None:
        self._api = api
        self._strangers: dict[asyncio.Task[Any], None] = {}
        self._by_client: dict[int, asyncio.Event] = {}

    async def attend(self, socket: WebSocket) -> None:
        """Serve one WebSocket until it ends."""
        await socket.accept()
        try:
            visitor = await self.greeted(socket)
        except AiortsError as error:
            await close(socket, REFUSED, str(error))
            return
        if visitor is not None:
            await self._carry(socket, visitor)

    async def greeted(self, socket: WebSocket) -> Visitor | None:
        """Wait for a client's token, and return the client; None: it has gone. HttpError: it sends no token."""
        asking = asyncio.create_task(socket.receive())
        self._strangers[asking] = None
        try:
            if len(self._strangers) > STRANGERS:
                first = next(iter(self._strangers))
                del self._strangers[first]  # it ends later, and more may come until then
                first.cancel()
            await asyncio.wait((asking,), timeout=GREETING_SECONDS)
        finally:
            self._strangers.pop(asking, None)
            gives_way = asking.cancelled()
            asking.cancel()
        if gives_way or not asking.done():
            why = "gave way to those that came after it" if gives_way else "said no token"
            raise HttpError(401, "E-DENIED", why)
        message = asking.result()
        if message["type"] == "websocket.disconnect":
            return None
        said = said_in(message)
        token = said.get("token")
        return self._api.visitor(token if isinstance(token, str) else "")

    async def _carry(self, socket: WebSocket, visitor: Visitor) -> None:
        number, replaced = visitor.holder.number, asyncio.Event()
        if (before := self._by_client.get(number)) is not None:
            before.set()  # a client that vanished, or a page that was opened twice
        self._by_client[number] = replaced
        try:
            await visitor.work(_Carrier(self._api, socket, visitor).carry(), replaced.wait)
        finally:
            if self._by_client.get(number) is replaced:
                del self._by_client[number]
        await close(socket, OVER, "the token has ended" if visitor.closed else "another has come in its place")


class _Credit:
    """The number of items that a client takes."""

    def __init__(self, items: int) -> None:
        self._left = items
        self._more = asyncio.Event()

    def add(self, items: int) -> None:
        """Add items that the client takes."""
        self._left = min(self._left + items, CREDIT)
        self._more.set()

    async def take(self) -> None:
        """Wait until the client takes an item."""
        while not self._left:
            self._more.clear()
            await self._more.wait()
        self._left -= 1


class _Carrier:
    """The streams of one WebSocket."""

    def __init__(self, api: Api, socket: WebSocket, visitor: Visitor) -> None:
        self._api, self._socket, self._visitor = api, socket, visitor
        self._streams: dict[int, tuple[asyncio.Task[None], _Credit]] = {}

    async def carry(self) -> None:
        """Carry out the client's messages until it goes."""
        await self._say({"right": self._api.right.value})
        async with asyncio.TaskGroup() as group:
            try:
                while (message := await self._socket.receive())["type"] != "websocket.disconnect":
                    try:
                        self._visitor.requests.fill(time.monotonic())
                        self._do(group, said_in(message))
                    except AiortsError as error:
                        await self._say({"problem": problem_of(error)})
            finally:
                for task, _ in self._streams.values():
                    task.cancel()

    def _do(self, group: asyncio.TaskGroup, said: Mapping[str, Any]) -> None:
        """Carry out a message; AiortsError: the message is unknown."""
        if "subscribe" in said:
            number = whole(said, "subscribe")
            if number in self._streams:
                raise HttpError(409, "E-BUSY", f"a stream has the id {number} already")
            kernel, operation, arguments = asked_in(said, "subscribe", self._api.right)
            if not operation.streams:
                raise RecordError(f"{operation.name}: does not stream; ask for it with POST")
            credit = _Credit(min(whole(said, "credit"), CREDIT))
            running = group.create_task(self._stream(number, kernel, operation, arguments, credit))
            self._streams[number] = running, credit
        elif "unsubscribe" in said:
            number = whole(said, "unsubscribe")
            self._stream_of(number)[0].cancel()
            del self._streams[number]  # a task that has not begun would not do it
        elif "credit" in said:
            self._stream_of(whole(said, "credit"))[1].add(whole(said, "items"))
        else:
            raise RecordError("expected subscribe, unsubscribe or credit")

    def _stream_of(self, number: int) -> tuple[asyncio.Task[None], _Credit]:
        if number not in self._streams:
            raise HttpError(404, "E-ABSENT", f"{number}: no such stream; it may have ended")
        return self._streams[number]

    async def _stream(
        self, number: int, kernel: str, operation: Operation, arguments: Mapping[str, Any], credit: _Credit
    ) -> None:
        try:
            entry = await entry_of(kernel)
            with self._api.under_way.one(self._visitor.holder.number, entry.address):
                client = await self._visitor.session(entry)
                wait = patience(operation, arguments)
                async with client.stream(operation.name, wait, **arguments) as stream:
                    async for said in lines_of(stream, credit.take):
                        await self._say({"id": number, **said})
        except AiortsError as error:
            await self._say({"id": number, "problem": problem_of(error)})
        finally:
            if self._streams.get(number, (None, None))[1] is credit:  # not the next stream with this id
                del self._streams[number]

    async def _say(self, message: Mapping[str, Any]) -> None:
        from starlette.websockets import WebSocketDisconnect

        with suppress(WebSocketDisconnect):  # the reading side notices it
            await self._socket.send_text(json_out(message).decode())


def said_in(message: Mapping[str, Any]) -> dict[str, Any]:
    """The object in a client's message; RecordError: there is none."""
    text = message.get("text")
    value = json_in(text) if text is not None else None
    if not isinstance(value, dict):
        raise RecordError("expected an object, as text")
    return value


def whole(said: Mapping[str, Any], name: str) -> int:
    """The whole number of this name in a message; RecordError: there is none."""
    value = said.get(name)
    if type(value) is not int or not 0 <= value <= LARGEST:
        raise RecordError(f"{name}: expected a whole number")
    return value


async def close(socket: WebSocket, code: int, why: str) -> None:
    """Close a WebSocket with the reason; one that is closed stays so."""
    from starlette.websockets import WebSocketDisconnect

    with suppress(WebSocketDisconnect, RuntimeError):  # it is closed already
        await socket.close(code, why[:100])
