"""Kernels that reach each other over a `MemoryNetwork`, and components to connect."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.testing import MemoryNetwork
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


def long(value: int) -> TimedLong:
    return TimedLong(tm=0, data=value)


@asynccontextmanager
async def kernel_of(network: MemoryNetwork, name: str) -> AsyncIterator[Kernel]:
    """A kernel that other kernels of the network reach by this name."""
    async with Kernel(name) as kernel:
        kernel.service(Links).use(network.transport(name))
        await kernel.service(Links).opened()
        yield kernel


async def until(holds: Callable[[], object], seconds: float = 30.0) -> None:
    """Wait until it holds, in virtual time."""
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.002)


class Face:
    """A kernel, as far as a transport sees it."""

    def __init__(self, name: str) -> None:
        self.name, self.epoch = name, 5

    def run_in_background(self, coroutine: Any, name: str) -> asyncio.Task[Any]:
        return asyncio.get_running_loop().create_task(coroutine, name=name)

    def report(self, text: str) -> None:
        raise AssertionError(text)
