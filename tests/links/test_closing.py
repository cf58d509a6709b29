"""A kernel that has ended is gone, whatever its links were about to try."""

from __future__ import annotations

import asyncio
import gc
import weakref

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.types import TimedLong


class Writer(Component):
    out = OutPort(TimedLong)


class Reader(Component):
    inp = InPort(TimedLong)


@pytest.mark.slow
def test_nothing_holds_a_kernel_that_ends_while_it_tries_to_reach_another_one_again() -> None:
    async def ended() -> weakref.ref[Kernel]:
        async with Kernel("lonely", services={"links": {}}) as kernel:
            writer = await kernel.create(Writer, "writer")
            async with Kernel("other", services={"links": {}}) as other:
                await other.create(Reader, "reader")
                await kernel.connect(writer.out, "other/reader.inp")
                async with asyncio.timeout(10):
                    while not other.connectors:
                        await asyncio.sleep(0.01)
            await asyncio.sleep(0.05)  # it has seen that by now, and tries again
        return weakref.ref(kernel)

    async def main() -> Kernel | None:
        kernel = await ended()
        for _ in range(5):
            await asyncio.sleep(0)
        gc.collect()
        return kernel()

    assert asyncio.run(main()) is None
