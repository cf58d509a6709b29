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
            await until(lambda: connector.statistics.dropped == {"inactive": 1})
            assert not sink.inp.is_new
            await context.activate(sink)
            assert sink.states[context.name] is LifecycleState.ACTIVE
            assert sink.inp.latest == long(7)

    simulate(run())


READ = 3
"""Samples that are written while the first reader is there."""
LENGTH = 8
"""Samples that wait at the writer at the most."""
EVERY = [
    {"subscription": subscription, "push": push, "full": full}
    for subscription in ("flush", "new", "periodic")
    for push in (("all",) if subscription == "flush" else ("all", "fifo", "skip", "new"))
    for full in ("overwrite", "reject", "block")
]


def expected(options: dict[str, Any], count: int) -> list[int]:
    """What a new reader has of `count` samples that were written without one: what waits, then the last."""
    skips, periodic = options["push"] == "skip", options["subscription"] == "periodic"
    written = list(range(READ + 1, READ + count + 1))
    waits = [one for one in written if not skips or periodic or one % 2 == 0]
    waits = waits[:LENGTH] if options["full"] == "reject" else waits[-LENGTH:]
    if options["push"] == "new":
        waits = []
    last = READ + count
    sent = [one for one in waits if not (skips and periodic) or one % 2 == 0]
    found = sent if last in sent else [*sent, last]
    # With flush the reader's buffer refuses at once what it has no room for: nobody has read anything yet.
    return found[:LENGTH] if options["subscription"] == "flush" and options["full"] == "reject" else found


@pytest.mark.parametrize("count", [0, 1, 2, 5, 20])
@pytest.mark.parametrize("lifespan", [None, 100.0])
@pytest.mark.parametrize("options", EVERY, ids=lambda one: "-".join(one.values()))
def test_a_new_reader_has_what_waits_in_order_and_the_last_sample_once(
    options: dict[str, Any], lifespan: float | None, count: int
) -> None:
    """Every subscription, push policy and full policy, against a model; `block` as far as nobody has to wait."""
    more: dict[str, Any] = {"skip": 1} if options["push"] == "skip" else {}
    more |= {"push_rate": 5.0} if options["subscription"] == "periodic" else {}
    more |= {} if lifespan is None else {"lifespan": lifespan}
    if options["full"] == "block" and count > LENGTH:
        count = LENGTH

    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                connector = await one.connect(source.out, "two/sink0.inp", keep_last=True, **options, **more)
                await asyncio.sleep(0.5)
                for value in range(1, READ + 1):
                    source.out.write_nowait(long(value))
                await asyncio.sleep(5)
                sink.inp.drain()
            for value in range(READ + 1, READ + count + 1):
                source.out.write_nowait(long(value))
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                got = []
                for _ in range(300):
                    await asyncio.sleep(0.02)
                    got += [sample.data for sample in sink.inp.drain()]
            assert got == expected(options, count)
            assert connector.statistics.balanced

    simulate(run())


@pytest.mark.parametrize("gone", [0.01, 0.5, 5.0])
@pytest.mark.parametrize("options", EVERY, ids=lambda one: "-".join(one.values()))
def test_each_of_many_readers_has_everything_in_order_and_the_last_sample_once(
    options: dict[str, Any], gone: float
) -> None:
    """However far the periods have gone when the reader comes."""
    more: dict[str, Any] = {"skip": 2} if options["push"] == "skip" else {}
    more |= {"push_rate": 5.0} if options["subscription"] == "periodic" else {}

    async def run() -> None:
        network, value = MemoryNetwork(delay=0.001), 0
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            connector = None
            for count in (3, 7, 0, 1, 4):
                async with kernel_of(network, "two") as two:
                    sink = await two.add(Sink())
                    if connector is None:
                        connector = await one.connect(source.out, "two/sink0.inp", keep_last=True, **options, **more)
                    got = []
                    for _ in range(200):
                        await asyncio.sleep(0.02)
                        got += [sample.data for sample in sink.inp.drain()]
                    assert got == sorted(set(got))
                    assert value == 0 or got[-1] == value
                for _ in range(count):
                    value += 1
                    source.out.write_nowait(long(value))
                    await asyncio.sleep(0.01)
                await asyncio.sleep(gone)
            assert connector is not None
            assert connector.statistics.balanced

    simulate(run())


def test_a_new_reader_of_a_link_that_pulls_has_the_last_sample_once() -> None:
    async def run() -> None:
        network, written = MemoryNetwork(delay=0.001), -1
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            for count in (2, 0, 1, 9):
                async with kernel_of(network, "two") as two:
                    sink = await two.add(Sink())
                    if count == 2:
                        await one.connect(source.out, "two/sink0.inp", keep_last=True, dataflow="pull")
                    got = []
                    for _ in range(100):
                        await asyncio.sleep(0.02)
                        got += [sample.data for sample in sink.inp.drain()]
                    assert got == ([] if count == 2 else [written])
                for value in range(count):
                    source.out.write_nowait(long(value))
                    written = value
                await asyncio.sleep(0.1)

    simulate(run())


@pytest.mark.parametrize("gone", [0.1, 5.0])
@pytest.mark.parametrize("options", [{}, {"subscription": "flush"}, {"subscription": "periodic", "push_rate": 5.0}])
def test_a_last_sample_that_has_expired_while_it_waited_is_offered_anew(options: dict[str, Any], gone: float) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            async with kernel_of(network, "two") as two:
                await two.add(Sink())
                await one.connect(source.out, "two/sink0.inp", keep_last=True, lifespan=1.0, **options)
                await asyncio.sleep(1)
            source.out.write_nowait(long(1))
            source.out.write_nowait(long(2))
            await asyncio.sleep(gone)
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                got = []
                for _ in range(100):
                    await asyncio.sleep(0.02)
                    got += [sample.data for sample in sink.inp.drain()]
                assert got == sorted(set(got))
                assert got[-1] == 2

    simulate(run())
