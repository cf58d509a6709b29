"""Links that pull: the reader's end asks for the writer's newest sample, and each look at the port asks anew."""

from __future__ import annotations

import asyncio
from random import Random
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts.errors import ReadTimeout
from aiorts.links import Links
from aiorts.testing import MemoryNetwork, simulate
from campaign import cases
from links.memory_kernels import Sink, Source, kernel_of, long, until


@pytest.mark.parametrize("push", ["all", "new", "fifo"])
def test_a_push_policy_beside_pull_changes_nothing(push: str) -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", dataflow="pull", push=push)
            for value in range(3):
                source.out.write_nowait(long(value))
            async with asyncio.timeout(5):
                assert await sink.inp.read() == long(2)

    simulate(run())


@pytest.mark.parametrize("from_reader", [False, True])
def test_a_read_asks_for_the_newest_sample_of_the_writer(from_reader: bool) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.01)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            if from_reader:
                await two.connect("one/source0.out", sink.inp, dataflow="pull")
                await until(lambda: source.out.connectors)
            else:
                await one.connect(source.out, "two/sink0.inp", dataflow="pull")
            (connector,) = one.connectors.values()
            for value in range(5):
                source.out.write_nowait(long(value))
            await asyncio.sleep(5)
            ledger = connector.statistics
            assert (ledger.in_flight, ledger.buffered, ledger.dropped) == (0, 1, {"superseded": 4})  # nobody asked
            began = two.clock.monotonic_ns()
            assert await sink.inp.read() == long(4)
            assert two.clock.monotonic_ns() - began == pytest.approx(20_000_000, rel=0.1)  # there and back
            reading = asyncio.ensure_future(sink.inp.read())
            await asyncio.sleep(5)
            assert not reading.done()
            source.out.write_nowait(long(5))
            source.out.write_nowait(long(6))
            assert connector.statistics.in_flight == 1  # the answer under way
            assert await reading == long(5)
            assert await sink.inp.read() == long(6)
            with pytest.raises(ReadTimeout):
                await sink.inp.read(timeout=1.0)
            await asyncio.sleep(1)
            assert connector.statistics.in_flight == 0
            assert connector.statistics.acknowledged == 3

    simulate(run())


LOOKS: list[Any] = [
    lambda port: port.is_new,
    lambda port: port.peek() is not None,
    lambda port: port.latest is not None,
]


@pytest.mark.parametrize("look", LOOKS, ids=["is_new", "peek", "latest"])
def test_a_look_never_waits_and_asks_for_the_next(look: Any) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.01)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", dataflow="pull")
            source.out.write_nowait(long(1))
            assert not look(sink.inp)
            await asyncio.sleep(0.03)
            source.out.write_nowait(long(2))
            assert look(sink.inp)  # the first, which is held; and asks for the second
            await asyncio.sleep(0.03)
            assert sink.inp.read_nowait() == long(2)
            with pytest.raises(WouldBlock):
                sink.inp.read_nowait()
            (far,) = two.connectors.values()
            assert far.statistics.balanced
            await asyncio.sleep(1)
            source.out.write_nowait(long(3))
            await asyncio.sleep(1)
            ledger = await one.service(Links).ledger(next(iter(one.connectors.values())))
            assert (ledger.written, ledger.buffered, ledger.in_flight, ledger.unexplained) == (3, 1, 0, 0)

    simulate(run())


def test_a_read_that_waits_already_when_the_link_is_made_has_its_answer() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            reading = asyncio.ensure_future(sink.inp.read())
            await asyncio.sleep(1)
            await one.connect(source.out, "two/sink0.inp", dataflow="pull")
            source.out.write_nowait(long(1))
            assert await asyncio.wait_for(reading, 1) == long(1)

    simulate(run())


def test_a_look_at_the_ledger_asks_for_nothing() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, _ = await one.add(Source()), await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", dataflow="pull")
            source.out.write_nowait(long(1))
            (far,) = two.connectors.values()
            for _ in range(3):
                assert far.statistics.written == 0
                await asyncio.sleep(1)
            assert connector.statistics.buffered == 1

    simulate(run())


def test_one_of_several_connectors_of_an_in_port_may_pull() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, near, sink = await one.add(Source()), await two.add(Source()), await two.add(Sink())
            await two.connect(near.out, sink.inp)
            await one.connect(source.out, "two/sink0.inp", dataflow="pull")
            source.out.write_nowait(long(1))
            assert not sink.inp.is_new
            await asyncio.sleep(0.1)
            near.out.write_nowait(long(2))
            assert [sample.data for sample in sink.inp.drain()] == [1, 2]

    simulate(run())


async def play(seed: int) -> None:
    random = Random(seed)
    network = MemoryNetwork(seed=seed, loss=random.choice((0, 0.3)), duplicate=0.2, reorder=0.2, delay=0.002)
    async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
        source, sink = await one.add(Source()), await two.add(Sink())
        connector = await one.connect(source.out, "two/sink0.inp", dataflow="pull")
        seen: list[int] = []
        for value in range(60):
            source.out.write_nowait(long(value))
            act = random.randrange(8)
            if act < 2:
                seen += [sample.data for sample in sink.inp.drain()]
            elif act == 2:
                with_one = asyncio.ensure_future(sink.inp.read(timeout=0.5))
                await asyncio.wait([with_one])
                if with_one.exception() is None:
                    seen.append(with_one.result().data)
            elif act == 3 and random.random() < 0.3:
                network.cut("one", "two")
                await asyncio.sleep(random.choice((0.0, 1.0)))
                network.restore("one", "two")
            await asyncio.sleep(random.choice((0.0, 0.01, 0.3)))
        network.loss = 0.0
        source.out.write_nowait(long(60))
        while not seen or seen[-1] != 60:
            seen.append((await asyncio.wait_for(sink.inp.read(), 30)).data)
        assert seen == sorted(set(seen)), seed  # each once, in order, and the newest
        await until(lambda: not connector.statistics.in_flight)
        ledger = await one.service(Links).ledger(connector)
        assert (ledger.written, ledger.delivered, ledger.unexplained) == (61, len(seen), 0), (seed, str(ledger))


@pytest.mark.slow
def test_whatever_the_network_does_a_query_is_answered() -> None:
    for seed in range(cases(400)):
        simulate(play(seed), seed=seed)
