"""Thousands of writers that give up at once cost what each of them does, in whatever order they do it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.testing import MemoryNetwork
from links.memory_kernels import Sink, Source, kernel_of, long

pytestmark = pytest.mark.anyio

FEW, FACTOR = 1_000, 8
GROWS = 3.0
"""How much more each of many may cost than each of few: 8 where each searches, about 1 where none does."""


async def here(stack: AsyncExitStack, **options: Any) -> Any:
    kernel = await stack.enter_async_context(Kernel("here"))
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    await kernel.connect(source.out, sink.inp, full="block", timeout=None, **options)
    return source.out


async def with_a_buffer(stack: AsyncExitStack) -> Any:
    return await here(stack, length=1)


async def without_one(stack: AsyncExitStack) -> Any:
    return await here(stack, length=0)


async def to_another_kernel(stack: AsyncExitStack) -> Any:
    network = MemoryNetwork()
    two, one = [await stack.enter_async_context(kernel_of(network, name)) for name in ("two", "one")]
    source = await one.add(Source("source"))
    await two.add(Sink("sink"))
    await one.connect(source.out, "two/sink.inp", full="block", timeout=None, length=1)
    return source.out


async def seconds(count: int, place: Callable[[AsyncExitStack], Awaitable[Any]], *, last_first: bool) -> float:
    """Of the processor, for each of so many writers that wait and are cancelled."""
    async with AsyncExitStack() as stack:
        out = await place(stack)
        writers = [asyncio.ensure_future(out.write(long(number))) for number in range(count + 300)]
        await asyncio.sleep(0.05)
        waiting = [one for one in writers if not one.done()]
        for one in reversed(waiting) if last_first else waiting:
            one.cancel()
        began = time.thread_time()
        await asyncio.gather(*writers, return_exceptions=True)
        return (time.thread_time() - began) / len(waiting)


@pytest.mark.slow
@pytest.mark.parametrize("last_first", [False, True], ids=["first first", "last first"])
@pytest.mark.parametrize("place", [with_a_buffer, without_one, to_another_kernel])
async def test_each_of_many_writers_that_give_up_costs_what_each_of_few_does(
    place: Callable[[AsyncExitStack], Awaitable[Any]], last_first: bool
) -> None:
    few = min([await seconds(FEW, place, last_first=last_first) for _ in range(3)])
    many = await seconds(FEW * FACTOR, place, last_first=last_first)
    if many >= GROWS * few:  # another program may have had the caches
        many = min(many, await seconds(FEW * FACTOR, place, last_first=last_first))
    assert many < GROWS * few, (few, many)
