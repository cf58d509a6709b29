"""Checks of every request, and headers of every answer: a layer of ASGI around all that is served.

Any page of a browser may send requests to this machine. Its Origin says which page it is; the Host says by which name
it came, which is another than this machine's when a page has its own name lead here (DNS rebinding).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping, MutableMapping, Sequence
from types import MappingProxyType
from typing import Any, Final

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
"""Bytes of a request without a token, which has a code in it at most."""
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


def hosts_of(scheme: str, names: Sequence[str], port: int) -> tuple[str, ...]:
    """The values of the header `Host` that name a server, that of its own address first."""
    hosts = [f"[{one}]" if ":" in one else one for one in names]
    return (*(f"{one}:{port}" for one in hosts), *(hosts if port == _USUAL[scheme] else ()))


def refusal(
    hosts: Sequence[str], origins: Sequence[str], ours: Collection[str], scheme: str, *, needs_origin: bool
) -> str:
    """Why a request with these headers is not answered; "" for one that is.

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
    """Refuses what no page or program of this server sends, before anything else sees it.

    Args:
        app: what is served.
        scheme: "http" or "https".
        ours: the values of the header `Host` that name this server.
        most: says how many bytes a request may have; HttpError: it is not answered.
    """

    def __init__(self, app: App, scheme: str, ours: Collection[str], most: Callable[[Scope], int]) -> None:
        self._app = app
        self._scheme, self._ours, self._most = scheme, ours, most

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or have the application answer it."""
        if scope["type"] == "websocket":
            await self._attend(scope, receive, send)
            return
        send = _with_headers(send)
        refused: HttpError | None = None
        most, body = 0, b""
        try:
            self._check(scope, needs_origin=scope["path"] == EXCHANGE and scope["method"] == "POST")
            most = self._most(scope)
        except HttpError as error:
            refused = error
        try:
            body = await _body(receive, most)
        except HttpError as error:
            refused = refused or error
        if refused is not None:
            await answer(send, refused)
            return
        await self._app(scope, _again(body, receive), send)

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


async def _body(receive: Receive, most: int) -> bytes:
    """The whole body of a request. HttpError: it is too large, or does not come.

    The rest of one that is too large is read, up to a limit, and dropped: a client that still sends when the connection
    is closed may lose the answer.
    """
    body, size, more, late = bytearray(), 0, True, False
    try:
        async with asyncio.timeout(BODY_SECONDS):
            while more and size <= most + LARGE_BODY:
                message = await receive()
                part = message.get("body", b"")
                size += len(part)
                body += part if size <= most else b""
                more = message.get("more_body", False)
    except TimeoutError:
        late = True
    if size > most:
        raise HttpError(413, "E-TOO-LARGE", f"the request is longer than {most / 1024:g} KiB")
    if late:
        raise HttpError(408, "E-NO-ANSWER", f"the request was not whole after {BODY_SECONDS:.0f} s")
    return bytes(body)


async def answer(send: Send, error: HttpError) -> None:
    """Answer a request with an error, and take no other over its connection."""
    headers = {"content-type": "application/problem+json", "connection": "close", **error.headers}
    encoded = [(name.encode(), value.encode()) for name, value in headers.items()]
    await send({"type": "http.response.start", "status": status_of(error), "headers": encoded})
    await send({"type": "http.response.body", "body": json_out(problem_of(error))})


def _again(body: bytes, receive: Receive) -> Receive:
    """Gives the body that was taken, then what comes after it."""
    taken = False

    async def again() -> Message:
        nonlocal taken
        if taken:
            return await receive()
        taken = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _with_headers(send: Send) -> Send:
    added = [(name.encode(), value.encode()) for name, value in HEADERS.items()]

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *added]}
        await send(message)

    return sending
