"""This process of `aiorts bench network`: the ends that measure, and the processes they measure with."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final

from aiorts import Kernel
from aiorts.types import TimedDouble
from aiorts_bench.harness.case import Reading
from aiorts_bench.interprocess.express import BATCHED, FLOOD, HANDED, Express
from aiorts_bench.interprocess.far import KERNEL, PATIENCE
from aiorts_bench.interprocess.near import BIG, FRAME, Ends, own_folder, patience
from aiorts_bench.interprocess.zeromq import LAST, STREAM, opened
from aiorts_bench.push.peers import free_port
from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.network import engine_settings

_POOL: Final = "latency"


@dataclass(frozen=True, slots=True)
class Way:
    """How two kernels reach each other: what the tables of the service `zenoh` have besides the endpoints.

    Attributes:
        name: stands before the names of its cases.
    """

    name: str
    listens: Mapping[str, Any] = field(default_factory=dict)
    connects: Mapping[str, Any] = field(default_factory=dict)

    def ends(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The table of the end that listens, and of the one that connects, at a port of their own."""
        endpoint = f"127.0.0.1:{free_port()}"
        return {"listen": endpoint, **self.listens}, {"connect": endpoint, **self.connects}


PLAIN: Final = Way("", {"insecure": True}, {"insecure": True})


class NetworkEnds(Ends):
    """What is measured on one loop over one way: as `Ends`, each over the network."""

    def __init__(self, loop: str, way: Way = PLAIN) -> None:
        super().__init__(loop, peers=True)
        self.way = way
        self._express: Express
        self._flood: dict[str, _Flood] = {}

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Start the processes and connect."""
        async with AsyncExitStack() as stack:
            await self._open_zenoh(stack)
            await self._open_kernel(stack)
            yield

    async def _open_zenoh(self, stack: AsyncExitStack) -> None:
        listens, connects = (dict(engine_settings(NetworkSettings(**one))) for one in self.way.ends())
        await self._start(stack, "express", json.dumps(listens))
        peer = self._express = Express(connects)
        for key in (FLOOD, HANDED):
            flood = self._flood[key] = _Flood()
            peer.on_sample(f"back/{key}", flood.came if key == FLOOD else flood.handed(peer.inbox.put))
        await self._meet(stack, peer)

    async def _open_kernel(self, stack: AsyncExitStack) -> None:
        listens, connects = self.way.ends()
        stack.enter_context(own_folder())
        self._far = await self._start(stack, "kernel", json.dumps({"zenoh": {"host": "far", **listens}}))
        stack.enter_context(own_folder())  # another one: what is on two hosts has no socket file in common
        kernel = await stack.enter_async_context(Kernel("bench-near", services={"zenoh": {"host": "near", **connects}}))
        await kernel.service(Network).opened()
        await self._connect(kernel, f"{KERNEL}/echo")

    async def zenoh_batched(self, count: int) -> Reading:
        """Put small samples as fast as they are taken; the engine makes batches of them."""
        return await self.zenoh_many(count, BATCHED)

    async def flood(self, count: int) -> Reading:
        """Take messages in the engine's callback, as fast as they come."""
        return await self._flooded(FLOOD, count)

    async def flood_handed(self, count: int) -> Reading:
        """Take them on the loop."""
        return await self._flooded(HANDED, count)

    async def _flooded(self, key: str, count: int) -> Reading:
        elapsed = self._flood[key].expect(count)
        began = perf_counter_ns()
        self._express.put(key, TimedDouble(0, float(count)))
        async with asyncio.timeout(PATIENCE):
            await elapsed
        return Reading.timed(count, perf_counter_ns() - began)


class _Flood:
    """Counts messages, until all have come."""

    def __init__(self) -> None:
        self._left = 0
        self._all: asyncio.Future[None]

    def expect(self, count: int) -> asyncio.Future[None]:
        """Done when so many have come."""
        self._loop = asyncio.get_running_loop()
        self._all, self._left = self._loop.create_future(), count
        return self._all

    def came(self, sample: Any) -> None:
        """One has come, in a thread of the engine."""
        self._count(sample.payload.to_bytes())

    def handed(self, put: Callable[..., None]) -> Callable[[Any], None]:
        """The same, handed over to the loop."""

        def came(sample: Any) -> None:
            data = sample.payload.to_bytes()
            put(self._count, data, size=len(data))

        return came

    def _count(self, _data: bytes) -> None:
        self._left -= 1
        if not self._left:
            self._loop.call_soon_threadsafe(self._all.set_result, None)


class BesideEnds(Ends):
    """What is measured beside: a bare connection, and ZeroMQ where `zmq`."""

    def __init__(self, loop: str, *, zmq: bool) -> None:
        super().__init__(loop, peers=zmq)
        self._zmq: Any = None

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Start the processes and connect."""
        async with AsyncExitStack() as stack:
            await self._open_socket(stack)
            if self.peers:
                endpoint = f"tcp://127.0.0.1:{free_port()}"
                await self._start(stack, "zmq", endpoint)
                self._zmq = stack.enter_context(opened("connect", endpoint))
            yield

    def _pair(self) -> tuple[socket.socket, socket.socket]:
        with socket.create_server(("127.0.0.1", 0)) as server:
            near = socket.create_connection(server.getsockname())
            far, _ = server.accept()
        for one in (near, far):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return near, far

    async def zmq(self, count: int) -> Reading:
        """Send 24 bytes, which are sent back."""
        return await self._zmq_echoed(count, FRAME)

    async def zmq_large(self, count: int) -> Reading:
        """Send 1 MiB, which is sent back."""
        return await self._zmq_echoed(count, BIG)

    async def zmq_many(self, count: int) -> Reading:
        """Send messages of 24 bytes as fast as they are taken."""
        send, message = self._zmq.send, STREAM.ljust(len(FRAME), b"-")
        began = perf_counter_ns()
        async with patience(count):
            for _ in repeat(None, count):
                await send(message)
            await send(LAST)
            await self._zmq.recv()
        return Reading.timed(count, perf_counter_ns() - began)

    async def _zmq_echoed(self, count: int, message: bytes) -> Reading:
        send, receive = self._zmq.send, self._zmq.recv
        pools = []
        async with patience(count):
            for _ in repeat(None, count):
                began = perf_counter_ns()
                await send(message)
                await receive()
                pools.append(perf_counter_ns() - began)
        return Reading(messages=count, pools={_POOL: pools})
