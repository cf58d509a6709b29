"""The measuring process of `aiorts bench network`: its ends, and the other processes that it starts."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Final

from aiorts import Kernel
from aiorts.types import TimedDouble
from aiorts_bench.harness import child
from aiorts_bench.harness.case import Reading
from aiorts_bench.interprocess.express import BATCHED, FLOOD, HANDED, Express
from aiorts_bench.interprocess.far import KERNEL, PATIENCE
from aiorts_bench.interprocess.near import BIG, FRAME, Ends, own_folder, patience
from aiorts_bench.interprocess.zeromq import LAST, STREAM, opened
from aiorts_bench.push.peers import free_port
from aiorts_zenoh import Network, NetworkSettings
from aiorts_zenoh.network import engine_settings
from aiorts_zenoh.security.access import COMPONENT
from aiorts_zenoh.security.folder import Folder
from aiorts_zenoh.security.tls import secured_by

_POOL: Final = "latency"
_NEAR: Final = "bench-near"


@dataclass(frozen=True, slots=True)
class Way:
    """A way on which two kernels reach each other.

    Attributes:
        name: stands before the names of its cases.
        secured: over TLS, with certificates at both ends.
        routed: through `aiorts router`.
    """

    name: str
    secured: bool = False
    routed: bool = False


PLAIN: Final = Way("")
SECURED: Final = Way("TLS: ", secured=True)
ROUTED: Final = Way("router: ", routed=True)


class NetworkEnds(Ends):
    """The measurements on one loop over one way: like `Ends`, but over the network."""

    def __init__(self, loop: str, way: Way = PLAIN) -> None:
        super().__init__(loop, peers=True)
        self.way = way
        self._security: dict[str, Any] = {"insecure": True}
        self._router = ""
        self._express: Express
        self._flood: dict[str, _Flood] = {}

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Start the processes and connect."""
        async with AsyncExitStack() as stack:
            if self.way.secured:
                self._security = {"certificates": stack.enter_context(_certificates())}
            if self.way.routed:
                self._router = stack.enter_context(_router())
            await self._open_zenoh(stack)
            await self._open_kernel(stack)
            yield

    def _ends(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The tables of the service `zenoh` at both ends, at a port of their own or the router's."""
        endpoint = self._router or f"127.0.0.1:{free_port()}"
        far = "connect" if self._router else "listen"
        return {far: endpoint, **self._security}, {"connect": endpoint, **self._security}

    def _engine(self, name: str, table: Mapping[str, Any]) -> dict[str, Any]:
        """The settings of a kernel's engine, without access control since there is no kernel."""
        folder = table.get("certificates")
        secured = None if folder is None else secured_by(Path(folder), name, (COMPONENT,))
        settings = engine_settings(NetworkSettings(**table), secured)
        return {key: value for key, value in settings.items() if key != "access_control"}

    async def _open_zenoh(self, stack: AsyncExitStack) -> None:
        listens, connects = map(self._engine, (KERNEL, _NEAR), self._ends())
        await self._start(stack, "express", json.dumps(listens))
        peer = self._express = Express(connects)
        for key in (FLOOD, HANDED):
            flood = self._flood[key] = _Flood()
            peer.on_sample(f"back/{key}", flood.came if key == FLOOD else flood.handed(peer.inbox.put))
        await self._meet(stack, peer)

    async def _open_kernel(self, stack: AsyncExitStack) -> None:
        listens, connects = self._ends()
        stack.enter_context(own_folder())
        self._far = await self._start(stack, "kernel", json.dumps({"zenoh": {"host": "far", **listens}}))
        stack.enter_context(own_folder())  # another one: kernels on two hosts have no socket file in common
        kernel = await stack.enter_async_context(Kernel(_NEAR, services={"zenoh": {"host": "near", **connects}}))
        await kernel.service(Network).opened()
        await self._connect(kernel, f"{KERNEL}/echo")

    async def zenoh_batched(self, count: int) -> Reading:
        """Put small samples as fast as they are taken; the engine makes batches of them."""
        return await self.zenoh_many(count, BATCHED)

    async def flood(self, count: int) -> Reading:
        """Take messages in the engine's callback, as fast as they come."""
        return await self._flooded(FLOOD, count)

    async def flood_handed(self, count: int) -> Reading:
        """Take messages on the loop, as fast as they come."""
        return await self._flooded(HANDED, count)

    async def _flooded(self, key: str, count: int) -> Reading:
        elapsed = self._flood[key].expect(count)
        began = perf_counter_ns()
        self._express.put(key, TimedDouble(0, float(count)))
        async with asyncio.timeout(PATIENCE):
            await elapsed
        return Reading.timed(count, perf_counter_ns() - began)


@contextmanager
def _certificates() -> Iterator[str]:
    """A folder with the certificates of both kernels."""
    with tempfile.TemporaryDirectory(prefix="aiorts-") as path:
        folder = Folder(Path(path) / "certs")
        folder.init()
        for name in (KERNEL, _NEAR):
            folder.issue(name, COMPONENT)
        yield str(folder.path)


@contextmanager
def _router() -> Iterator[str]:
    """Run a router; yield the endpoint where it listens.

    Raises:
        OSError: the router ended before it listened.
    """
    endpoint = f"127.0.0.1:{free_port()}"
    words = [sys.executable, "-m", "aiorts", "router", "--listen", endpoint, "--insecure-network"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env=child.environment())  # noqa: S603 - ours
    with process:
        try:
            assert process.stderr is not None  # noqa: S101 - a pipe
            if not process.stderr.readline():
                raise OSError("aiorts bench network: the router ended before it was ready")
            yield endpoint
        finally:
            process.kill()  # it keeps no state


class _Flood:
    """Counts messages, until all have come."""

    def __init__(self) -> None:
        self._left = 0
        self._all: asyncio.Future[None]

    def expect(self, count: int) -> asyncio.Future[None]:
        """A future that is done when so many messages have come."""
        self._loop = asyncio.get_running_loop()
        self._all, self._left = self._loop.create_future(), count
        return self._all

    def came(self, sample: Any) -> None:
        """Count a message; called in a thread of the engine."""
        self._count(sample.payload.to_bytes())

    def handed(self, put: Callable[..., None]) -> Callable[[Any], None]:
        """A callback that hands each message over to the loop, to be counted there."""

        def came(sample: Any) -> None:
            data = sample.payload.to_bytes()
            put(self._count, data, size=len(data))

        return came

    def _count(self, _data: bytes) -> None:
        self._left -= 1
        if not self._left:
            self._loop.call_soon_threadsafe(self._all.set_result, None)


class BesideEnds(Ends):
    """The measurements of the baselines: a bare connection, and ZeroMQ where `zmq`."""

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
