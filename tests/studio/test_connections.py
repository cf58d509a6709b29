"""Connections end where nothing is asked over them, or what is sent is not taken; others are served all the same."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress

import pytest

from aiorts_studio import connections, guard
from aiorts_studio.serving import HOST
from control_parts import WAIT
from studio_parts import site

pytestmark = pytest.mark.anyio


async def ended(reader: asyncio.StreamReader) -> None:
    """Wait until the server has closed."""
    async with asyncio.timeout(WAIT):
        with suppress(ConnectionError):
            await reader.read()


@pytest.mark.parametrize(
    "begun", ["", "GET / HTTP/1.1\r\nHost:", "GET /studio.css HTTP/1.1\r\nHost: {host}\r\n\r\nGET"]
)
async def test_a_connection_without_a_request_ends(begun: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.05)
    async with site() as client:
        reader, writer = await asyncio.open_connection(HOST, client.port)
        writer.write(begun.format(host=client.host).encode())
        await ended(reader)
        writer.close()
        assert (await client.ask("GET", "/api/kernels")).status == 200


@pytest.mark.parametrize("sent", ["", "POST /api/token HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\n{"])
async def test_of_many_without_a_whole_request_the_first_gives_way(sent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "WAITING", 3)
    monkeypatch.setattr(guard, "BODY_SECONDS", 10 * WAIT)
    async with site() as client:
        streams = [await asyncio.open_connection(HOST, client.port) for _ in range(3)]
        for _, writer in streams:
            writer.write(sent.encode())
        await asyncio.sleep(0.2)  # the server has read it
        streams += [await asyncio.open_connection(HOST, client.port) for _ in range(2)]
        await ended(streams[0][0])
        await ended(streams[1][0])
        assert (await client.ask("GET", "/api/kernels")).status == 200
        for _, writer in streams:
            writer.close()


async def test_of_many_that_come_at_once_no_more_wait_than_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "WAITING", 3)
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 10 * WAIT)
    async with site() as client:
        came = [socket.socket() for _ in range(20)]
        for one in came:
            one.setblocking(False)
            with suppress(BlockingIOError):
                one.connect((HOST, client.port))
        streams = [await asyncio.open_connection(sock=one) for one in came]
        for reader, _ in streams[:-3]:
            await ended(reader)
        assert not any(reader.at_eof() for reader, _ in streams[-3:])
        for _, writer in streams:
            writer.close()


class Deaf(asyncio.Protocol):
    """Takes nothing of what is sent."""

    def __init__(self) -> None:
        self.lost = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.pause_reading()  # type: ignore[attr-defined]

    def connection_lost(self, exc: Exception | None) -> None:
        self.lost.set_result(exc)


async def test_a_client_that_does_not_read_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "STALL_SECONDS", 0.2)
    async with site() as client:
        transport, deaf = await asyncio.get_running_loop().create_connection(Deaf, HOST, client.port)
        transport.write(f"GET /docs HTTP/1.1\r\nHost: {client.host}\r\n\r\n".encode() * 200)
        async with asyncio.timeout(WAIT):
            while not deaf.lost.done():
                transport.write(b"\r\n")  # who does not read learns of an end by writing
                await asyncio.wait([deaf.lost], timeout=0.1)
        assert (await client.ask("GET", "/api/kernels")).status == 200
