"""Streams, over HTTP as lines and over a WebSocket with credits; they end with their client, its token, the kernel."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from campaign import CAMPAIGN
from control_parts import WAIT, controlled, running
from studio_parts import Site, site

pytestmark = [pytest.mark.anyio, pytest.mark.row(86)]
ROOMBA = str(Path(__file__).parents[2] / "examples/roomba/system.toml")


@asynccontextmanager
async def lines(client: Site, kernel: str, operation: str, **arguments: Any) -> AsyncIterator[Callable[[], Any]]:
    """What gives the next line of a stream over HTTP."""
    body = json.dumps(arguments)
    head = (
        f"POST /api/kernels/{kernel}/{operation} HTTP/1.1\r\nHost: {client.host}\r\nContent-Type: application/json\r\n"
        f"Authorization: Bearer {client.token}\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    reader, writer = await asyncio.open_connection("127.0.0.1", client.port)
    try:
        writer.write((head + body).encode())
        async with asyncio.timeout(WAIT):
            assert (await reader.readline()).startswith(b"HTTP/1.1 200")
            while await reader.readline() != b"\r\n":
                pass

        async def following() -> Any:
            async with asyncio.timeout(WAIT):
                length = int(await reader.readline(), 16)
                line = await reader.readexactly(length)
                await reader.readexactly(2)
            return json.loads(line) if length else None

        yield following
    finally:
        writer.close()


async def said(socket: ClientConnection) -> Any:
    return json.loads(await asyncio.wait_for(socket.recv(), WAIT))


async def test_lines_of_a_stream_come_until_the_client_goes() -> None:
    async with controlled("robot") as kernel, site() as client:
        out = kernel.components["counter0"].ports["out"]
        usual = len(out._connectors)
        async with lines(client, "robot", "tap", port="counter0.out") as following:
            began = await following()
            assert began["began"]["port"] == "counter0.out"
            items = [await following() for _ in range(5)]
            assert [one.keys() for one in items] == [{"item", "missed"}] * 5
            assert len(out._connectors) == usual + 1
            data = [one["item"]["data"] for one in items]
            assert data == [data[0] + step for step in range(5)]
        async with asyncio.timeout(WAIT):
            while len(out._connectors) > usual:
                await asyncio.sleep(0.01)
        assert (await client.call("robot", "names")).status == 200


async def test_a_stream_that_ends_by_itself_says_so() -> None:
    async with controlled("robot"), site() as client:
        reply = await client.call("robot", "log", follow=False)
        assert reply.headers["content-type"] == "application/x-ndjson"
        assert [next(iter(line)) for line in reply.lines][:: len(reply.lines) - 1] == ["began", "end"], reply.lines


async def test_what_cannot_begin_is_a_problem_and_no_stream() -> None:
    async with controlled("robot"), site() as client:
        reply = await client.call("robot", "tap", port="nobody.out")
        assert (reply.status, reply.value["code"]) == (409, "E-CONNECT")


async def test_a_stream_ends_with_its_kernel_and_with_its_token() -> None:
    async with site() as client:
        async with controlled("robot"):
            ending = lines(client, "robot", "tap", port="counter0.out")
            following = await ending.__aenter__()
            assert "began" in await following()
        last = None
        while (line := await following()) is not None:
            last = line
        await ending.__aexit__(None, None, None)
        assert last is not None
        assert next(iter(last)) in ("end", "problem")
        async with controlled("robot"), lines(client, "robot", "tap", port="counter0.out") as following:
            assert "began" in await following()
            await client.ask("DELETE", "/api/token")
            while "problem" not in (line := await following()):
                assert "item" in line
            assert line["problem"]["status"] == 401


async def test_a_websocket_carries_many_streams_each_with_its_credit() -> None:
    async with controlled("robot"), site() as client, client.socket() as socket:
        assert await said(socket) == {"right": "view"}
        for number, credit in ((1, 3), (2, 100)):
            asked = {"kernel": "robot", "operation": "tap", "arguments": {"port": "counter0.out"}, "credit": credit}
            await socket.send(json.dumps({"subscribe": number, **asked}))
        told: dict[int, list[Any]] = {1: [], 2: []}
        while len(told[2]) < 30:
            message = await said(socket)
            told[message.pop("id")].append(message)
        assert [next(iter(one)) for one in told[1]] == ["began", "item", "item", "item"]
        await socket.send(json.dumps({"unsubscribe": 2}))
        await socket.send(json.dumps({"credit": 1, "items": 2}))
        while len(told[1]) < 6:
            message = await said(socket)
            told[message.pop("id")].append(message)
        await socket.send(json.dumps({"subscribe": 3, "kernel": "robot", "operation": "events", "credit": 0}))
        while (message := await said(socket))["id"] != 3:
            assert message["id"] == 2
        assert "began" in message


async def test_the_end_of_a_stream_needs_no_credit() -> None:
    async with controlled("robot"), site() as client, client.socket() as socket:
        assert await said(socket) == {"right": "view"}
        asked = {"kernel": "robot", "operation": "log", "arguments": {"follow": False}}
        items = len((await client.call("robot", "log", follow=False)).lines) - 2
        await socket.send(json.dumps({"subscribe": 1, **asked, "credit": items}))
        told = [await said(socket) for _ in range(items + 2)]
        assert [next(iter(one.keys() - {"id", "missed"})) for one in told] == ["began", *["item"] * items, "end"]


async def test_the_id_of_a_stream_that_its_client_has_left_is_free_at_once() -> None:
    async with controlled("robot"), site() as client, client.socket() as socket:
        assert await said(socket) == {"right": "view"}
        asked = {"kernel": "robot", "operation": "events", "credit": 0}
        for _ in range(3):
            await socket.send(json.dumps({"subscribe": 1, **asked}))
            await socket.send(json.dumps({"unsubscribe": 1}))
        await socket.send(json.dumps({"subscribe": 1, **asked}))
        await socket.send(json.dumps({"subscribe": 2, **asked}))
        while (message := await said(socket))["id"] != 2:
            assert "began" in message
        await socket.send(json.dumps({"unsubscribe": 1}))
        await socket.send(json.dumps({"unsubscribe": 1}))
        while "problem" not in (message := await said(socket)):
            assert "began" in message
        assert message["problem"]["code"] == "E-ABSENT"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("[1]", "E-RECORD"),
        ("{", "E-RECORD"),
        ('{"what": 1}', "E-RECORD"),
        ('{"unsubscribe": 7}', "E-ABSENT"),
        ('{"credit": 7, "items": 1}', "E-ABSENT"),
        ('{"subscribe": -1}', "E-RECORD"),
        ('{"subscribe": 1, "kernel": "robot", "operation": "names", "credit": 1}', "E-RECORD"),
        ('{"subscribe": 1, "kernel": "robot", "operation": "goal", "credit": 1}', "E-DENIED"),
        ('{"subscribe": 1, "kernel": "robot", "operation": "tap"}', "E-RECORD"),
        ('{"subscribe": 1, "kernel": "robot", "operation": "tap", "credit": "many"}', "E-RECORD"),
        ('{"subscribe": 1, "kernel": "nobody", "operation": "events", "credit": 1}', "E-ABSENT"),
        ('{"subscribe": 1, "kernel": "robot", "operation": "tap", "arguments": [], "credit": 1}', "E-RECORD"),
    ],
)
async def test_a_message_that_says_nothing_known_is_a_problem_and_the_socket_goes_on(message: str, code: str) -> None:
    async with controlled("robot"), site() as client, client.socket() as socket:
        assert await said(socket) == {"right": "view"}
        await socket.send(message)
        assert (await said(socket))["problem"]["code"] == code
        asked = {"subscribe": 1, "kernel": "robot", "operation": "events", "credit": 1}
        await socket.send(json.dumps(asked))
        assert "began" in await said(socket)


async def test_a_websocket_ends_with_its_token_and_gives_way_to_the_next_of_its_client() -> None:
    async with site() as client, client.socket() as first:
        assert await said(first) == {"right": "view"}
        async with client.socket() as second:
            assert await said(second) == {"right": "view"}
            with pytest.raises(ConnectionClosed, match="another"):
                await said(first)
            await client.ask("DELETE", "/api/token")
            with pytest.raises(ConnectionClosed, match="token has ended"):
                await said(second)


@pytest.mark.slow
async def test_a_kernel_that_is_stopped_delays_no_answer_about_others() -> None:
    with running("stopped", ROOMBA) as run, running("robot", ROOMBA):
        async with site() as client, client.socket() as socket:
            assert await said(socket) == {"right": "view"}

            async def follow(number: int, kernel: str) -> None:
                arguments = {"rate": 20.0}
                asked = {"subscribe": number, "kernel": kernel, "operation": "counters", "arguments": arguments}
                await socket.send(json.dumps({**asked, "credit": 4_096}))

            async def heard(number: int, key: str) -> Any:
                async with asyncio.timeout(WAIT):
                    while (message := await said(socket)).get("id") != number or key not in message:
                        pass
                return message[key]

            await follow(1, "robot")
            await follow(2, "stopped")
            await heard(2, "item")
            os.kill(run.pid, signal.SIGSTOP)
            try:
                waiting = [asyncio.ensure_future(client.call("stopped", "names")) for _ in range(5)]
                await follow(3, "stopped")
                for number in range(10, 20):
                    began = time.monotonic()
                    assert (await client.call("robot", "names")).status == 200
                    assert (await client.ask("GET", "/api/kernels")).status == 200
                    await heard(1, "item")
                    await follow(number, "robot")
                    await heard(number, "item")
                    assert time.monotonic() - began < (1.0 if CAMPAIGN else 2.5)  # the stopped one is waited for 10 s
                    await socket.send(json.dumps({"unsubscribe": number}))
                replies = await asyncio.gather(*waiting)
                assert {(one.status, one.value["code"]) for one in replies} == {(504, "E-NO-ANSWER")}
                assert (await heard(3, "problem"))["code"] == "E-NO-ANSWER"
            finally:
                os.kill(run.pid, signal.SIGCONT)
            assert (await client.call("stopped", "names")).status == 200
            await follow(4, "stopped")
            assert (await heard(4, "item"))["whole"]


async def test_a_kernel_that_comes_again_is_asked_by_its_name() -> None:
    async with site() as client:
        for _ in range(2):
            async with controlled("robot"):
                assert (await client.call("robot", "names")).status == 200
        assert (await client.call("robot", "names")).status in (404, 503)
