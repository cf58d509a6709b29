"""Kernels over a transport that loses, doubles, reorders and delays, with cuts, in shuffled virtual time."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from random import Random
from typing import Any

import pytest

from aiorts import Component, Connector, InPort, Kernel, OutPort
from aiorts.errors import LinkError, WriteTimeout
from aiorts.links import LinkLedger, Links
from aiorts.testing import MemoryNetwork, simulate
from aiorts.types import TimedLong
from campaign import cases
from links.memory_kernels import kernel_of, until


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


def a_network(seed: int, random: Random) -> MemoryNetwork:
    """One with faults of any kinds."""
    return MemoryNetwork(
        seed=seed,
        loss=random.choice((0.0, 0.1, 0.3)),
        duplicate=random.choice((0.0, 0.2)),
        reorder=random.choice((0.0, 0.2)),
        delay=random.choice((0.0, 0.001, 0.02)),
    )


async def play(seed: int) -> tuple[list[int], int, dict[str, int], bool]:
    """Writes 300 samples in bursts while the network does its worst; what was read, and the writer's ledger."""
    random = Random(seed)
    network = a_network(seed, random)
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


async def ledger_of(kernel: Kernel, connector: Connector) -> LinkLedger:
    """The ledger from end to end, once both ends know each other again."""
    while True:
        try:
            return await kernel.service(Links).ledger(connector)
        except LinkError:
            await asyncio.sleep(0.1)


async def play_with_restarts(seed: int) -> None:
    """Writes with any policy over any network to a reader whose kernel is closed, and started anew, at random."""
    random = Random(seed)
    network = a_network(seed, random)
    options = random.choice(
        [
            {"full": "block", "timeout": None, "length": random.choice((1, 8))},
            {"full": "overwrite", "length": random.choice((1, 4, 64))},
            {"full": "reject", "length": random.choice((1, 4, 64))},
            {"subscription": "new", "push": "new"},
            {"subscription": "flush", "timeout": None},
            {"subscription": "periodic", "push_rate": 100.0, "length": 64},
        ]
    )
    count, seen, readers = random.choice((30, 100)), list[int](), []

    async def reading(kernel: Kernel, sink: Sink) -> None:
        while True:
            seen.append((await sink.inp.read()).data)
            await asyncio.sleep(random.choice((0.0, 0.0, 0.003, 0.05)))

    async def start() -> None:
        kernel = await Kernel("two").open()
        kernel.service(Links).use(network.transport("two"))
        await kernel.service(Links).opened()
        sink = await kernel.add(Sink("sink"))
        readers.append((kernel, asyncio.ensure_future(reading(kernel, sink))))

    async def stop() -> None:
        kernel, task = readers.pop()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await kernel.aclose()

    async with Kernel("one") as one:
        one.service(Links).use(network.transport("one"))
        await one.service(Links).opened()
        source = await one.add(Source("source"))
        await start()
        connector = await one.connect(source.out, "two/sink.inp", **options)

        async def write() -> None:
            for value in range(count):
                await source.out.write(TimedLong(tm=0, data=value))
                await asyncio.sleep(random.choice((0.0, 0.0, 0.0, 0.001, 0.05)))

        writing = asyncio.ensure_future(write())
        for _ in range(random.randrange(3)):
            await asyncio.sleep(random.choice((0.0, 0.01, 0.3)))
            await stop()
            await asyncio.sleep(random.choice((0.0, 0.5, 5.0)))
            await start()
        if random.random() < 0.3:
            network.cut("one", "two")
            await asyncio.sleep(random.choice((0.01, 14.0)))
            network.restore("one", "two")
        await asyncio.wait_for(writing, 600)
        async with asyncio.timeout(600):
            while connector.statistics.in_flight or connector.statistics.buffered:
                await asyncio.sleep(0.1)
            while (joined := await ledger_of(one, connector)).buffered:
                await asyncio.sleep(0.1)
        ledger = connector.statistics
        assert ledger.balanced, (options, ledger)
        assert not joined.unexplained, (options, joined)
        assert ledger.written == count
        assert seen == sorted(set(seen)), options
        assert len(seen) <= ledger.arrived + ledger.dropped.get("unknown_fate", 0), (options, ledger)
        if options.get("full") != "reject" and not (ledger.dropped.get("unknown_fate") or joined.acknowledged_before):
            assert seen[-1:] == [count - 1], (options, ledger)  # the newest is never stranded
        await stop()


@pytest.mark.slow(kept_by="test_whatever_the_network_does_each_sample_is_read_once_and_in_order")
def test_whatever_becomes_of_the_reader_all_is_accounted_for_and_nothing_comes_twice() -> None:
    for seed in range(cases(500)):
        simulate(play_with_restarts(seed), seed=seed)


async def newest(count: int, every: float) -> tuple[list[int], LinkLedger]:
    """What comes of samples that are written at this pace to a connector of which only the newest counts."""
    network = MemoryNetwork(delay=0.001)
    async with Kernel("two") as two, Kernel("one") as one:
        for kernel in (one, two):
            kernel.service(Links).use(network.transport(kernel.name))
        await two.service(Links).opened()
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", push="new")
        seen: list[int] = []

        async def read() -> None:
            while True:
                seen.append((await sink.inp.read()).data)

        reader = asyncio.ensure_future(read())
        for value in range(count):
            source.out.write_nowait(TimedLong(tm=0, data=value))
            await asyncio.sleep(every)
        await asyncio.sleep(1.0)
        reader.cancel()
        return seen, await one.service(Links).ledger(connector)


@pytest.mark.fault("E07")
def test_where_the_newest_counts_each_comes_that_the_way_has_time_for() -> None:
    seen, ledger = simulate(newest(200, 0.005))
    assert seen == [*range(200)]
    assert (ledger.delivered, ledger.unexplained) == (200, 0)


def test_each_write_that_waits_for_an_answer_ends_in_its_own_time() -> None:
    async def play() -> list[tuple[float, str]]:
        network, ends = MemoryNetwork(delay=0.001), []
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            options: dict[str, Any] = {"subscription": "flush", "full": "block", "length": 1, "timeout": 1.0}
            connector = await one.connect(source.out, "two/sink0.inp", **options)
            assert await source.out.write(TimedLong(0, 0))
            loop = asyncio.get_running_loop()
            began = loop.time()

            async def write(value: int) -> None:
                try:
                    await source.out.write(TimedLong(0, value))
                    ends.append((round(loop.time() - began, 3), "taken"))
                except WriteTimeout:
                    ends.append((round(loop.time() - began, 3), "late"))

            writes = []
            for value in range(1, 6):
                writes.append(asyncio.ensure_future(write(value)))
                await asyncio.sleep(0.3)
            writes[3].cancel()
            await until(lambda: len(ends) == 3)
            seen = [(await sink.inp.read()).data for _ in range(6)]
            await asyncio.wait(writes)
            assert seen == [0, 1, 2, 3, 4, 5]  # all were sent
            await until(lambda: not connector.statistics.in_flight)
            assert (connector.statistics.acknowledged, connector.statistics.dropped) == (6, {})
        return ends

    *late, (moment, what) = simulate(play())
    assert late == [(1.0, "late"), (1.3, "late"), (1.6, "late")]
    assert what == "taken"
    assert 1.6 < moment < 1.7


def test_writes_that_wait_for_an_answer_share_one_timer(monkeypatch: pytest.MonkeyPatch) -> None:
    async def play() -> int:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", subscription="flush", timeout=60.0)
            timers = 0
            for name in ("call_at", "call_later"):
                made = getattr(one, name)

                def counted(*args: Any, made: Any = made) -> Any:
                    nonlocal timers
                    timers += 1
                    return made(*args)

                monkeypatch.setattr(one, name, counted)
            for value in range(100):
                assert await source.out.write(TimedLong(0, value))
                assert sink.inp.read_nowait().data == value
            return timers

    assert simulate(play()) <= 10
