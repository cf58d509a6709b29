"""What is refused, each by a server on loopback; a kernel beside it runs on."""

from __future__ import annotations

import asyncio
import json
import os
import time
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from aiorts.control import Right
from aiorts_studio.codes import CODE_SECONDS, TRIES
from aiorts_studio.guard import HEADERS
from aiorts_studio.plain.limits import AT_ONCE
from aiorts_studio.socket import STRANGERS
from control_parts import WAIT, controlled
from studio_parts import Reply, site

pytestmark = [pytest.mark.anyio, pytest.mark.row(86)]
JSON = {"Content-Type": "application/json"}


def refused(reply: Reply, status: int, *words: str, code: str = "E-DENIED") -> None:
    assert (reply.status, reply.value["status"], reply.value["code"]) == (status, status, code), reply
    assert all(word in reply.value["detail"] for word in words), reply.value
    assert reply.headers["content-type"] == "application/problem+json"
    assert reply.headers.items() >= HEADERS.items()


# -- codes -------------------------------------------------------------------------------------------------------------


async def test_wrong_missing_and_used_codes() -> None:
    async with site(enters=False) as client:
        refused(await client.exchange("guess"), 403, "wrong", "aiorts studio --url")
        for given in ({}, {"code": 1}, {"code": None}, [], {"code": "x", "more": 1}, "code"):
            reply = await client.ask("POST", "/api/token", given, headers={"Origin": client.origin})
            refused(reply, 400, code="E-RECORD")
        await client.enter()
        assert (await client.ask("GET", "/api/kernels")).status == 200
        refused(await client.exchange(client.code), 403, "used before")
        refused(await client.ask("GET", "/api/kernels"), 401, "has ended")
        assert client.said == [
            "client 1: its token has ended: the code was used before; the token that it gave has ended"
        ]


async def test_a_late_code() -> None:
    async with site(enters=False) as client:
        assert client.api is not None
        code = client.api.codes.issue(time.monotonic() - CODE_SECONDS - 1.0)
        refused(await client.exchange(code), 403, "older than 60 s")


async def test_the_eleventh_try() -> None:
    async with site(enters=False) as client:
        for _ in range(TRIES):
            refused(await client.exchange("guess"), 403, "wrong")
        refused(await client.exchange(client.code), 403, f"{TRIES} wrong codes")


# -- tokens ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/api/kernels", "/api/kernels/robot/names", "/api/token"])
@pytest.mark.parametrize("header", ["", "Bearer", "Bearer wrong", "Basic {token}", "{token}", "Bearer {token}x"])
async def test_no_token_or_a_wrong_one(path: str, header: str) -> None:
    method = {"/api/kernels": "GET", "/api/token": "DELETE"}.get(path, "POST")
    async with site() as client:
        headers = {"Authorization": header.format(token=client.token), "Origin": client.origin}
        reply = await client.ask(method, path, headers=headers)
        refused(reply, 401)
        assert reply.headers["www-authenticate"] == "Bearer"


async def test_a_token_in_an_address() -> None:
    async with site() as client:
        for path in (f"/api/kernels?token={client.token}", f"/?{client.token}", "/studio.css?x"):
            for headers in ({}, {"Authorization": ""}):
                refused(await client.ask("GET", path, headers=headers), 400, "Authorization", code="E-RECORD")
        without = {"Authorization": ""}
        refused(await client.ask("GET", f"/api/kernels/{client.token}", headers=without), 401, "Authorization")
        with pytest.raises(InvalidStatus):
            async with connect(f"ws://{client.host}/api/socket?token={client.token}", origin=client.origin):  # type: ignore[arg-type]
                pass


async def test_a_token_after_its_server_has_ended() -> None:
    async with site() as client:
        token = client.token
    async with site() as another:
        another.token = token
        refused(await another.ask("GET", "/api/kernels"), 401, "has ended")


async def test_a_token_that_its_client_has_ended() -> None:
    async with site() as client:
        assert (await client.ask("DELETE", "/api/token")).status == 204
        refused(await client.ask("GET", "/api/kernels"), 401)
        assert client.said == []


# -- pages and names ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/", "/docs", "/studio.css", "/openapi.json", "/api/kernels", "/nothing"])
async def test_a_foreign_name_and_a_foreign_page(path: str) -> None:
    async with site() as client:
        for host in ("evil.example", f"evil.example:{client.port}", "127.0.0.1", f"127.0.0.1:{client.port + 1}"):
            refused(await client.ask("GET", path, headers={"Host": host}), 403, "Host")
        foreign = ("http://evil.example", "null", f"http://127.0.0.1:{client.port + 1}", f"https://{client.host}")
        for origin in (*foreign, f"http://localhost:{client.port}"):
            refused(await client.ask("GET", path, headers={"Origin": origin}), 403, "Origin")


async def test_an_exchange_without_an_origin() -> None:
    async with site(enters=False) as client:
        refused(await client.exchange(client.code, Origin=""), 403, "Origin")
        await client.enter()


async def test_a_websocket_of_another_page_or_of_none() -> None:
    async with site() as client:
        for origin in (None, "http://evil.example", f"http://127.0.0.1:{client.port + 1}"):
            with pytest.raises(InvalidStatus) as error:
                async with connect(f"ws://{client.host}/api/socket", origin=origin):  # type: ignore[arg-type]
                    pass
            assert error.value.response.status_code == 403


# -- websockets that say no token --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "first", [{"token": "wrong"}, {"token": 1}, {"subscribe": 1}, {"token": None}], ids=["wrong", "1", "none", "null"]
)
async def test_a_websocket_whose_first_message_is_no_token(first: dict[str, Any]) -> None:
    async with site() as client, client.socket(**first) as socket:
        with pytest.raises(ConnectionClosed) as error:
            await asyncio.wait_for(socket.recv(), WAIT)
        assert error.value.rcvd is not None
        assert error.value.rcvd.code == 1008


@pytest.mark.slow
async def test_a_websocket_that_says_nothing_ends_after_5_s() -> None:
    async with site() as client, connect(f"ws://{client.host}/api/socket", origin=client.origin) as socket:  # type: ignore[arg-type]
        began = time.monotonic()
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(socket.recv(), WAIT)
        assert 4.5 < time.monotonic() - began < 15.0


async def test_of_many_that_say_no_token_the_first_gives_way() -> None:
    async with site() as client:
        url, options = f"ws://{client.host}/api/socket", {"origin": client.origin, "close_timeout": 0.1}
        sockets = [await connect(url, **options) for _ in range(STRANGERS + 1)]  # type: ignore[arg-type]
        with pytest.raises(ConnectionClosed, match="gave way"):
            await asyncio.wait_for(sockets[0].recv(), WAIT)
        await sockets[1].send(json.dumps({"token": client.token}))
        assert json.loads(await asyncio.wait_for(sockets[1].recv(), WAIT)) == {"right": "view"}
        await asyncio.gather(*(one.close() for one in sockets))


async def test_of_many_that_come_at_once_no_more_say_no_token_than_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts_studio.socket.GREETING_SECONDS", 10 * WAIT)
    monkeypatch.setattr("aiorts_studio.socket.STRANGERS", 3)
    async with site() as client:
        url, options = f"ws://{client.host}/api/socket", {"origin": client.origin, "close_timeout": 0.1}
        sockets = await asyncio.gather(*(connect(url, **options) for _ in range(10)))  # type: ignore[arg-type]
        async with asyncio.timeout(WAIT):
            while len([one for one in sockets if one.close_code is not None]) < 7:
                await asyncio.sleep(0.01)
        assert {one.close_reason for one in sockets} == {None, "gave way to those that came after it"}
        await asyncio.gather(*(one.close() for one in sockets))


# -- requests ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("operation", "size", "status"),
    [("names", 65_537, 413), ("statistics", 65_536, 400), ("plan", 65_537, 400), ("plan", 524_289, 413)],
)
@pytest.mark.parametrize("chunked", [False, True])
async def test_what_is_too_long(operation: str, size: int, status: int, *, chunked: bool) -> None:
    async with controlled("robot"), site() as client:
        body = json.dumps({"no": "x" * (size - 10)}).encode().ljust(size)
        headers = {"Transfer-Encoding": "chunked", "Content-Length": ""} if chunked else {}
        sent = b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body) if chunked else body
        reply = await client.ask("POST", f"/api/kernels/robot/{operation}", body=sent, headers={**JSON, **headers})
        assert reply.status == status, reply
        assert (await client.call("robot", "names")).status == 200


@pytest.mark.parametrize("length", ["-1", "x", "1e9", "99999999999999999999999"])
async def test_a_length_that_is_none(length: str) -> None:
    async with site() as client:
        reply = await client.ask("POST", "/api/kernels/robot/names", headers={"Content-Length": length})
        assert reply.status in (400, 413)


@pytest.mark.parametrize(
    "body",
    [b"[" * 33 + b"]" * 33, b"[" * 60_000, b'{"a":' * 40 + b"1" + b"}" * 40, b"{", b"\xff", b"[1]", b'{"a": NaN}'],
)
async def test_json_that_is_deep_or_none(body: bytes) -> None:
    async with controlled("robot"), site() as client:
        reply = await client.ask("POST", "/api/kernels/robot/names", body=body, headers=JSON)
        refused(reply, 400, code="E-RECORD")


async def test_a_number_that_no_float_holds_is_refused() -> None:
    async with controlled("robot"), site(Right.OPERATE) as client:
        reply = await client.call("robot", "call", path="a.b", method="c", timeout=10**400)
        refused(reply, 400, "timeout", code="E-RECORD")


async def test_json_that_is_not_said_to_be_json() -> None:
    async with controlled("robot"), site() as client:
        for kind in ("", "text/plain", "application/x-www-form-urlencoded"):
            headers = {"Content-Type": kind}
            reply = await client.ask("POST", "/api/kernels/robot/names", body=b"{}", headers=headers)
            refused(reply, 415, code="E-RECORD")


@pytest.mark.parametrize(
    "path",
    [
        *(
            "/../etc/passwd",
            "/%2e%2e/%2e%2e/etc/passwd",
            "//etc/passwd",
            "/studio.css/../../api.py",
            "/..%2fstudio.css",
        ),
        *("/api/kernels/..%2f..%2fetc/passwd", "/studio.css%00", "/static/../codes.py", "/openapi.json/", "/%5c..%5c"),
    ],
)
async def test_a_path_that_leads_elsewhere(path: str) -> None:
    async with site() as client:
        assert (await client.ask("GET", path)).status in (404, 405)


async def test_the_path_of_a_socket_is_no_kernel(runtime: str) -> None:
    async with controlled("robot"), site() as client:
        (path,) = [one.path for one in os.scandir(f"{runtime}/aiorts") if one.name.endswith(".sock")]
        for word in (path, path.replace("/", "%2F"), f"..%2F{path}", ""):
            reply = await client.ask("POST", f"/api/kernels/{word}/names")
            assert reply.status in (403, 404), reply


async def test_an_operation_above_the_right() -> None:
    async with controlled("robot") as kernel, site(Right.VIEW) as client:
        for operation in ("configure", "stop", "create", "inject", "measure"):
            refused(await client.call("robot", operation), 403, "operate", "--edit")
        assert not kernel.closed
    async with controlled("robot") as kernel, site(Right.OPERATE) as client:
        refused(await client.call("robot", "reload", type="Counter"), 403, "code")
        for type_ in ("evil.py:Evil", "os:system"):
            refused(await client.call("robot", "create", type=type_, name="evil"), 403, "code")
        assert set(kernel.components) == {"counter0", "reader0"}


async def test_what_is_not_there() -> None:
    async with controlled("robot"), site() as client:
        refused(await client.call("nobody", "names"), 404, "robot", code="E-ABSENT")
        refused(await client.call("robot", "nothing"), 404, "openapi", code="E-ABSENT")
        refused(await client.call("robot", "configuration", component="no"), 404, "counter0", code="E-ABSENT")
        refused(await client.call("robot", "configuration", wrong=1), 400, code="E-RECORD")
        assert (await client.ask("GET", "/api/kernels/robot/names")).status == 405


async def test_a_client_that_asks_too_often() -> None:
    async with site() as client:
        assert client.api is not None
        visitor = client.api.visitor(client.token)
        later = time.monotonic() + WAIT
        for _ in range(AT_ONCE):
            visitor.requests.fill(later)  # so that none leaks meanwhile
        reply = await client.ask("GET", "/api/kernels")
        refused(reply, 429, code="E-BUSY")
        assert reply.headers["retry-after"] == "1"
