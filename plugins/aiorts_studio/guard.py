"""Checks of every request, and headers of every answer: a layer of ASGI around all that is served.

Any page of a browser may send requests to this machine. The header Origin names the page; Host has the name by which
it came, which is not this machine's when the page's own name leads here (DNS rebinding).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping, MutableMapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from aiorts_studio.plain.problems import HttpError, problem_of, status_of
from aiorts_studio.plain.values import json_out

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

HEADERS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "content-security-policy": (
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob:; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
        "cross-origin-resource-policy": "same-origin",
        "cross-origin-opener-policy": "same-origin",
        "cache-control": "no-store",
    }
)
"""The headers of every answer."""
STRANGERS_BODY: Final = 1 << 10
"""Bytes of a request without a token, which has at most a code in it."""
BODY: Final = 64 << 10
"""Bytes of a request."""
LARGE_BODY: Final = 512 << 10
"""Bytes of a request that has the text of a file in it."""
BODY_SECONDS: Final = 10.0
"""Seconds within which a request has to be there whole."""
EXCHANGE: Final = "/api/token"
"""The path at which a code is exchanged for a token."""
_CLOSED: Final = 1008
"""The status of a WebSocket that is refused: it breaks a policy."""
_USUAL: Final[Mapping[str, int]] = MappingProxyType({"http": 80, "https": 443})
"""The ports that a browser leaves out."""


class Admission(NamedTuple):
    """The limits of a request that is to be read."""

    most: int
    """Bytes that the request may have."""
    take: Callable[[int], object]
    """Called with the number of bytes that come, before they are kept; HttpError: they are refused."""


def hosts_of(scheme: str, names: Sequence[str], port: int) -> tuple[str, ...]:
    """The values of the header `Host` that name a server, its own address first."""
    hosts = [f"[{one}]" if ":" in one else one for one in names]
    return (*(f"{one}:{port}" for one in hosts), *(hosts if port == _USUAL[scheme] else ()))


def refusal(
    hosts: Sequence[str], origins: Sequence[str], ours: Collection[str], scheme: str, *, needs_origin: bool
) -> str:
    """The reason why a request with these headers is refused; "" for none.

    Args:
        hosts: the values of all headers `Host`.
        origins: the values of all headers `Origin`.
        ours: the values of `Host` that name this server.
        scheme: "http" or "https".
        needs_origin: whether the Origin may not be absent.
    """
    if len(hosts) != 1 or hosts[0] not in ours:
        return f"Host: expected {' or '.join(sorted(ours))}"
    if not origins and not needs_origin:
        return ""
    if len(origins) != 1 or origins[0] != f"{scheme}://{hosts[0]}":
        return f"Origin: expected {scheme}://{hosts[0]}"
    return ""


class Guard:
    """Refuses requests that no page or program of this server sends, before the application sees them.

    Args:
        app: the application that is served.
        scheme: "http" or "https".
        ours: the values of the header `Host` that name this server.
        admit: admits a request by its head until it is answered; HttpError: it is refused.
    """

    def __init__(
        self,
        app: App,
        scheme: str,
        ours: Collection[str],
        admit: Callable[[Scope], AbstractContextManager[Admission]],
    ) -> None:
        self._app = app
        self._scheme, self._ours, self._admit = scheme, ours, admit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or pass it to the application."""
        if scope["type"] == "websocket":
            await self._attend(scope, receive, send)
            return
        send = _with_headers(send)
        coming = _Coming(receive)
        with ExitStack() as open_:
            try:
                self._check(scope, needs_origin=scope["path"] == EXCHANGE and scope["method"] == "POST")
                body = await coming.whole(open_.enter_context(self._admit(scope)))
            except HttpError as error:
                refused = error
            else:
                await self._app(scope, _again(body, receive), send)
                return
        await answer(send, refused, more=True)
        await coming.drop()
        await send({"type": "http.response.body"})

    async def _attend(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            self._check(scope, needs_origin=True)
        except HttpError as error:
            await receive()
            await send({"type": "websocket.close", "code": _CLOSED, "reason": str(error)[:100]})
            return
        await self._app(scope, receive, send)

    def _check(self, scope: Scope, *, needs_origin: bool) -> None:
        headers: Sequence[tuple[bytes, bytes]] = scope["headers"]
        hosts = [value.decode("latin-1") for name, value in headers if name == b"host"]
        origins = [value.decode("latin-1") for name, value in headers if name == b"origin"]
        if why := refusal(hosts, origins, self._ours, self._scheme, needs_origin=needs_origin):
            raise HttpError(403, "E-DENIED", why)
        if scope["query_string"]:
            text = "a request has no query here; a token goes into the header `Authorization`, and into no address"
            raise HttpError(400, "E-RECORD", text)


class _Coming:
    """The body of a request, as it comes."""

    def __init__(self, receive: Receive) -> None:
        self._receive = receive
        self._more = True
        """Whether there may be more of the body."""

    async def whole(self, admission: Admission) -> bytes:
        """The whole body. HttpError: it is too large, or does not come."""
        body = bytearray()
        try:
            async with asyncio.timeout(BODY_SECONDS):
                while self._more:
                    part = await self._part()
                    if len(body) + len(part) > admission.most:
                        raise HttpError(413, "E-TOO-LARGE", f"the request is longer than {admission.most / 1024:g} KiB")
                    admission.take(len(part))
                    body += part
        except TimeoutError:
            raise HttpError(408, "E-NO-ANSWER", f"the request was not whole after {BODY_SECONDS:.0f} s") from None
        return bytes(body)

    async def drop(self) -> None:
        """Read the rest of the body, up to a limit, and discard it.

        A client that still sends when the connection is closed may lose the answer.
        """
        left = 2 * LARGE_BODY
        with suppress(TimeoutError, HttpError):
            async with asyncio.timeout(BODY_SECONDS):
                while self._more and left > 0:
                    left -= len(await self._part())

    async def _part(self) -> bytes:
        message = await self._receive()
        if message["type"] == "http.disconnect":
            raise HttpError(400, "E-RECORD", "the client has gone before its request was whole")
        self._more = message.get("more_body", False)
        part: bytes = message.get("body", b"")
        return part


async def answer(send: Send, error: HttpError, *, more: bool = False) -> None:
    """Answer a request with an error, and take no other over its connection.

    Args:
        more: the end of the answer is left to the caller: the connection stays open until then.
    """
    body = json_out(problem_of(error))
    headers = {"content-type": "application/problem+json", "connection": "close", **error.headers}
    headers["content-length"] = str(len(body))  # so that the answer is whole before its end
    encoded = [(name.encode(), value.encode()) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": status_of(error), "headers": encoded})
    await send({"type": "http.response.body", "body": body, "more_body": more})


def _again(body: bytes, receive: Receive) -> Receive:
    """A `receive` that gives the body that was taken, then the messages after it."""
    taken = [body]

    async def again() -> Message:
        return {"type": "http.request", "body": taken.pop(), "more_body": False} if taken else await receive()

    return again


def _with_headers(send: Send) -> Send:
    added = [(name.encode(), value.encode()) for name, value in HEADERS.items()]

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *added]}
        await send(message)

    return sending
