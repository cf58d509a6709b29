"""`max_gap` over a link: the reader's kernel says that the writer is silent, the writer's does not."""

from __future__ import annotations

import asyncio
from typing import Any

from aiorts import EventContext, Kernel
from aiorts.events import WriterBack, WriterSilent
from aiorts.testing import MemoryNetwork, simulate
from links.memory_kernels import Sink, Source, kernel_of, long


class Draining(Sink):
    async def on_execute(self) -> None:
        self.inp.drain()


def told(kernel: Kernel) -> list[Any]:
    found: list[Any] = []
    for kind in (WriterSilent, WriterBack):
        kernel.bus.subscribe(kind, found.append)
    return found


def test_the_reader_hears_of_a_silent_writer_and_of_its_return_also_when_the_link_is_cut() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Draining("sink0"))
            await one.start(EventContext(), source, activate=True)
            await two.start(EventContext(), sink, activate=True)
            here, there = told(one), told(two)
            connector = await one.connect(source.out, "two/sink0.inp", max_gap=1.0)
            for value in range(30):
                source.out.write_nowait(long(value))
                await asyncio.sleep(0.1)
            assert there == []
            (far,) = two.connectors.values()
            silent, back = (kind(far.name, "one/source0.out", 1.0) for kind in (WriterSilent, WriterBack))
            await asyncio.sleep(5)
            assert there == [silent]
            assert far.statistics.silent
            source.out.write_nowait(long(30))
            await asyncio.sleep(0.1)
            assert there == [silent, back]
            network.cut("one", "two")
            for value in range(40):
                source.out.write_nowait(long(value))
                await asyncio.sleep(0.1)
            assert there == [silent, back, silent]
            network.restore("one", "two")
            await asyncio.sleep(2.5)
            assert there[:4] == [silent, back, silent, back]
            assert far.statistics.missed_gaps >= 2
            assert here == []
            assert (connector.statistics.missed_gaps, connector.statistics.silent) == (0, False)

    simulate(run())


def test_a_reader_that_is_not_active_hears_nothing() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            context = await two.start(EventContext(), sink)
            there = told(two)
            await one.connect(source.out, "two/sink0.inp", max_gap=1.0)
            await asyncio.sleep(5)
            assert there == []
            await context.activate(sink)
            await asyncio.sleep(3)
            assert [type(event) for event in there] == [WriterSilent]

    simulate(run())


def test_a_reader_that_does_not_read_hears_nothing_while_samples_come() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await two.start(EventContext(), sink, activate=True)
            there = told(two)
            await one.connect(source.out, "two/sink0.inp", max_gap=1.0, length=2)
            for value in range(50):
                source.out.write_nowait(long(value))
                await asyncio.sleep(0.1)
            assert there == []

    simulate(run())
