"""Kernels over a transport that loses, doubles, reorders and delays, with cuts, in shuffled virtual time."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from random import Random

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import LinkError
from aiorts.links import Links
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong
from campaign import cases


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


async def play(seed: int) -> tuple[list[int], int, dict[str, int], bool]:
    """Writes 300 samples in bursts while the network does its worst; what was read, and the writer's ledger."""
    random = Random(seed)
    network = MemoryNetwork(
        seed=seed,
        loss=random.choice((0.0, 0.1, 0.3)),
        duplicate=random.choice((0.0, 0.2)),
        reorder=random.choice((0.0, 0.2)),
        delay=random.choice((0.0, 0.001, 0.02)),
    )
    async with Kernel("two") as two, Kernel("one") as one:
        for kernel in (one, two):
            kernel.service(Links).use(network.transport(kernel.name))
        await two.service(Links).opened()
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", full="block", timeout=None, length=8)
        seen: list[int] = []
        unexplained: list[int] = []

        async def read() -> None:
            while len(seen) < 300:
                seen.append((await sink.inp.read()).data)
                await asyncio.sleep(random.choice((0.0, 0.0, 0.003)))

        reader = asyncio.ensure_future(read())
        for value in range(300):
            await source.out.write(TimedLong(tm=0, data=value))
            if random.random() < 0.05:
                await asyncio.sleep(random.choice((0.001, 0.05)))
            if random.random() < 0.05:
                with suppress(LinkError):  # the kernels have not found each other again
                    unexplained.append((await one.service(Links).ledger(connector)).unexplained)
            if random.random() < 0.01:
                network.cut("one", "two")
                await asyncio.sleep(random.choice((0.01, 1.0, 14.0)))
                network.restore("one", "two")
        await asyncio.wait_for(reader, 600)
        while connector.statistics.in_flight:
            await asyncio.sleep(0.1)
        ledger = connector.statistics
        joined = await one.service(Links).ledger(connector)
        assert (joined.written, joined.delivered, joined.buffered, joined.in_flight) == (300, 300, 0, 0)
        assert joined == await two.service(Links).ledger(next(iter(two.connectors.values())))
        return seen, ledger.written, dict(ledger.dropped), ledger.balanced and not any(unexplained)


def test_whatever_the_network_does_each_sample_is_read_once_and_in_order() -> None:
    for seed in range(cases(150)):
        seen, written, dropped, balanced = simulate(play(seed), seed=seed)
        assert seen == list(range(300)), seed
        assert (written, dropped, balanced) == (300, {}, True), seed
