"""Kernels that lose each other, what is changed meanwhile at one end, and what both know afterwards."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.links import Links
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Pair:
    """A source in the kernel `one` and a sink in `two`, which are connected."""

    def __init__(self, one: Kernel, two: Kernel, network: MemoryNetwork) -> None:
        self.kernels, self.network = {"one": one, "two": two}, network

    async def begin(self) -> None:
        for name, kernel in self.kernels.items():
            kernel.service(Links).use(self.network.transport(name))
            await kernel.service(Links).opened()
        self.source, self.sink = await self.kernels["one"].add(Source()), await self.kernels["two"].add(Sink())

    async def connect(self, by: str) -> None:
        ends = (self.source.out, "two/sink0.inp") if by == "one" else ("one/source0.out", self.sink.inp)
        await self.kernels[by].connect(*ends)
        await self.until(lambda: self.comes(1))

    def comes(self, value: int) -> bool:
        """Whether what is written comes; something is written."""
        self.source.out.write_nowait(TimedLong(0, value))
        return any(sample.data == value for sample in self.sink.inp.drain())

    def connectors(self) -> list[int]:
        return [len(kernel.connectors) for kernel in self.kernels.values()]

    async def until(self, holds: Callable[[], bool]) -> None:
        async with asyncio.timeout(10.0):
            while not holds():
                await asyncio.sleep(0.05)

    async def apart(self) -> None:
        self.network.cut("one", "two")
        await self.until(lambda: not any(one.service(Links).peers for one in self.kernels.values()))

    def ended(self, end: str) -> Any:
        (connector,) = self.kernels[end].connectors.values()
        return self.kernels[end].disconnect(connector)


@pytest.mark.fault("E05")
@pytest.mark.parametrize("by", ["one", "two"])
def test_what_its_kernel_disconnects_while_there_is_no_way_ends_at_the_other_end_when_there_is(by: str) -> None:
    async def main() -> None:
        async with Kernel("one") as one, Kernel("two") as two:
            pair = Pair(one, two, MemoryNetwork())
            await pair.begin()
            await pair.connect(by)
            await pair.apart()
            await pair.ended(by)
            pair.network.restore("one", "two")
            await pair.until(lambda: pair.connectors() == [0, 0])
            await asyncio.sleep(10.0)
            assert pair.connectors() == [0, 0]
            await pair.connect(by)

    simulate(main())


@pytest.mark.fault("E05")
@pytest.mark.parametrize(("by", "end"), [("one", "two"), ("two", "one")])
def test_what_the_other_one_disconnects_meanwhile_is_connected_again(by: str, end: str) -> None:
    async def main() -> None:
        async with Kernel("one") as one, Kernel("two") as two:
            pair = Pair(one, two, MemoryNetwork())
            await pair.begin()
            await pair.connect(by)
            await pair.apart()
            await pair.ended(end)
            pair.network.restore("one", "two")
            await pair.until(lambda: pair.comes(2))
            await asyncio.sleep(10.0)
            assert pair.connectors() == [1, 1]

    simulate(main())


@pytest.mark.fault("E05")
@pytest.mark.parametrize("by", ["one", "two"])
def test_what_is_connected_again_before_there_is_a_way_goes_on(by: str) -> None:
    async def main() -> None:
        async with Kernel("one") as one, Kernel("two") as two:
            pair = Pair(one, two, MemoryNetwork())
            await pair.begin()
            await pair.connect(by)
            await pair.apart()
            await pair.ended(by)
            ends = (pair.source.out, "two/sink0.inp") if by == "one" else ("one/source0.out", pair.sink.inp)
            await pair.kernels[by].connect(*ends)
            pair.network.restore("one", "two")
            await pair.until(lambda: pair.comes(2))
            await asyncio.sleep(10.0)
            assert pair.comes(3) is False  # it is on its way
            await asyncio.sleep(1.0)
            assert [sample.data for sample in pair.sink.inp.drain()] == [3]
            assert pair.connectors() == [1, 1]

    simulate(main())
