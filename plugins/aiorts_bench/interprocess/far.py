"""The far process of `aiorts bench links`: sends messages back, until its standard input ends.

`python -m aiorts_bench.interprocess.far LOOP KIND ...` prints "ready", then for each line of standard input the seconds
of processor time that it has used.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, Final

from aiorts import Component, InPort, Kernel, OutPort, run
from aiorts.links import Links
from aiorts.types import TimedDouble, TimedOctetSeq

KERNEL: Final = "bench-far"
PATIENCE: Final = 10.0
"""Seconds that one step may take."""
END: Final = -1.0
"""The value of the last sample of a stream, which the other end answers with the number of samples."""

WORKING: Final = b"\1" + bytes(23)
"""A message that the other end of the socket pair answers after some work, as an end of a link does."""
_WORK_NS: Final = 40_000


def work() -> None:
    """Keep the processor busy for 40 us."""
    end = time.perf_counter_ns() + _WORK_NS
    while time.perf_counter_ns() < end:
        pass


class Echo(Component):
    """Sends back what it reads."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    large_in = InPort(TimedOctetSeq)
    large_out = OutPort(TimedOctetSeq)
    confirmed = InPort(TimedDouble)
    many = InPort(TimedDouble)
    counted = OutPort(TimedDouble)

    async def echo(self) -> None:
        """Send small samples back."""
        while True:
            self.out.write_nowait(await self.inp.read())

    async def echo_large(self) -> None:
        """Send large samples back."""
        while True:
            self.large_out.write_nowait(await self.large_in.read())

    async def take(self) -> None:
        """Read samples that get no answer."""
        while True:
            await self.confirmed.read()

    async def count(self) -> None:
        """Count the samples of a stream, and answer the last with their number."""
        seen = 0
        while True:
            for sample in (await self.many.read(), *self.many.drain()):
                seen += 1
                if sample.data == END:
                    self.counted.write_nowait(TimedDouble(0, float(seen)))
                    seen = 0


@asynccontextmanager
async def kernel(services: str = '{"links": {}}') -> AsyncIterator[None]:
    """A kernel with an echo."""
    async with Kernel(KERNEL, services=json.loads(services)) as found:
        await found.service(Links).opened()
        echo = await found.add(Echo("echo"))
        works = (echo.echo(), echo.echo_large(), echo.take(), echo.count())
        tasks = [asyncio.ensure_future(work) for work in works]
        yield
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@asynccontextmanager
async def socket_pair(descriptor: str) -> AsyncIterator[None]:
    """Send back each message of an inherited socket, as it comes."""
    loop = asyncio.get_running_loop()
    with socket.socket(fileno=int(descriptor)) as sock:
        sock.setblocking(False)
        waiting: list[memoryview] = []

        def send() -> None:
            while waiting:
                try:
                    sent = sock.send(waiting[0])
                except BlockingIOError:
                    loop.add_writer(sock.fileno(), send)
                    return
                waiting[0] = waiting[0][sent:]
                if not waiting[0]:
                    del waiting[0]
            loop.remove_writer(sock.fileno())

        def receive() -> None:
            if data := sock.recv(1 << 18):
                if data == WORKING:
                    work()
                waiting.append(memoryview(data))
                if len(waiting) == 1:
                    send()
            else:
                loop.remove_reader(sock.fileno())

        loop.add_reader(sock.fileno(), receive)
        yield
        loop.remove_reader(sock.fileno())


@asynccontextmanager
async def zenoh(endpoint: str) -> AsyncIterator[None]:
    """A session that sends records back, decoded and encoded on the loop as the ends of a link do."""
    from aiorts_bench.interprocess.zenoh import ARRAYS, LARGE, MANY, SMALL, Peer, opened

    peer = Peer(opened("listen", endpoint), asyncio.get_running_loop().call_soon_threadsafe)
    arrays = 0

    def take(array: TimedOctetSeq) -> None:
        nonlocal arrays
        arrays += 1
        if not len(array.data):
            peer.put("back/arrays", TimedDouble(arrays - 1, time.process_time()))
            arrays = 0

    peer.on(SMALL, TimedDouble, lambda sample: peer.put("back/small", sample))
    peer.on(LARGE, TimedOctetSeq, lambda sample: peer.put("back/large", sample))
    peer.on(MANY, TimedDouble, _Count(lambda seen: peer.put("back/many", TimedDouble(0, float(seen)))))
    peer.on(ARRAYS, TimedOctetSeq, take)
    try:
        yield
    finally:
        peer.close()


@asynccontextmanager
async def express(settings: str) -> AsyncIterator[None]:
    """A session like `zenoh`, but with a link's settings: each put is sent at once, with the same hand-over."""
    from aiorts_bench.interprocess.express import BATCHED, FLOOD, HANDED, Express
    from aiorts_bench.interprocess.zenoh import LARGE, MANY, SMALL

    peer = Express(json.loads(settings))
    peer.on(SMALL, TimedDouble, lambda sample: peer.put("back/small", sample))
    peer.on(LARGE, TimedOctetSeq, lambda sample: peer.put("back/large", sample))
    for key in (MANY, BATCHED):
        peer.on(key, TimedDouble, _Count(lambda seen: peer.put("back/many", TimedDouble(0, float(seen)))))
    for key in (FLOOD, HANDED):
        peer.on(key, TimedDouble, partial(peer.flood, f"back/{key}"))
    try:
        yield
    finally:
        peer.close()


class _Count:
    """Counts the samples of a stream, and reports their number at the last."""

    def __init__(self, say: Callable[[int], None]) -> None:
        self._say, self._seen = say, 0

    def __call__(self, sample: TimedDouble) -> None:
        self._seen += 1
        if sample.data == END:
            self._say(self._seen)
            self._seen = 0


@asynccontextmanager
async def zmq(endpoint: str) -> AsyncIterator[None]:
    """A socket of ZeroMQ that sends each message back, but of a stream only the last."""
    from aiorts_bench.interprocess.zeromq import LAST, STREAM, opened

    with opened("listen", endpoint) as sock:

        async def answer() -> None:
            while True:
                data = await sock.recv()
                if data[:1] != STREAM or data == LAST:
                    await sock.send(data)

        answering = asyncio.ensure_future(answer())
        yield
        answering.cancel()
        await asyncio.gather(answering, return_exceptions=True)


KINDS: Final[dict[str, Callable[..., Any]]] = {
    "express": express,
    "kernel": kernel,
    "socket": socket_pair,
    "zenoh": zenoh,
    "zmq": zmq,
}


async def _main(kind: str, words: list[str]) -> None:
    async with KINDS[kind](*words):
        print("ready", flush=True)
        await asyncio.to_thread(_answer)


def _answer() -> None:
    for _ in sys.stdin:
        print(time.process_time(), flush=True)


if __name__ == "__main__":
    _, _loop, _kind, *_words = sys.argv
    logging.getLogger("aiorts").setLevel(logging.ERROR)  # no warning when the other end disconnects
    run(lambda: _main(_kind, _words), loop=_loop)
