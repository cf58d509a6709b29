"""Bare baselines: the least that Python, asyncio and anyio need for what a connector does, without aiorts."""

from __future__ import annotations

import asyncio
from collections import deque
from itertools import repeat
from time import perf_counter_ns
from typing import Final

import anyio

from aiorts.bench.case import Reading

__all__ = ("DEPTH", "PACE", "anyio_stream", "calls", "future_wake", "queue_pair", "queue_tasks")

DEPTH: Final = 1000
"""Room of every bounded queue, here and in `flow.py`."""
PACE: Final = 0.005
"""Seconds between two messages where latency is measured: everything is idle when the next one is written."""


async def calls(count: int) -> Reading:
    """Two Python calls and a deque."""
    queue: deque[float] = deque()

    def put(item: float) -> None:
        queue.append(item)

    def get() -> float:
        return queue.popleft()

    began = perf_counter_ns()
    for _ in repeat(None, count):
        put(1.0)
        get()
    return Reading.timed(count, perf_counter_ns() - began)


async def queue_pair(count: int) -> Reading:
    """`asyncio.Queue`: put_nowait and get_nowait in one task."""
    queue: asyncio.Queue[float] = asyncio.Queue()
    put, get = queue.put_nowait, queue.get_nowait
    began = perf_counter_ns()
    for _ in repeat(None, count):
        put(1.0)
        get()
    return Reading.timed(count, perf_counter_ns() - began)


async def queue_tasks(count: int) -> Reading:
    """`asyncio.Queue` of `DEPTH` between two tasks."""
    queue: asyncio.Queue[float] = asyncio.Queue(DEPTH)

    async def produce() -> None:
        put = queue.put
        for _ in repeat(None, count):
            await put(1.0)

    async def consume() -> None:
        get = queue.get
        for _ in repeat(None, count):
            await get()

    began = perf_counter_ns()
    await asyncio.gather(produce(), consume())
    return Reading.timed(count, perf_counter_ns() - began)


async def anyio_stream(count: int) -> Reading:
    """anyio's memory object stream of `DEPTH` between two tasks."""
    send, receive = anyio.create_memory_object_stream[float](DEPTH)

    async def produce() -> None:
        put = send.send
        for _ in repeat(None, count):
            await put(1.0)

    async def consume() -> None:
        get = receive.receive
        for _ in repeat(None, count):
            await get()

    with send, receive:
        began = perf_counter_ns()
        await asyncio.gather(produce(), consume())
        return Reading.timed(count, perf_counter_ns() - began)


async def future_wake(count: int) -> Reading:
    """A task that waits for a future, woken each `PACE` seconds: from `set_result` to its next line."""
    loop = asyncio.get_running_loop()
    waiting: list[asyncio.Future[None]] = []
    ran: list[int] = []

    async def wait() -> None:
        for _ in repeat(None, count):
            future = loop.create_future()
            waiting.append(future)
            await future
            ran.append(perf_counter_ns())

    task = asyncio.create_task(wait())
    wrote: list[int] = []
    for _ in repeat(None, count):
        await asyncio.sleep(PACE)
        future = waiting.pop()
        wrote.append(perf_counter_ns())
        future.set_result(None)
    await task
    latencies = tuple(after - before for before, after in zip(wrote, ran, strict=True))
    return Reading(messages=count, pools={"latency": latencies})
