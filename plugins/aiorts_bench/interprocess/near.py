"""The measuring process of `aiorts bench links`: its ends, and the other processes that it starts."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager, suppress
from dataclasses import replace
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final

from aiorts import Component, Connector, InPort, Kernel, OutPort
from aiorts.types import TimedDouble, TimedOctetSeq
from aiorts_bench.harness import child
from aiorts_bench.harness.case import Ledger, Reading
from aiorts_bench.interprocess.far import END, KERNEL, PATIENCE, WORKING, work
from aiorts_bench.interprocess.zenoh import LARGE, MANY, SMALL, Peer, opened
from aiorts_bench.push.peers import free_port

FRAME: Final = bytes(24)
"""The message on the socket pair: as long as a small sample with its head."""
BIG: Final = bytes(1 << 20)
_POOL: Final = "latency"


class Near(Component):
    """The ports at the measuring end of the links."""

    inp = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    large_in = InPort(TimedOctetSeq)
    large_out = OutPort(TimedOctetSeq)
    confirmed = OutPort(TimedDouble)
    many = OutPort(TimedDouble)
    counted = InPort(TimedDouble)


class Far:
    """A process of `far.py`."""

    def __init__(self, loop: str, kind: str, *words: str, descriptors: Sequence[int] = ()) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter, our own module
            [sys.executable, "-m", "aiorts_bench.interprocess.far", loop, kind, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=child.environment(),
            pass_fds=tuple(descriptors),
        )

    async def ready(self) -> None:
        """Wait until the process is ready.

        Raises:
            OSError: the process ended, or takes too long.
        """
        if await self._line() != "ready":
            raise OSError("aiorts bench links: its other process ended before it was ready")

    async def cpu_seconds(self) -> float:
        """Processor time that the process has used."""
        stdin = self._process.stdin
        assert stdin is not None  # noqa: S101 - a pipe
        stdin.write("\n")
        stdin.flush()
        return float(await self._line())

    async def _line(self) -> str:
        stdout = self._process.stdout
        assert stdout is not None  # noqa: S101 - a pipe
        async with asyncio.timeout(PATIENCE):
            return (await asyncio.to_thread(stdout.readline)).strip()

    def close(self) -> None:
        """End the process."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(5)


@contextmanager
def own_folder() -> Iterator[None]:
    """Set a run-time folder of the bench's own, so that its kernels find only each other."""
    before = os.environ.get("XDG_RUNTIME_DIR")
    with tempfile.TemporaryDirectory(prefix="aiorts-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["XDG_RUNTIME_DIR"]
            else:
                os.environ["XDG_RUNTIME_DIR"] = before


class Ends:
    """The measurements on one loop, each with a process at its other end.

    Args:
        peers: whether Zenoh is among them.
    """

    def __init__(self, loop: str, *, peers: bool) -> None:
        self.loop, self.peers = loop, peers
        self._answer: asyncio.Future[Any]
        self._socket: socket.socket
        self._wanted = 0
        self._peer: Peer
        self._near: Near
        self._confirmed: Connector
        self._many: Connector
        self._far: Far

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Start the processes and connect."""
        async with AsyncExitStack() as stack:
            stack.enter_context(own_folder())
            await self._open_socket(stack)
            if self.peers:
                await self._open_zenoh(stack)
            await self._open_kernel(stack)
            yield

    async def _start(self, stack: AsyncExitStack, kind: str, *words: str, descriptors: Sequence[int] = ()) -> Far:
        far = Far(self.loop, kind, *words, descriptors=descriptors)
        stack.callback(far.close)
        await far.ready()
        return far

    # -- a socket pair ---------------------------------------------------------------------------------------------

    async def _open_socket(self, stack: AsyncExitStack) -> None:
        loop = asyncio.get_running_loop()
        near, far = self._pair()
        with far:
            await self._start(stack, "socket", str(far.fileno()), descriptors=(far.fileno(),))
        self._socket = stack.enter_context(near)
        near.setblocking(False)
        loop.add_reader(near.fileno(), self._received)
        stack.callback(loop.remove_reader, near.fileno())

    def _pair(self) -> tuple[socket.socket, socket.socket]:
        return socket.socketpair()

    def _received(self) -> None:
        self._wanted -= len(self._socket.recv(1 << 18))
        if self._wanted <= 0 and not self._answer.done():
            self._answer.set_result(None)

    async def bare(self, count: int) -> Reading:
        """Send 24 bytes there and back."""
        return await self._sent_back(count, FRAME)

    async def bare_working(self, count: int) -> Reading:
        """Send 24 bytes there and back between ends that work 40 us each: processors stay as awake as with a link."""
        return await self._sent_back(count, WORKING, work)

    async def _sent_back(self, count: int, message: bytes, taken: Callable[[], object] | None = None) -> Reading:
        def send() -> None:
            self._wanted = len(message)
            self._socket.send(message)

        return await self._there_and_back(count, send, taken)

    async def bare_large(self, count: int) -> Reading:
        """Send 1 MiB there and back."""
        loop = asyncio.get_running_loop()
        pools = []
        async with patience(count):
            for _ in repeat(None, count):
                self._answer, self._wanted = loop.create_future(), len(BIG)
                began = perf_counter_ns()
                await loop.sock_sendall(self._socket, BIG)
                await self._answer
                pools.append(perf_counter_ns() - began)
        return Reading(messages=count, pools={_POOL: pools})

    async def _there_and_back(
        self, count: int, send: Callable[[], object], taken: Callable[[], object] | None = None
    ) -> Reading:
        loop = asyncio.get_running_loop()
        pools = []
        async with patience(count):
            for _ in repeat(None, count):
                self._answer = loop.create_future()
                began = perf_counter_ns()
                send()
                await self._answer
                if taken is not None:
                    taken()
                pools.append(perf_counter_ns() - began)
        return Reading(messages=count, pools={_POOL: pools})

    # -- Zenoh -----------------------------------------------------------------------------------------------------

    async def _open_zenoh(self, stack: AsyncExitStack) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        await self._start(stack, "zenoh", endpoint)
        await self._meet(stack, Peer(opened("connect", endpoint), asyncio.get_running_loop().call_soon_threadsafe))

    async def _meet(self, stack: AsyncExitStack, peer: Peer) -> None:
        self._peer = peer
        stack.callback(peer.close)
        for key, cls in (
            ("small", TimedDouble),
            ("large", TimedOctetSeq),
            ("many", TimedDouble),
            ("arrays", TimedDouble),
        ):
            peer.on(f"back/{key}", cls, self._came)
        self._answer = asyncio.get_running_loop().create_future()
        async with asyncio.timeout(PATIENCE):
            while not self._answer.done():  # until the two have met
                peer.put(SMALL, TimedDouble(0, 0.0))
                await asyncio.sleep(0.05)
        await asyncio.sleep(0.2)  # samples that were sent meanwhile come back

    def _came(self, record: Any) -> None:
        if not self._answer.done():
            self._answer.set_result(record)

    async def zenoh(self, count: int) -> Reading:
        """Put small samples, which the other process puts back."""
        return await self._there_and_back(count, lambda: self._peer.put(SMALL, TimedDouble(0, 1.0)))

    async def zenoh_large(self, count: int) -> Reading:
        """Put 1 MiB, which is put back."""
        return await self._there_and_back(count, lambda: self._peer.put(LARGE, TimedOctetSeq(0, BIG)))

    async def zenoh_many(self, count: int, key: str = MANY) -> Reading:
        """Put small samples as fast as they are taken."""
        put = self._peer.put
        self._answer = asyncio.get_running_loop().create_future()
        began = perf_counter_ns()
        for number in range(count):
            put(key, TimedDouble(number, 1.0))
            if not number % 64:
                await asyncio.sleep(0)
        put(key, TimedDouble(count, END))
        async with asyncio.timeout(PATIENCE):
            answer = await self._answer
        elapsed = perf_counter_ns() - began
        lost = count + 1 - int(answer.data)
        dropped = {"lost": lost} if lost else {}
        return Reading.timed(count, elapsed, Ledger(count, count - lost, received=count - lost, dropped=dropped))

    # -- a link ----------------------------------------------------------------------------------------------------

    async def _open_kernel(self, stack: AsyncExitStack) -> None:
        self._far = await self._start(stack, "kernel")
        await self._connect(await stack.enter_async_context(Kernel("bench-near")), f"{KERNEL}/echo")

    async def _connect(self, kernel: Kernel, echo: str) -> None:
        near = self._near = await kernel.add(Near("near"))
        await kernel.connect(near.out, f"{echo}.inp")
        await kernel.connect(near.inp, f"{echo}.out")
        await kernel.connect(near.large_out, f"{echo}.large_in")
        await kernel.connect(near.large_in, f"{echo}.large_out")
        await kernel.connect(near.counted, f"{echo}.counted")
        self._confirmed = await kernel.connect(near.confirmed, f"{echo}.confirmed", subscription="flush")
        self._many = await kernel.connect(near.many, f"{echo}.many", full="block", timeout=PATIENCE, length=1_024)
        async with asyncio.timeout(PATIENCE):
            await near.confirmed.write(TimedDouble(0, 0.0))
            near.out.write_nowait(TimedDouble(0, 0.0))
            await near.inp.read()
            near.large_out.write_nowait(TimedOctetSeq(0, b""))
            await near.large_in.read()

    async def link(self, count: int) -> Reading:
        """Write small samples, which the other kernel writes back."""
        return await self._echoed(self._near.out, self._near.inp, count, lambda: TimedDouble(0, 1.0))

    async def link_large(self, count: int) -> Reading:
        """Write 1 MiB, which is written back."""
        return await self._echoed(self._near.large_out, self._near.large_in, count, lambda: TimedOctetSeq(0, BIG))

    async def _echoed(self, out: OutPort[Any], inp: InPort[Any], count: int, make: Callable[[], Any]) -> Reading:
        pools = []
        async with patience(count):
            for _ in repeat(None, count):
                began = perf_counter_ns()
                out.write_nowait(make())
                await inp.read()
                pools.append(perf_counter_ns() - began)
        return Reading(messages=count, pools={_POOL: pools})

    async def link_flush(self, count: int) -> Reading:
        """Write, and wait until the sample is in the reader's buffer."""
        write, before = self._near.confirmed.write, self._confirmed.statistics
        pools = []
        for _ in repeat(None, count):
            began = perf_counter_ns()
            await write(TimedDouble(0, 1.0))
            pools.append(perf_counter_ns() - began)
        return Reading(messages=count, pools={_POOL: pools}, ledger=since(self._confirmed, before))

    async def link_many(self, count: int) -> Reading:
        """Write small samples as fast as they are taken, until all were read."""
        write, connector = self._near.many.write, self._many
        before = connector.statistics
        began = perf_counter_ns()
        for number in range(count):
            await write(TimedDouble(number, 1.0))
        await write(TimedDouble(count, END))
        async with asyncio.timeout(PATIENCE):
            answer = await self._near.counted.read()
            elapsed = perf_counter_ns() - began
            while connector.statistics.in_flight:  # noqa: ASYNC110 - the last acknowledgement comes by itself
                await asyncio.sleep(0.01)
        ledger = replace(since(connector, before), received=int(answer.data))
        return Reading.timed(count, elapsed, ledger)

    async def idle(self, count: int) -> Reading:
        """Measure the other process for `count` tenths of a second, while seven links carry nothing."""
        await asyncio.sleep(0.1)  # samples that were sent before are acknowledged
        before, began = await self._far.cpu_seconds(), perf_counter_ns()
        await asyncio.sleep(count / 10)
        elapsed = (perf_counter_ns() - began) / 1e9
        return Reading({"core": 100 * (await self._far.cpu_seconds() - before) / elapsed}, count)


def patience(count: int) -> asyncio.Timeout:
    """A time-out that so many messages exceed only if one is lost."""
    return asyncio.timeout(PATIENCE + count / 10)


def since(connector: Connector, before: Any) -> Ledger:
    """The ledger of the samples written to a link since its statistics were `before`."""
    now = connector.statistics
    acknowledged = now.acknowledged - before.acknowledged
    dropped = {reason: count - before.dropped.get(reason, 0) for reason, count in now.dropped.items()}
    lost = {reason: count for reason, count in dropped.items() if count}
    return Ledger(now.written - before.written, acknowledged, now.buffered, acknowledged, lost)
