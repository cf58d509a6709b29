"""`lifespan` over a link: what is too old when it is read is dropped, however long it waited at which end."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.model.links import ReaderEnd, WriterEnd
from aiorts.model.links.frames import AGED, ages_of, data, head_of, samples_of
from aiorts.testing import MemoryNetwork, simulate
from links.link_pair import MS, Pair
from links.memory_kernels import Sink, Source, kernel_of, long, until

OPTIONS: Any = [
    {},
    {"subscription": "flush", "length": 8},
    {"subscription": "periodic", "push_rate": 1000.0, "push": "all", "out_length": 20},
]


def end_of(kernel: Kernel) -> Any:
    (connector,) = kernel.connectors.values()
    return connector


@pytest.mark.parametrize("options", OPTIONS)
def test_what_was_not_read_in_time_is_dropped_as_expired_at_the_readers_end(options: dict[str, Any]) -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", lifespan=1.0, **options)
            for value in range(4):
                await source.out.write(long(value))
                await asyncio.sleep(0.4)
            assert [sample.data for sample in sink.inp.drain()] == [2, 3]
            await until(lambda: not connector.statistics.in_flight)
            assert end_of(two).statistics.dropped == {"expired": 2}
            await source.out.write(long(4))  # what was lost since the last acknowledgement is told with the next
            await until(lambda: connector.statistics.dropped == {"expired": 2})
            await until(lambda: connector.statistics.acknowledged == 3)

    simulate(run())


def test_the_age_at_sending_counts_also_when_it_is_sent_again_after_a_cut() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            connector = await one.connect(source.out, "two/sink0.inp", lifespan=5.0)
            network.loss = 1.0
            await source.out.write(long(0))
            await asyncio.sleep(1)
            network.cut("one", "two")
            network.loss = 0.0
            await asyncio.sleep(2)
            await source.out.write(long(1))
            await asyncio.sleep(0.5)
            network.restore("one", "two")
            await until(lambda: connector.statistics.acknowledged == 2)
            await asyncio.sleep(1.2)  # the first is between 4.7 and 5 s old
            assert sink.inp.is_new
            await asyncio.sleep(0.4)
            assert [sample.data for sample in sink.inp.drain()] == [1]
            assert end_of(two).statistics.dropped == {"expired": 1}

    simulate(run())


def test_the_time_for_which_a_sample_waits_for_room_at_the_readers_end_counts() -> None:
    async def run() -> None:
        network = MemoryNetwork(delay=0.001)
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            await one.connect(source.out, "two/sink0.inp", lifespan=1.0, length=2, full="block")
            for value in range(10):
                source.out.write_nowait(long(value))
                await asyncio.sleep(0.15)
            assert sink.inp.read_nowait() == long(4)
            far = end_of(two)
            assert far.statistics.balanced
            assert far.statistics.dropped == {"expired": 4}

    simulate(run())


def test_what_waits_for_a_kernel_that_is_not_there_expires_at_the_writers_end() -> None:
    async def run() -> None:
        network = MemoryNetwork()
        async with kernel_of(network, "one") as one:
            source = await one.add(Source())
            connector = await one.connect(source.out, "two/sink0.inp", lifespan=1.0)
            source.out.write_nowait(long(0))
            await asyncio.sleep(0.6)
            source.out.write_nowait(long(1))
            await asyncio.sleep(0.6)
            assert connector.statistics.dropped == {"expired": 1}
            async with kernel_of(network, "two") as two:
                sink = await two.add(Sink())
                await until(lambda: sink.inp.is_new)
                await asyncio.sleep(0.3)
                assert [sample.data for sample in sink.inp.drain()] == [1]
            assert connector.statistics.balanced

    simulate(run())


def test_a_link_with_keep_last_and_lifespan_gives_the_last_sample_to_who_becomes_active() -> None:
    async def run() -> None:
        from aiorts import EventContext

        network = MemoryNetwork()
        async with kernel_of(network, "two") as two, kernel_of(network, "one") as one:
            source, sink = await one.add(Source()), await two.add(Sink())
            context = await two.start(EventContext(), sink)
            await one.connect(source.out, "two/sink0.inp", lifespan=1.0, keep_last=True)
            await source.out.write(long(3))
            await asyncio.sleep(5)
            await context.activate(sink)
            assert sink.inp.latest == long(3)  # offered anew, as in one kernel

    simulate(run())


def test_frames_of_links_without_lifespan_say_nothing_of_ages() -> None:
    pair = Pair(0)
    sent: list[bytes] = []
    pair.connect()
    pair.step(pair.now + 10 * MS)
    pair.offer(1)
    pair.writer.poll(pair.now, lambda head, parts: sent.append(head) is None)
    assert sent == [bytes.fromhex("02000100070000000100000000000000010000000000000001000000")]


def test_ages_are_those_at_each_sending_and_of_who_is_sent_again_to_another_reader() -> None:
    writer, first, second = WriterEnd(1, 1), ReaderEnd(1, 2), ReaderEnd(1, 3)
    writer.channel_up(0, 2)
    first.channel_up(0, 1)
    first.poll(0, lambda head, parts: writer.receive(0, head) is None)
    sent: list[bytes] = []
    for now, date in ((10, 4), (20, 15)):
        writer.date = date
        writer.offer(now, b"x")
    writer.poll(30, lambda head, parts: sent.append(head) is None)
    writer.poll(400 * MS, lambda head, parts: sent.append(head) is None)
    assert [ages_of(head, 2) for head in sent] == [(26, 15), (400 * MS - 4, 400 * MS - 15)]
    writer.channel_down(0)
    writer.date = 500 * MS
    writer.offer(500 * MS, b"z")
    writer.channel_up(600 * MS, 3)
    second.channel_up(0, 1)
    second.poll(0, lambda head, parts: writer.receive(600 * MS, head) is None)
    writer.poll(601 * MS, lambda head, parts: second.receive(7_000 * MS, head, parts) is None)
    assert second.take() is not None
    assert second.date == 6_899 * MS


@given(st.lists(st.tuples(st.binary(max_size=9), st.integers(0, 2**64 - 1)), min_size=1, max_size=20), st.booleans())
def test_samples_and_ages_of_a_frame_are_those_that_went_in(pairs: list[tuple[bytes, int]], confirm: bool) -> None:
    samples, ages = [sample for sample, _ in pairs], [age for _, age in pairs]
    frame = data(9, 5, 2, samples, confirm=confirm, ages=ages)
    kind, flags, count, first, oldest = head_of(frame, 9)
    assert (kind, flags, count, first, oldest) == (2, AGED | confirm, len(pairs), 5, 2)
    assert list(ages_of(frame, count)) == ages
    assert [bytes(one) for one in samples_of(frame, count, count)] == samples
