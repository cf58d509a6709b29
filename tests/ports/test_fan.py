"""Several connectors at one port: order, fairness, the source of a sample, and queues that are nobody else's."""

from __future__ import annotations

import asyncio
import random
from collections import deque
from typing import Any

import pytest

from aiorts import InPort, Kernel, SimulatedClock
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from ports.parts import Sink, Source, data, long

pytestmark = pytest.mark.anyio


async def fan_in(kernel: Kernel, *options: dict[str, Any]) -> tuple[list[Source], InPort[TimedLong]]:
    sink = await kernel.add(Sink())
    sources = [await kernel.add(Source()) for _ in options]
    for source, given in zip(sources, options, strict=True):
        await kernel.connect(source.out, sink.inp, **given)
    return sources, sink.inp


@pytest.mark.row(43)
async def test_samples_are_read_in_order_of_arrival_and_each_tells_its_source(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {"length": 100}, {"length": 100}, {"length": 100})
        chance = random.Random(3)
        written = []
        for number in range(100):
            source = chance.choice(sources)
            source.out.write_nowait(long(number))
            written.append((number, source.out.connectors[0]))
        read = []
        while inp.is_new:
            sample = await inp.read()
            assert inp.last_source is not None
            read.append((sample.data, inp.last_source))
        assert read == written


@pytest.mark.row(43)
async def test_the_last_source_is_right_while_connectors_come_and_go(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        [first, second], inp = await fan_in(kernel, {}, {})
        one, two = inp.connectors
        assert inp.last_source is None
        await kernel.disconnect(two)
        assert inp.last_source is None
        first.out.write_nowait(long(1))
        inp.read_nowait()
        assert inp.last_source is one
        two = await kernel.connect(second.out, inp)
        assert inp.last_source is one  # the fast path read it
        second.out.write_nowait(long(2))
        inp.read_nowait()
        assert inp.last_source is two
        await kernel.disconnect(one)
        assert inp.last_source is two
        await kernel.disconnect(two)
        three = await kernel.connect(first.out, inp)
        assert inp.last_source is two  # nothing was read from the new one
        first.out.write_nowait(long(3))
        assert inp.last_source is two
        assert inp.latest is not None
        assert inp.last_source is three


@pytest.mark.row(42)
@pytest.mark.parametrize("depth", [1, 3, 8])
async def test_a_flooder_delays_a_quiet_writer_by_at_most_its_depth(depth: int, anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        [flooder, quiet], inp = await fan_in(kernel, {"length": depth}, {})
        for number in range(1_000):
            flooder.out.write_nowait(long(-1))
            if number % 100 == 50:
                quiet.out.write_nowait(long(number))
                reads = 1
                while inp.read_nowait().data != number:
                    reads += 1
                    flooder.out.write_nowait(long(-1))
                assert reads <= depth + 1


@pytest.mark.row(42)
async def test_a_connection_never_changes_the_queue_of_another(anyio_backend: Any) -> None:
    """In OpenRTM all connectors of an in-port share one ring, which every new connection sets up again and empties."""
    async with Kernel() as kernel:
        sink, first, second = await kernel.add(Sink()), await kernel.add(Source()), await kernel.add(Source())
        one = await kernel.connect(first.out, sink.inp, length=4, full="reject")
        for number in range(3):
            first.out.write_nowait(long(number))
        two = await kernel.connect(second.out, sink.inp, **{"dataport.inport.buffer.length": "1"})
        assert one.statistics.buffered == 3
        assert one.profile.length == 4
        for number in (10, 11, 12):
            second.out.write_nowait(long(number))
        assert first.out.write_nowait(long(3)) is True
        assert first.out.write_nowait(long(4)) is False
        await kernel.disconnect(two)
        assert data(sink.inp.drain()) == [0, 1, 2, 3]
        assert dict(one.statistics.dropped) == {"rejected": 1}
        assert dict(two.statistics.dropped) == {"overwritten": 2, "disconnected": 1}


@pytest.mark.row(46)
async def test_what_is_unread_can_be_asked_for_by_connector(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {}, {}, {"dataflow": "pull"})
        assert [connector.unread for connector in inp.connectors] == [0, 0, 0]
        assert not inp.is_new
        sources[1].out.write_nowait(long(1))
        sources[1].out.write_nowait(long(2))
        assert [connector.unread for connector in inp.connectors] == [0, 2, 0]
        assert inp.is_new
        sources[2].out.write_nowait(long(3))
        assert [connector.unread for connector in inp.connectors] == [0, 2, 1]
        inp.drain()
        assert [connector.unread for connector in inp.connectors] == [0, 0, 0]


async def test_the_newest_of_several_connectors_is_the_one_that_arrived_last(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        new = {"subscription": "new"}
        [one, two, three], inp = await fan_in(kernel, new, new, {})
        one.out.write_nowait(long(1))
        two.out.write_nowait(long(2))
        three.out.write_nowait(long(3))
        two.out.write_nowait(long(4))
        one.out.write_nowait(long(5))
        assert inp.read_nowait().data == 5  # the place of 1, replaced by 5
        newest = inp.latest
        assert newest is not None
        assert newest.data == 4
        assert not inp.is_new
        assert [dict(connector.statistics.dropped) for connector in inp.connectors] == [
            {"superseded": 1},
            {"superseded": 1},
            {"superseded": 1},
        ]


def test_order_and_ledgers_hold_through_every_mixture() -> None:
    """Overwriting, superseding, latest, disconnecting and blocked writers, against a plain list of what is unread."""

    async def main(clock: SimulatedClock) -> None:
        chance = random.Random(7)
        async with Kernel() as kernel:
            sources, inp = await fan_in(
                kernel, {"length": 3}, {"subscription": "new"}, {"length": 2, "full": "block", "timeout": None}
            )
            blocked: deque[asyncio.Task[bool]] = deque()
            last_of: dict[int, int] = {}
            for number in range(3_000):
                which = chance.randrange(4)
                if which < 2:
                    sources[which].out.write_nowait(long(number * 4 + which))
                elif which == 2 and len(blocked) < 4:
                    blocked.append(asyncio.create_task(sources[2].out.write(long(number * 4 + 2))))
                    await asyncio.sleep(0)
                elif which == 3 and inp.is_new:
                    sample = inp.read_nowait() if chance.random() < 0.9 else inp.latest
                    assert sample is not None
                    assert inp.last_source is not None
                    source = inp.connectors.index(inp.last_source)
                    assert sample.data % 4 == source
                    assert sample.data > last_of.get(source, -1)  # each writer's samples in its order
                    last_of[source] = sample.data
                    await asyncio.sleep(0)
                while blocked and blocked[0].done():
                    blocked.popleft()
                assert inp._tokens is not None
                for connector in inp.connectors:
                    assert inp._tokens.count(connector) == connector.unread
                    assert connector.statistics.balanced
            while blocked:
                inp.drain()
                await blocked.popleft()

    simulate(main)


@pytest.mark.row(39)
@pytest.mark.campaign
async def test_new_never_strands_the_newest_sample(anyio_backend: Any) -> None:
    """In OpenRTM a value written while the one before is being delivered stays in the sender until the next write."""
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        await kernel.connect(source.out, sink.inp, subscription="new")
        received: list[int] = []

        async def read() -> None:
            while True:
                received.append((await sink.inp.read()).data)

        reading = asyncio.create_task(read())
        for number in range(1_000):
            source.out.write_nowait(long(2 * number))
            for _ in range(number % 3):  # while the one before is being delivered: at its wake-up, in between, after it
                await asyncio.sleep(0)
            source.out.write_nowait(long(2 * number + 1))
            for _ in range(5):  # then silence
                await asyncio.sleep(0)
            assert received[-1] == 2 * number + 1
        reading.cancel()
        await asyncio.wait([reading])


@pytest.mark.row(41)
async def test_a_reader_is_fast_again_once_nobody_waits_for_room(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        sources, inp = await fan_in(kernel, {"length": 1, "full": "block"})
        fast = inp._fast
        await sources[0].out.write(long(1))
        writer = asyncio.ensure_future(sources[0].out.write(long(2)))
        await asyncio.sleep(0)
        assert inp._fast is not fast
        assert inp.read_nowait().data == 1
        assert await writer
        assert inp._fast is fast
        assert inp.read_nowait().data == 2
