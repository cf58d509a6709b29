"""The WebSocket of one page: its requests are carried out, and its messages are sent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import SLOW_READER_BURSTS, SLOW_READER_CURES, AbsentError, AiortsError, RecordError
from aiorts_studio.kernels import Visitor, entry_of
from aiorts_studio.offered import asked_in, patience
from aiorts_studio.plain.problems import HttpError, problem_of
from aiorts_studio.plain.values import json_out
from aiorts_studio.socket import OVER, REFUSED, Sockets, close, said_in, whole
from aiorts_studio.watching.feeds import EventFeed, Feed, LogFeed
from aiorts_studio.watching.page import Page
from aiorts_studio.watching.plots import FASTEST, Shown
from aiorts_studio.watching.studio import Studio
from aiorts_studio.watching.watch import begun

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from aiorts_studio.api import Api

PAGES: Final = 16
"""The most pages at once."""
_CALLS: Final = 16
"""Calls of one page that may be under way."""
_WATCHES: Final = 32
"""Ports whose values one page may be shown."""
_PORTS: Final = 64
"""The most ports of one recording."""
_FARTHEST: Final = 1e9
"""The largest number that a page may send: a place, a scale or a rate."""
_FIELDS: Final = 16
"""Fields of one port that may be shown."""


class PageSockets:
    """The WebSockets of the pages of one server."""

    def __init__(self, api: Api, sockets: Sockets, studio: Studio) -> None:
        self._api, self._sockets, self._studio = api, sockets, studio
        self._open = 0

    async def attend(self, socket: WebSocket) -> None:
        """Serve one page until it goes."""
        await socket.accept()
        try:
            visitor = await self._sockets.greeted(socket)
            if self._open >= PAGES:
                raise HttpError(429, "E-BUSY", f"{PAGES} pages are open already; close one")
        except AiortsError as error:
            await close(socket, REFUSED, str(error))
            return
        if visitor is not None:
            gone = asyncio.Event()
            self._open += 1
            try:
                await visitor.work(_PageSocket(self._api, self._studio, socket, visitor).carry(), gone.wait)
            finally:
                self._open -= 1
            await close(socket, OVER, self._api.ends or ("the token has ended" if visitor.closed else ""))


class _PageSocket:
    """One page."""

    def __init__(self, api: Api, studio: Studio, socket: WebSocket, visitor: Visitor) -> None:
        self._api, self._studio, self._socket, self._visitor = api, studio, socket, visitor
        self._page = Page()
        self._calls: set[asyncio.Task[None]] = set()
        self._feeds: dict[str, Feed] = {}
        self._shown: dict[int, tuple[str, str, Shown]] = {}
        self._events_until = 0
        """The time until which the page was sent events, in ns."""

    async def carry(self) -> None:
        """Carry out the page's requests, and send its messages, until it goes."""
        page = self._page
        page.put(
            {
                "t": "hello", "right": self._api.right.value, "files": self._studio.recorder.can_record, "period": 0.2,
                "cures": SLOW_READER_CURES, "bursts": SLOW_READER_BURSTS,
            }
        )  # fmt: skip
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
            for kind in tuple(self._feeds):
                self._follow(kind, None)
            for number in tuple(self._shown):
                self._unwatch(number)
            await self._studio.leave(page)

    async def _send(self) -> None:
        from starlette.websockets import WebSocketDisconnect

        page = self._page
        with suppress(WebSocketDisconnect, RuntimeError):  # the reading side notices it
            while True:
                text = await page.next()
                if text is None:
                    text = json_out({**self._studio.scene.picture(), "missed": page.renew()}).decode()
                await self._socket.send_text(text)

    def _do(self, said: Mapping[str, Any]) -> None:
        """Carry out a request of the page; AiortsError: the request is unknown."""
        match said.get("t"):
            case "view":
                self._studio.see(self._page, _rect(said.get("rect")), _number(said.get("scale"), "scale"))
            case "ask":
                number = whole(said, "id")
                if len(self._calls) >= _CALLS:
                    raise HttpError(429, "E-BUSY", f"{_CALLS} calls of this page are under way already")
                self._run(self._ask(number, said))
            case "tidy":
                self._studio.tidy()
            case "move":
                self._studio.move(whole(said, "id"), _number(said.get("x"), "x"), _number(said.get("y"), "y"))
            case "fold":
                self._studio.fold(whole(said, "id"), on=said.get("on") is True)
            case "infrastructure":
                pass  # the page itself hides it
            case "record":
                self._record(said)
            case "log":
                self._follow(
                    "log",
                    LogFeed(self._page, *_words(said, "kernel", "level", "component")) if said.get("on") else None,
                )
            case "events":
                self._events(on=said.get("on") is True)
            case "measure":
                self._studio.measure(self._page, _edges(said.get("edges")), on=said.get("on") is True)
            case "watch":
                self._watch(whole(said, "id"), said)
            case "unwatch":
                self._unwatch(whole(said, "id"))
            case kind:
                raise RecordError(f"{kind!s:.40}: nothing that a page says")

    def _events(self, *, on: bool) -> None:
        """Send events to the page, first the changes of the last minute that it has missed; or stop sending events."""
        if not on:
            if "events" in self._feeds:
                self._follow("events", None)
                self._events_until = time.time_ns()
        elif "events" not in self._feeds:
            self._page.put({"t": "history", "items": self._studio.changes_since(self._events_until)})
            self._follow("events", EventFeed(self._page))

    def _record(self, said: Mapping[str, Any]) -> None:
        recorder = self._studio.recorder
        if not said.get("on"):
            recorder.end()
            return
        ports = said.get("ports")
        if not isinstance(ports, list) or not 0 < len(ports) <= _PORTS:
            raise RecordError(f"ports: expected 1 to {_PORTS} pairs of kernel and port")
        pairs = [(kernel, path) for kernel, path in map(_pair, ports)]
        for kernel, path in pairs:
            self._studio.scene.check_port(kernel, path)
        self._run(self._begin_recording(pairs))

    async def _begin_recording(self, ports: list[tuple[str, str]]) -> None:
        recorder = self._studio.recorder
        try:
            await recorder.begin(ports)
        except AiortsError as error:
            self._page.put(recorder.state(str(error)))

    def _run(self, work: Coroutine[Any, Any, None]) -> None:
        task = begun(work, "studio call")
        self._calls.add(task)
        task.add_done_callback(self._calls.discard)

    def _follow(self, kind: str, feed: Feed | None) -> None:
        """Follow a feed, which replaces the earlier feed of its kind."""
        if (before := self._feeds.pop(kind, None)) is not None:
            self._studio.unfollow(before)
        if feed is not None:
            self._feeds[kind] = feed
            self._studio.follow(feed)

    def _watch(self, number: int, said: Mapping[str, Any]) -> None:
        self._unwatch(number)
        if len(self._shown) >= _WATCHES:
            raise HttpError(429, "E-BUSY", f"{_WATCHES} ports are shown on this page already")
        kernel, path = _words(said, "kernel", "path")
        fields = said.get("fields", [])
        if not isinstance(fields, list) or len(fields) > _FIELDS or not all(isinstance(one, str) for one in fields):
            raise RecordError(f"fields: expected at most {_FIELDS} texts")
        rate = min(max(_number(said.get("columns_per_s", 10.0), "columns_per_s"), 0.1), FASTEST)
        shown = Shown(self._page, number, fields, rate)
        try:
            self._studio.show(kernel, path, shown)
        except AbsentError as error:
            shown.fail(error)
        else:
            self._shown[number] = kernel, path, shown

    def _unwatch(self, number: int) -> None:
        if number in self._shown:
            self._studio.hide(*self._shown.pop(number))

    async def _ask(self, number: int, said: Mapping[str, Any]) -> None:
        answer: dict[str, Any] = {"t": "answer", "id": number}
        try:
            kernel, operation, arguments = asked_in(said, "ask", self._api.right)
            if operation.streams:
                raise RecordError(f"{operation.name}: streams; ask for it at /api/socket")
            entry = await entry_of(kernel)
            with self._api.under_way.one(self._visitor.holder.number, entry.address):
                client = await self._visitor.session(entry)
                answer["value"] = await client.call(operation.name, patience(operation, arguments), **arguments)
        except AiortsError as error:
            answer["problem"] = {"code": error.code, "text": str(error)}
        self._page.put(answer)


def _rect(value: Any) -> tuple[float, float, float, float]:
    if not isinstance(value, list) or len(value) != 4:
        raise RecordError("rect: expected left, top, right and bottom")
    left, top, right, bottom = (_number(one, "rect") for one in value)
    return left, top, right, bottom


def _edges(value: Any) -> frozenset[int]:
    if not isinstance(value, list) or len(value) > _PORTS or not all(type(one) is int for one in value):
        raise RecordError(f"edges: expected at most {_PORTS} numbers")
    return frozenset(value)


def _number(value: Any, name: str) -> float:
    if type(value) not in (int, float) or not -_FARTHEST <= value <= _FARTHEST:
        raise RecordError(f"{name}: expected a number")
    return float(value)


def _words(said: Mapping[str, Any], *names: str) -> tuple[str, ...]:
    """The texts of these names; "" where there is none."""
    words = tuple(said.get(name, "") for name in names)
    if not all(isinstance(word, str) for word in words):
        raise RecordError(f"{', '.join(names)}: expected texts")
    return words


def _pair(value: Any) -> tuple[str, str]:
    if not isinstance(value, list) or len(value) != 2 or not all(isinstance(one, str) for one in value):
        raise RecordError("ports: expected pairs of kernel and port")
    return value[0], value[1]
