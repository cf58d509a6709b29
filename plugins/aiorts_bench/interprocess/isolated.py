"""The measuring process of `aiorts bench isolation`: isolated components, and the baselines of `bench links`."""

from __future__ import annotations

import asyncio
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from time import perf_counter_ns
from typing import Final

from aiorts import Component, Connector, EventContext, InPort, Kernel, OutPort
from aiorts.types import TimedDouble, TimedLong, TimedOctetSeq
from aiorts_bench.harness import child
from aiorts_bench.harness.case import Ledger, Reading
from aiorts_bench.interprocess.apart import Through, Worker
from aiorts_bench.interprocess.far import PATIENCE
from aiorts_bench.interprocess.near import BIG, Ends, Near, since
from aiorts_bench.interprocess.zenoh import ARRAYS

WORKERS: Final = 2
_PERIOD: Final = 0.001
"""Least seconds from one array to the next."""


class Beside(Component):
    """The ports that are measured besides those of a link."""

    arrays = OutPort(TimedOctetSeq)
    taken = InPort(TimedDouble)


class Asking(Component):
    """Asks for work, and receives the answer when it is done."""

    out = OutPort(TimedLong)
    inp = InPort(TimedLong)


class IsolatedEnds(Ends):
    """The measurements on one loop: like `Ends`, with isolated components in the place of another kernel."""

    def __init__(self, loop: str, *, peers: bool) -> None:
        super().__init__(loop, peers=peers)
        self._arrays: Connector
        self._beside: Beside
        self._asking: list[Asking] = []
        self._bare: list[Process] = []

    async def _open_kernel(self, stack: AsyncExitStack) -> None:
        kernel = await stack.enter_async_context(Kernel("bench-near"))
        near, beside = await kernel.add(Near("near")), await kernel.add(Beside("beside"))
        self._near, self._beside = near, beside
        through = await kernel.create_isolated(Through, "through")
        await kernel.connect(near.out, "through.inp")
        await kernel.connect("through.out", near.inp)
        await kernel.connect(near.large_out, "through.large_in")
        await kernel.connect("through.large_out", near.large_in)
        self._arrays = await kernel.connect(beside.arrays, "through.arrays", full="block", timeout=PATIENCE, length=16)
        await kernel.connect("through.taken", beside.taken)
        await kernel.start(EventContext(name="through"), through, activate=True)
        for number in range(WORKERS):
            asking = await kernel.add(Asking(f"asking{number}"))
            worker = await kernel.create_isolated(Worker, f"worker{number}")
            await kernel.connect(asking.out, f"worker{number}.inp")
            await kernel.connect(f"worker{number}.out", asking.inp)
            await kernel.start(EventContext(name=f"work{number}"), worker, activate=True)
            self._asking.append(asking)
            self._bare.append(await _bare(stack))
        async with asyncio.timeout(PATIENCE):
            await self.hop(1)
            await self.hop_large(1)
            await self.arrays(1)
            await self.work(1)

    async def hop(self, count: int) -> Reading:
        """Write small samples, which the component writes back."""
        return await self.link(count)

    async def hop_large(self, count: int) -> Reading:
        """Write 1 MiB, which the component writes back."""
        return await self.link_large(count)

    # -- work ------------------------------------------------------------------------------------------------------

    async def work(self, count: int) -> Reading:
        """Give each component `count` pieces of work at the same time."""

        async def one(asking: Asking) -> None:
            asking.out.write_nowait(TimedLong(0, count))
            await asking.inp.read()

        return await _together([one(asking) for asking in self._asking], count)

    async def bare_work(self, count: int) -> Reading:
        """Give each bare process `count` pieces of work at the same time."""

        async def one(process: Process) -> None:
            assert process.stdin is not None  # noqa: S101 - pipes
            assert process.stdout is not None  # noqa: S101 - pipes
            process.stdin.write(b"%d\n" % count)
            await process.stdout.readline()

        return await _together([one(process) for process in self._bare], count)

    # -- arrays ----------------------------------------------------------------------------------------------------

    async def arrays(self, count: int) -> Reading:
        """Write arrays of 1 MiB, at most a thousand in a second, until all were read."""
        write, taken = self._beside.arrays.write, self._beside.taken

        async def used() -> tuple[int, float]:
            await write(TimedOctetSeq(0, b""))
            answer = await taken.read()
            return answer.tm, answer.data

        async def send() -> None:
            await write(TimedOctetSeq(0, BIG))

        before = self._arrays.statistics
        seen, reading = await _arrays(count, used, send)
        while self._arrays.statistics.in_flight:  # noqa: ASYNC110 - the last acknowledgement comes by itself
            await asyncio.sleep(0.01)
        return replace(reading, ledger=replace(since(self._arrays, before), received=seen + 2))

    async def zenoh_arrays(self, count: int) -> Reading:
        """Put arrays of 1 MiB, at most a thousand in a second, until all were taken."""

        async def used() -> tuple[int, float]:
            self._answer = asyncio.get_running_loop().create_future()
            self._peer.put(ARRAYS, TimedOctetSeq(0, b""))
            answer = await self._answer
            return answer.tm, answer.data

        async def send() -> None:
            self._peer.put(ARRAYS, TimedOctetSeq(0, BIG))

        seen, reading = await _arrays(count, used, send)
        return replace(reading, ledger=Ledger(count, seen, received=seen, dropped=_lost(count - seen)))


def _lost(count: int) -> dict[str, int]:
    return {"lost": count} if count else {}


async def _together(works: Sequence[Awaitable[None]], count: int) -> Reading:
    began = perf_counter_ns()
    async with asyncio.timeout(PATIENCE + count / 10):
        await asyncio.gather(*works)
    return Reading({"time": (perf_counter_ns() - began) / 1e6}, count)


async def _arrays(
    count: int, used: Callable[[], Awaitable[tuple[int, float]]], send: Callable[[], Awaitable[None]]
) -> tuple[int, Reading]:
    """Send `count` arrays; return how many the other end took, and the processor time of both processes for each."""
    async with asyncio.timeout(PATIENCE + count / 10):
        _, there = await used()
        here, began = time.process_time(), time.monotonic()
        for number in range(count):
            await send()
            await asyncio.sleep(max(0.0, began + (number + 1) * _PERIOD - time.monotonic()))
        seen, now = await used()
        elapsed = time.monotonic() - began
    spent = time.process_time() - here + now - there
    return seen, Reading({"cpu each": spent / count * 1e6, "rate": count / elapsed}, count)


async def _bare(stack: AsyncExitStack) -> Process:
    """Start a process that does the work without a kernel or components."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "aiorts_bench.interprocess.apart"),
        stdin=PIPE,
        stdout=PIPE,
        stderr=DEVNULL,
        env=child.environment(),
        start_new_session=True,  # as for components: the system may share processors out by sessions
    )

    async def end() -> None:
        with suppress(ProcessLookupError):
            process.kill()
        await process.communicate()

    stack.push_async_callback(end)
    return process
