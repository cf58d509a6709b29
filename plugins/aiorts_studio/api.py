"""Answers requests: for operations of kernels, the kernels that run, tokens, and the description of the API."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from anyio import to_thread

from aiorts.control import Operation, Right
from aiorts.errors import AiortsError, ClosedError, RecordError
from aiorts.sessions import Entry
from aiorts_studio.codes import Codes, Holder
from aiorts_studio.guard import (
    BODY,
    EXCHANGE,
    LARGE_BODY,
    STRANGERS_BODY,
    Admission,
    App,
    Guard,
    Receive,
    Scope,
    Send,
    answer,
)
from aiorts_studio.kernels import Visitor, entry_of, lines_of, running
from aiorts_studio.offered import LARGE, check_names, operation_of, patience
from aiorts_studio.openapi import document, page
from aiorts_studio.plain.limits import Open, UnderWay
from aiorts_studio.plain.problems import HttpError, problem_of, status_of
from aiorts_studio.plain.values import json_in, json_out
from aiorts_studio.watching.studio import Studio

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

JSON: Final = "application/json"
LINES: Final = "application/x-ndjson"
PAGE: Final = Path(__file__).parent / "page"
"""The folder of the page that shows what runs."""
PAGES: Final = MappingProxyType(
    {
        ".css": "text/css",
        ".html": "text/html",
        ".js": "text/javascript",
        ".json": JSON,
        ".png": "image/png",
        ".svg": "image/svg+xml",
    }
)
"""The media types of the files that pages are made of, by the endings of their names."""
_STYLE: Final = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem }
:root { color-scheme: light dark }
pre { overflow-x: auto; padding: .5rem; border: 1px solid }
h2 { font-size: 1.1rem; margin-top: 2rem }
"""


class Api:
    """The application of one server: everything that it answers.

    Args:
        scheme, ours: as `Guard` takes them.
        right: the right that tokens give.
        say: shows a line to the user who started the server.
        pages: files of the user's own pages, by their names in the address.
        studio: the content of the page; all kernels of this user by default.

    Attributes:
        exchanged: called when a code was exchanged.
        ends: the reason why the server ends; "" while it does not.
    """

    def __init__(
        self,
        scheme: str,
        ours: Sequence[str],
        right: Right,
        say: Callable[[str], None],
        pages: Mapping[str, Path] = MappingProxyType({}),
        studio: Studio | None = None,
    ) -> None:
        self.right = right
        self._pages = pages
        self.codes = Codes(self._ended)
        self.under_way = UnderWay()
        self._open = Open()
        self.exchanged: Callable[[], object] = _ignore
        self.ends = ""
        self._say = say
        self.studio = studio or Studio()
        self._visitors: dict[Holder, Visitor] = {}
        self._endings: set[asyncio.Task[None]] = set()
        self._described = document(right, f"{scheme}://{ours[0]}")
        self.app: App = Guard(self._routed(), scheme, ours, self._admit)

    def _routed(self) -> App:
        from starlette.applications import Starlette
        from starlette.exceptions import HTTPException
        from starlette.responses import HTMLResponse, Response
        from starlette.routing import Route, WebSocketRoute

        from aiorts_studio.page_socket import PageSockets
        from aiorts_studio.socket import Sockets

        def fixed(answer: Callable[[], Response]) -> Callable[[Request], Response]:
            return lambda request: answer()

        docs, sockets = page(self._described), Sockets(self)
        app = Starlette(
            routes=[
                Route("/", self._file),
                Route("/docs", fixed(lambda: HTMLResponse(docs))),
                Route("/docs.css", fixed(lambda: Response(_STYLE, media_type="text/css"))),
                Route("/openapi.json", fixed(lambda: _json(self._described))),
                Route("/pages/{name}", self._page),
                Route(EXCHANGE, self._exchange, methods=["POST"]),
                Route(EXCHANGE, self._end_token, methods=["DELETE"]),
                Route("/api/kernels", self._kernels),
                Route("/api/kernels/{kernel:path}/{operation}", self._operate, methods=["POST"]),
                WebSocketRoute("/api/socket", sockets.attend),
                WebSocketRoute("/api/page", PageSockets(self, sockets, self.studio).attend),
                *(Route(f"/{name}", self._file) for name in _page_files()),
            ],
            exception_handlers={AiortsError: _problem, HTTPException: _http_problem},
        )
        app.router.redirect_slashes = False
        return app

    async def _page(self, request: Request) -> Response:
        from starlette.responses import Response

        name = request.path_params["name"]
        if name not in self._pages:
            raise HttpError(404, "E-ABSENT", f"/pages/{name:.80}: there is none")
        path = self._pages[name]
        try:
            content = await to_thread.run_sync(path.read_bytes)
        except OSError as error:
            raise HttpError(404, "E-ABSENT", f"/pages/{name}: {error.strerror}") from None
        return Response(content, media_type=PAGES[path.suffix])

    async def _file(self, request: Request) -> Response:
        """The response with a file of the page that shows what runs."""
        from starlette.responses import Response

        name = request.url.path[1:]
        path, headers = _page_files()[name or "index.html"], None if name else {"link": _modules()}
        return Response(await to_thread.run_sync(path.read_bytes), headers=headers, media_type=PAGES[path.suffix])

    # -- tokens ----------------------------------------------------------------------------------------------------

    def visitor(self, token: str) -> Visitor:
        """The client with this token; HttpError: there is no such token, or the client asks too often."""
        now = time.monotonic()
        holder = self.codes.holder(token, now) if token else None
        if holder is None:
            text = "the token is none, or has ended" if token else "the header `Authorization: Bearer TOKEN` is missing"
            raise HttpError(401, "E-DENIED", text, {"www-authenticate": "Bearer"})
        visitor = self._visitors.setdefault(holder, Visitor(holder, self.right))
        visitor.requests.fill(now)
        return visitor

    @contextmanager
    def _admit(self, scope: Scope) -> Iterator[Admission]:
        """Admit a request, with its client in `scope`; HttpError: a needed token is missing, or it asks too much."""
        from starlette.datastructures import Headers

        path: str = scope["path"]
        if not path.startswith("/api/") or (path == EXCHANGE and scope["method"] == "POST"):
            yield Admission(STRANGERS_BODY, _ignore)
            return
        scope["visitor"] = visitor = self.visitor(_token(Headers(scope=scope)))
        with self._open.one(visitor.holder.number) as take:
            yield Admission(LARGE_BODY if path.rpartition("/")[2] in LARGE else BODY, take)

    async def _exchange(self, request: Request) -> Response:
        given = await _object(request)
        if given.keys() != {"code"} or not isinstance(given["code"], str):
            raise RecordError('expected {"code": "..."}')
        token = self.codes.exchange(given["code"], time.monotonic())
        self.exchanged()
        return _json({"token": token, "right": self.right.value})

    async def _end_token(self, request: Request) -> Response:
        from starlette.responses import Response

        self.codes.end(_visitor(request).holder)
        return Response(status_code=204)

    def _ended(self, holder: Holder, why: str) -> None:
        if why:
            self._say(f"client {holder.number}: its token has ended: {why}")
        visitor = self._visitors.pop(holder, None)
        if visitor is not None:
            ending = asyncio.ensure_future(visitor.close())
            self._endings.add(ending)
            ending.add_done_callback(self._endings.discard)

    async def close(self, why: str = "") -> None:
        """End all tokens, and the calls and streams of their clients, which are told why."""
        self.ends = why
        self.codes.end_all()
        await self.studio.close()
        if self._endings:
            await asyncio.wait(self._endings)

    # -- kernels ---------------------------------------------------------------------------------------------------

    async def _kernels(self, request: Request) -> Response:
        return _json([asdict(one) for one in await running()])

    async def _operate(self, request: Request) -> Answer:
        visitor = _visitor(request)
        operation = operation_of(request.path_params["operation"], self.right)
        arguments = await _object(request)
        check_names(operation, arguments)
        entry = await entry_of(request.path_params["kernel"])
        return Answer(self, visitor, entry, operation, arguments)


class Answer:
    """The answer of a kernel: one document, or lines for as long as the client takes them."""

    def __init__(
        self, api: Api, visitor: Visitor, entry: Entry, operation: Operation, arguments: Mapping[str, Any]
    ) -> None:
        self._api, self._visitor = api, visitor
        self._entry, self._operation, self._arguments = entry, operation, arguments
        self._began = False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the answer; it ends when the client goes."""
        with self._api.under_way.one(self._visitor.holder.number, self._entry.address):
            work = self._stream(send) if self._operation.streams else self._call(send)
            done = await self._visitor.work(work, partial(_gone, receive))
        if not done and self._visitor.closed:
            error = HttpError(401, "E-DENIED", "the token has ended")
            await (_end(send, error) if self._began else answer(send, error))

    async def _call(self, send: Send) -> None:
        client = await self._visitor.session(self._entry)
        wait = patience(self._operation, self._arguments)
        value = await client.call(self._operation.name, wait, **self._arguments)
        await _json(value)({"type": "http"}, _nothing, send)

    async def _stream(self, send: Send) -> None:
        client = await self._visitor.session(self._entry)
        wait = patience(self._operation, self._arguments)
        async with client.stream(self._operation.name, wait, **self._arguments) as stream:
            headers = [(b"content-type", LINES.encode())]
            await send({"type": "http.response.start", "status": 200, "headers": headers})
            self._began = True
            try:
                async for said in lines_of(stream):
                    await _line(send, said, more="end" not in said)
            except AiortsError as error:
                await _end(send, error)


@cache
def _page_files() -> Mapping[str, Path]:
    """The files of the page by the paths at which they are served: a list, so that no path leads out of the folder."""
    return {
        path.relative_to(PAGE).as_posix(): path for path in PAGE.rglob("*") if path.suffix in PAGES and path.is_file()
    }


@cache
def _modules() -> str:
    """A header by which a browser asks for all modules of the page at once, before a module imports another."""
    return ", ".join(f"<{name}>; rel=modulepreload" for name in _page_files() if name.endswith(".js"))


async def _line(send: Send, value: Mapping[str, Any], *, more: bool = True) -> None:
    await send({"type": "http.response.body", "body": json_out(value) + b"\n", "more_body": more})


async def _end(send: Send, error: AiortsError) -> None:
    """Send the last line of a stream that ends with an error."""
    await _line(send, {"problem": problem_of(error)}, more=False)


async def _gone(receive: Receive) -> None:
    """Wait until the client has gone."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def _nothing() -> dict[str, Any]:
    raise ClosedError("nothing more is taken")


async def _object(request: Request) -> dict[str, Any]:
    """The object in the body of a request; no body is an empty object."""
    body = await request.body()
    if not body:
        return {}
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != JSON:
        raise HttpError(415, "E-RECORD", f"expected {JSON}")
    value = json_in(body)
    if not isinstance(value, dict):
        raise RecordError("expected an object")
    return value


def _token(headers: Mapping[str, str]) -> str:
    """The token that a request has; "" where it has none."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else ""


def _json(value: Any, status: int = 200, kind: str = JSON, headers: Mapping[str, str] | None = None) -> Response:
    from starlette.responses import Response

    return Response(json_out(value), status, headers, kind)


async def _problem(request: Request, error: Exception) -> Response:
    if not isinstance(error, AiortsError):
        raise error
    headers = dict(error.headers) if isinstance(error, HttpError) else None
    return _json(problem_of(error), status_of(error), "application/problem+json", headers)


async def _http_problem(request: Request, error: Exception) -> Response:
    from starlette.exceptions import HTTPException

    if not isinstance(error, HTTPException):
        raise error
    code = "E-ABSENT" if error.status_code == 404 else "E-RECORD"
    text = f"{request.method} {request.url.path[:80]}: {error.detail}"
    return await _problem(request, HttpError(error.status_code, code, text, error.headers or {}))


def _visitor(request: Request) -> Visitor:
    """The client that was admitted with this request."""
    visitor: Visitor = request.scope["visitor"]
    return visitor


def _ignore(*_: object) -> None:
    """Do nothing."""
