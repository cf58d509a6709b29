"""Bare baselines: the work of a connector, done with Python, asyncio and anyio alone."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from itertools import repeat
from time import perf_counter_ns
from typing import Final

import anyio

from aiorts_bench.harness.case import Reading

DEPTH: Final = 1000
"""Length of every bounded queue, here and in `flow.py`."""
PACE: Final = 0.005
"""Seconds between two messages where latency is measured: long enough that the loop is idle at each write."""


async def calls(count: int) -> Reading:
    """Put messages into a deque and take them out, by one Python call each."""
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
    """Put messages into an `asyncio.Queue` and get them in one task, without waiting."""
    queue: asyncio.Queue[float] = asyncio.Queue()
    put, get = queue.put_nowait, queue.get_nowait
    began = perf_counter_ns()
    for _ in repeat(None, count):
        put(1.0)
        get()
    return Reading.timed(count, perf_counter_ns() - began)


async def queue_tasks(count: int) -> Reading:
    """Pass messages through an `asyncio.Queue` of `DEPTH` between two tasks."""
    queue: asyncio.Queue[float] = asyncio.Queue(DEPTH)
    return await _between_tasks(queue.put, queue.get, count)


async def anyio_stream(count: int) -> Reading:
    """Pass messages through an anyio memory object stream of `DEPTH` between two tasks."""
    send, receive = anyio.create_memory_object_stream[float](DEPTH)
    with send, receive:
        return await _between_tasks(send.send, receive.receive, count)


async def _between_tasks(
    put: Callable[[float], Awaitable[None]], get: Callable[[], Awaitable[float]], count: int
) -> Reading:
    async def produce() -> None:
        for _ in repeat(None, count):
            await put(1.0)

    async def consume() -> None:
        for _ in repeat(None, count):
            await get()

    began = perf_counter_ns()
    await asyncio.gather(produce(), consume())
    return Reading.timed(count, perf_counter_ns() - began)


async def future_wake(count: int) -> Reading:
    """Wake a task that waits for a future each `PACE` seconds; latency is from `set_result` to the task's next line."""
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
