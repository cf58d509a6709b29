"""`keep_last` over a link: each new reader has the sample that the writer wrote last, as in one kernel."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import EventContext, LifecycleState
from aiorts.testing import MemoryNetwork, simulate
from links.memory_kernels import Sink, Source, kernel_of, long, until


@pytest.mark.parametrize("options", [{}, {"subscription": "flush"}, {"subscription": "new", "push": "new"}])
def test_a_reader_that_is_started_anew_has_the_last_sample(options: dict[str, Any]) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                connector = await one.connect(source.out, "two/sink0.inp", keep_last=True, **options)
                for value in range(3):
                    await source.out.write(long(value))
                await until(lambda: not connector.statistics.in_flight and not connector.statistics.buffered)
                assert sink.inp.drain()[-1] == long(2)
            for _ in range(2):
                async with kernel_of(network, "two") as two:
                    sink = await two.add(Sink())
                    await until(lambda sink=sink: sink.inp.is_new)
                    await asyncio.sleep(1)
                    assert sink.inp.drain() == [long(2)]
            ledger = connector.statistics
            assert (ledger.written, ledger.balanced) == (5, True)

    simulate(run())


def test_what_waits_for_the_new_reader_goes_instead_of_the_last_sample() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                connector = await one.connect(source.out, "two/sink0.inp", keep_last=True)
                await source.out.write(long(1))
                await until(lambda: sink.inp.is_new and not connector.statistics.in_flight)
            await source.out.write(long(2))
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                await until(lambda: sink.inp.is_new)
                await asyncio.sleep(1)
                assert sink.inp.drain() == [long(2)]

    simulate(run())


def test_the_same_reader_after_a_cut_has_nothing_twice() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", keep_last=True)
            await source.out.write(long(1))
            await until(lambda: sink.inp.is_new)
            network.cut("one", "two")
            await asyncio.sleep(5)
            network.restore("one", "two")
            await source.out.write(long(2))
            await asyncio.sleep(5)
            assert sink.inp.drain() == [long(1), long(2)]
            assert connector.statistics.written == 2

    simulate(run())


def test_a_reader_that_becomes_active_later_has_the_last_sample() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            context = await two.start(EventContext(), sink)
            connector = await one.connect(source.out, "two/sink0.inp", keep_last=True)
            await source.out.write(long(7))
            await until(lambda: connector.statistics.acknowledged == 1)
            assert not sink.inp.is_new
            await context.activate(sink)
            assert sink.states[context.name] is LifecycleState.ACTIVE
            assert sink.inp.latest == long(7)

    simulate(run())
