"""A connector with `measure` tells latency and age of what is read, on the kernel's clock; others tell neither."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from math import ceil
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, SimulatedClock, ThreadContext
from aiorts.kernel.ports.connector import transport_of
from aiorts.model.timing import Spans
from aiorts.testing import simulate, simulated
from aiorts.types import TimedLong
from campaign import CAMPAIGN

pytestmark = pytest.mark.row(60)
MS = 1_000_000
CASES = 2000 if CAMPAIGN else 20


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    into = InPort(TimedLong)


class Bare(Component):
    out = OutPort(float)
    into = InPort(float)


async def pair(kernel: Kernel, **options: Any) -> tuple[Source, Sink, Any]:
    await kernel.sleep(1.0)  # virtual time begins at 0, which is no stamp
    source, sink = await kernel.create(Source), await kernel.create(Sink)
    return source, sink, await kernel.connect(source.out, sink.into, **options)


@simulated
async def test_latency_is_from_write_to_read_and_age_from_the_stamp() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await pair(kernel, measure=100, length=10)
        for number in range(4):
            source.out.write_nowait(TimedLong(kernel.time_ns() - 5 * MS, number))
            await kernel.sleep(0.001)
        assert [sample.data for sample in sink.into.drain()] == [0, 1, 2, 3]
        counts = connector.statistics
        assert counts.latency == Spans.of([4 * MS, 3 * MS, 2 * MS, MS])
        assert counts.age == Spans.of([9 * MS, 8 * MS, 7 * MS, 6 * MS])
        assert (counts.latency.p50_ns, counts.latency.p99_ns, counts.latency.max_ns) == (2 * MS, 4 * MS, 4 * MS)
        assert (counts.at_ns, counts.mean_rate) == (kernel.clock.monotonic_ns(), 1000.0)


@simulated
async def test_what_is_not_measured_is_none_and_costs_nothing() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await pair(kernel)
        source.out.write_nowait(TimedLong(1, 1))
        assert sink.into.read_nowait().data == 1
        assert (connector.statistics.latency, connector.statistics.age) == (None, None)
        assert transport_of(connector).direct
        bare = await kernel.create(Bare)
        wire = await kernel.connect(bare.out, bare.into, measure=5)
        bare.out.write_nowait(1.0)
        await kernel.sleep(0.002)
        assert bare.into.read_nowait() == 1.0
        assert wire.statistics.latency == Spans.of([2 * MS])
        assert wire.statistics.age is None


@simulated
async def test_a_stamp_of_zero_is_none_and_only_the_last_samples_count() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await pair(kernel, measure=3, length=10)
        for late in (9, 1, 2, 3):
            source.out.write_nowait(TimedLong(0, late))
            await kernel.sleep(late / 1000)
            sink.into.read_nowait()
        assert connector.statistics.latency == Spans.of([MS, 2 * MS, 3 * MS])
        assert connector.statistics.age == Spans()


@simulated
async def test_a_periodic_connector_counts_the_time_at_the_writer() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await pair(
            kernel, measure=9, subscription="periodic", push="all", push_rate=10.0, length=9
        )
        await kernel.sleep(0.05)
        source.out.write_nowait(TimedLong(kernel.time_ns(), 1))
        await kernel.sleep(0.06)
        assert sink.into.read_nowait().data == 1
        assert connector.statistics.latency == connector.statistics.age == Spans.of([60 * MS])


@dataclass
class Step:
    kind: str
    wait: int


STEPS = st.builds(Step, st.sampled_from(["write", "write", "read", "latest", "drain"]), st.integers(0, 3))
OPTIONS = st.sampled_from(
    [
        {"full": "overwrite"},
        {"full": "reject"},
        {"subscription": "new", "push": "new"},
        {"lifespan": 1000.0},
        {"lifespan": 0.0035},
        {"dataflow": "pull"},
    ]
)


@pytest.mark.slow
@settings(max_examples=CASES, deadline=None)
@given(st.lists(STEPS, max_size=40), OPTIONS, st.integers(1, 4), st.integers(1, 30))
def test_the_figures_are_those_of_what_was_read(
    steps: list[Step], options: dict[str, Any], length: int, measure: int
) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink, connector = await pair(kernel, measure=measure, length=length, **options)
            latencies: list[int] = []
            for step in steps:
                await kernel.sleep(step.wait / 1000)
                now = kernel.time_ns()
                if step.kind == "write":
                    source.out.write_nowait(TimedLong(now, 1))
                elif step.kind == "read" and sink.into.is_new:
                    latencies.append(now - sink.into.read_nowait().tm)
                elif step.kind == "latest" and sink.into.is_new:
                    newest = sink.into.latest
                    assert newest is not None
                    latencies.append(now - newest.tm)
                elif step.kind == "drain":
                    pairs = sink.into.drain(sources=True)
                    assert all(one is connector for one, _ in pairs)
                    latencies += [now - sample.tm for _, sample in pairs]
            counts, kept = connector.statistics, sorted(latencies[-measure:])
            assert counts.balanced
            assert counts.delivered == len(latencies)
            assert counts.latency == counts.age == Spans.of(kept)
            if kept:
                assert counts.latency.p50_ns == kept[ceil(len(kept) / 2) - 1]
                assert counts.latency.p99_ns == kept[ceil(len(kept) * 99 / 100) - 1]

    simulate(main)


@simulated
async def test_a_write_that_gave_up_leaves_the_moments_of_the_others() -> None:
    async with Kernel() as kernel:
        source, sink, connector = await pair(kernel, measure=9, length=0, timeout=None)
        writes = []
        for number in range(3):
            writes.append(asyncio.ensure_future(source.out.write(TimedLong(kernel.time_ns(), number))))
            await kernel.sleep(0.001)
        writes[1].cancel()
        await kernel.sleep(0.001)
        assert [sink.into.read_nowait().data, sink.into.read_nowait().data] == [0, 2]
        await asyncio.gather(writes[0], writes[2])
        assert connector.statistics.latency == connector.statistics.age == Spans.of([4 * MS, 2 * MS])


class Reader(Component):
    into = InPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.got: list[int] = []

    def on_execute(self) -> None:
        self.got += [sample.data for sample in self.into.drain()]


def test_the_reader_may_run_in_a_thread_and_the_figures_stay_over_a_listener() -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            source, reader = await kernel.create(Source), await kernel.create(Reader)
            connector = await kernel.connect(source.out, reader.into, measure=100, length=100)
            await kernel.start(ThreadContext(100.0), reader, activate=True)
            remove = kernel.listen(connector, lambda event: None)
            for number in range(20):
                source.out.write_nowait(TimedLong(kernel.time_ns(), number))
            async with asyncio.timeout(10.0):
                while len(reader.got) < 20:
                    await asyncio.sleep(0.01)
            remove()
            source.out.write_nowait(TimedLong(kernel.time_ns(), 20))
            async with asyncio.timeout(10.0):
                while len(reader.got) < 21:
                    await asyncio.sleep(0.01)
            latency = connector.statistics.latency
            assert latency is not None
            assert (reader.got, latency.count) == (list(range(21)), 21)
            assert 0 <= latency.min_ns <= latency.p50_ns <= latency.p99_ns <= latency.max_ns

    asyncio.run(main())


@simulated
async def test_other_connectors_of_the_writer_keep_their_fast_path() -> None:
    async with Kernel() as kernel:
        source, sink, measured = await pair(kernel, measure=9)
        other = await kernel.create(Sink)
        plain = await kernel.connect(source.out, other.into)
        await kernel.start(EventContext(), other, activate=True)
        source.out.write_nowait(TimedLong(1, 1))
        assert transport_of(plain).direct
        assert not transport_of(measured).direct
        await kernel.disconnect(measured)
        again = await kernel.connect(source.out, sink.into)
        assert transport_of(again).direct


WIRES: tuple[dict[str, Any], ...] = (
    {},
    {"length": 2, "full": "reject"},
    {"push": "new", "subscription": "new"},
    {"subscription": "periodic", "push_rate": 400.0, "length": 2},
    {"lifespan": 0.002},
    {"dataflow": "pull"},
    {"length": 2, "stamp": "read"},
)
STEPS = ("write", "other", "read", "newest", "wait", "on", "off", "listen", "unlisten")


async def carried(options: dict[str, Any], steps: list[str], *, switched: bool) -> Any:
    """What is read, and the ledgers, where two writers have one reader."""
    async with Kernel() as kernel:
        source, sink, connector = await pair(kernel, **options)
        other = await kernel.create(Source)
        second = await kernel.connect(other.out, sink.into)
        read: list[Any] = []
        forget: list[Any] = []
        for number, step in enumerate(steps):
            if step in ("write", "other"):
                (source if step == "write" else other).out.write_nowait(TimedLong(1, number))
            elif step == "read":
                read += sink.into.drain()
            elif step == "newest":
                read.append(sink.into.latest)
            elif step == "wait":
                await kernel.sleep(0.001)
            elif step == "listen":
                forget.append(kernel.listen(connector, lambda event: None))
            elif step == "unlisten" and forget:
                forget.pop()()
            elif step in ("on", "off") and switched:
                kernel.connections.measure(connector, 5 if step == "on" else 0)
                assert (connector.statistics.latency is not None) is (step == "on")
        data = [None if one is None else one.data for one in read]
        return data, connector.statistics, second.statistics


@pytest.mark.slow
@given(st.sampled_from(WIRES), st.lists(st.sampled_from(STEPS), max_size=30))
@settings(max_examples=CASES, deadline=None)
def test_measuring_may_begin_and_end_at_any_time_and_changes_no_sample(
    options: dict[str, Any], steps: list[str]
) -> None:
    assert simulate(carried(options, steps, switched=True)) == simulate(carried(options, steps, switched=False))


@simulated
async def test_of_a_connector_that_is_measured_later_the_mean_rate_is_of_what_was_written_since() -> None:
    async with Kernel() as kernel:
        source, _, connector = await pair(kernel, length=100)
        for number in range(50):
            source.out.write_nowait(TimedLong(1, number))
        kernel.connections.measure(connector, 10)
        source.out.write_nowait(TimedLong(1, 50))
        await kernel.sleep(0.5)
        assert connector.statistics.mean_rate == 2.0
