"""The WebSocket of one page: what it says is done, and what it is to be told is sent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, RecordError
from aiorts_studio.kernels import Visitor, entry_of
from aiorts_studio.offered import check_names, operation_of, patience
from aiorts_studio.problems import HttpError, problem_of
from aiorts_studio.socket import OVER, REFUSED, Sockets, close, said_in, whole
from aiorts_studio.values import json_out
from aiorts_studio.watching.page import Page
from aiorts_studio.watching.studio import PAGES, Studio

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from aiorts_studio.api import Api

_CALLS: Final = 16
"""Calls of one page that may be under way."""


class PageSockets:
    """The WebSockets of the pages of one server."""

    def __init__(self, api: Api, sockets: Sockets, studio: Studio) -> None:
        self._api, self._sockets, self._studio = api, sockets, studio

    async def attend(self, socket: WebSocket) -> None:
        """Serve one page until it goes."""
        await socket.accept()
        try:
            visitor = await self._sockets.greeted(socket)
            if len(self._studio.pages) >= PAGES:
                raise HttpError(429, "E-BUSY", f"{PAGES} pages are open already; close one")
        except AiortsError as error:
            await close(socket, REFUSED, str(error))
            return
        if visitor is not None:
            gone = asyncio.Event()
            await visitor.work(_PageSocket(self._api, self._studio, socket, visitor).carry(), gone.wait)
            await close(socket, OVER, "the token has ended" if visitor.closed else "")


class _PageSocket:
    """One page."""

    def __init__(self, api: Api, studio: Studio, socket: WebSocket, visitor: Visitor) -> None:
        self._api, self._studio, self._socket, self._visitor = api, studio, socket, visitor
        self._page = Page()
        self._calls: set[asyncio.Task[None]] = set()

    async def carry(self) -> None:
        """Do what the page says, and send what it is told, until it goes."""
        page = self._page
        page.put({"t": "hello", "right": self._api.right.value, "files": False, "period": 0.2})
        sending = asyncio.create_task(self._send(), name="studio page")
        try:
            await self._studio.join(page)
            while (message := await self._socket.receive())["type"] != "websocket.disconnect":
                try:
                    self._visitor.requests.fill(time.monotonic())
                    self._do(said_in(message))
                except AiortsError as error:
                    page.put({"t": "problem", "problem": problem_of(error)})
        finally:
            for task in (sending, *self._calls):
                task.cancel()
            await self._studio.leave(page)

    async def _send(self) -> None:
        from starlette.websockets import WebSocketDisconnect

        page = self._page
        with suppress(WebSocketDisconnect, RuntimeError):  # the end that reads notices
            while True:
                text = await page.next()
                if text is None:
                    text = json_out({**self._studio.scene.picture(), "missed": page.renew()}).decode()
                await self._socket.send_text(text)

    def _do(self, said: Mapping[str, Any]) -> None:
        """Do what the page says; AiortsError: it says nothing that is known."""
        match said.get("t"):
            case "view":
                self._studio.see(self._page, _rect(said.get("rect")), _number(said.get("scale"), "scale"))
            case "ask":
                number = whole(said, "id")
                if len(self._calls) >= _CALLS:
                    raise HttpError(429, "E-BUSY", f"{_CALLS} calls of this page are under way already")
                call = asyncio.create_task(self._ask(number, said), name="studio call")
                self._calls.add(call)
                call.add_done_callback(self._calls.discard)
            case "tidy":
                self._studio.tidy()
            case kind:
                raise RecordError(f"{kind!s:.40}: nothing that a page says")

    async def _ask(self, number: int, said: Mapping[str, Any]) -> None:
        answer: dict[str, Any] = {"t": "told", "id": number}
        try:
            kernel, name, arguments = said.get("kernel"), said.get("operation"), said.get("arguments", {})
            if not (isinstance(kernel, str) and isinstance(name, str) and isinstance(arguments, dict)):
                raise RecordError("ask: expected kernel and operation, and arguments as an object")
            operation = operation_of(name, self._api.right)
            check_names(operation, arguments)
            if operation.streams:
                raise RecordError(f"{name}: streams; ask for it at /api/socket")
            entry = await entry_of(kernel)
            with self._api.under_way.one(self._visitor.holder.number, entry.address):
                client = await self._visitor.session(entry)
                answer["value"] = await client.call(name, patience(operation, arguments), **arguments)
        except AiortsError as error:
            answer["problem"] = {"code": error.code, "text": str(error)}
        self._page.put(answer)


def _rect(value: Any) -> tuple[float, float, float, float]:
    if not isinstance(value, list) or len(value) != 4:
        raise RecordError("rect: expected left, top, right and bottom")
    left, top, right, bottom = (_number(one, "rect") for one in value)
    return left, top, right, bottom


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise RecordError(f"{name}: expected a number")
    return float(value)
