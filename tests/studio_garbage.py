"""Clients of the studio that send nonsense, flood, stall or vanish, in a process of their own: PORT COUNT."""

from __future__ import annotations

import asyncio
import random
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

HOST: Final = "127.0.0.1"
MIB: Final = 1 << 20
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def head(port: int, path: str = "/api/kernels", **headers: str) -> bytes:
    lines = "".join(f"{name.replace('_', '-')}: {text}\r\n" for name, text in headers.items())
    return f"POST {path} HTTP/1.1\r\nHost: {HOST}:{port}\r\n{lines}".encode()


async def malformed(port: int, streams: Streams, chance: random.Random) -> None:
    """Bytes that are no HTTP, or nearly."""
    whole = head(port, Content_Length="2") + b"\r\n{}"
    data = bytearray(whole) if chance.random() < 0.7 else bytearray(chance.randbytes(200))
    for _ in range(chance.randrange(1, 10)):
        data[chance.randrange(len(data))] = chance.randrange(256)
    streams[1].write(data)
    await streams[0].read()


async def oversized(port: int, streams: Streams, chance: random.Random) -> None:
    """A head or a body that is too long."""
    if chance.random() < 0.5:
        streams[1].write(head(port) + b"X: " + b"x" * MIB)
    else:
        streams[1].write(head(port, Content_Length=str(64 * MIB)) + b"\r\n")
        for _ in range(64):
            streams[1].write(b"[" * MIB)
            await streams[1].drain()
    await streams[0].read()


async def flooding(port: int, streams: Streams, chance: random.Random) -> None:
    """Requests without a token, one behind the other."""
    reading = asyncio.ensure_future(streams[0].read())
    try:
        while not reading.done():
            streams[1].write((head(port, Content_Length="0") + b"\r\n") * 10)
            await streams[1].drain()
            await asyncio.sleep(0.01)
    finally:
        reading.cancel()


async def never_reading(port: int, streams: Streams, chance: random.Random) -> None:
    """Asks for much, and takes nothing."""
    get = f"GET /docs HTTP/1.1\r\nHost: {HOST}:{port}\r\n\r\n".encode()
    streams[0]._transport.pause_reading()  # type: ignore[attr-defined]
    with suppress(TimeoutError):
        async with asyncio.timeout(3.0):
            while True:
                streams[1].write(get * 10)
                await streams[1].drain()
                await asyncio.sleep(0.05)


async def half_open(port: int, streams: Streams, chance: random.Random) -> None:
    """Begins a request, or a WebSocket, and says nothing more."""
    upgrade = f"GET /api/socket HTTP/1.1\r\nHost: {HOST}:{port}\r\nOrigin: http://{HOST}:{port}\r\n".encode()
    upgrade += b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    upgrade += b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    begun = (b"", b"POST /api", head(port), head(port, Content_Length="100") + b"\r\n{", upgrade)
    streams[1].write(chance.choice(begun))
    await streams[0].read()


KINDS: tuple[Callable[[int, Streams, random.Random], Awaitable[None]], ...] = (
    *(malformed, oversized, flooding, never_reading, half_open),
)


async def garbage(port: int, number: int) -> None:
    """One client, again and again."""
    chance = random.Random(number)
    while True:
        with suppress(OSError):
            streams = await asyncio.open_connection(HOST, port)
            try:
                await KINDS[number % len(KINDS)](port, streams, chance)
            finally:
                streams[1].transport.abort()
        await asyncio.sleep(0.05)


async def main(port: int, count: int) -> None:
    """Run until the process is killed."""
    async with asyncio.TaskGroup() as group:
        for number in range(count):
            group.create_task(garbage(port, number))
        print("ready", flush=True)


if __name__ == "__main__":
    asyncio.run(main(*map(int, sys.argv[1:])))
