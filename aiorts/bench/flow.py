"""Workloads through aiorts: two components and one connector each time, with everything on that a user has on."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import repeat
from time import perf_counter_ns, process_time_ns
from typing import Any, Final

from aiorts import Component, Connector, EventContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.bench.bare import DEPTH, PACE
from aiorts.bench.case import Ledger, Reading
from aiorts.types import TimedDouble, TimedDoubleSeq

__all__ = (
    "BURST",
    "PRODUCER_PERIOD_NS",
    "PUSH_RATE",
    "event_drain",
    "event_single",
    "flush_array",
    "flush_pair",
    "flush_wake",
    "new_tasks",
    "new_wake",
    "periodic_age",
    "periodic_all",
)

LOSSLESS: Final = {"length": DEPTH, "full": "block", "timeout": None}
PUSH_RATE: Final = 200.0
"""Hz of the periodic connectors: one period is `PACE`."""
BURST: Final = 1000
"""Messages for each period of the periodic throughput."""
PRODUCER_PERIOD_NS: Final = 1_000_000
_MEGABYTE: Final = 131_072
"""Doubles in one."""


class Source(Component):
    """Where messages come from; the workload writes."""

    out = OutPort(TimedDouble)


class Ticker(Component):
    """Writes what time it is, once a cycle."""

    out = OutPort(TimedDouble)

    async def on_execute(self) -> None:
        await self.out.write(TimedDouble(perf_counter_ns(), 0.0))


class Sink(Component):
    """Where messages end; the workload reads, or a class below does."""

    inp = InPort(TimedDouble)


class Counting(Sink):
    """A sink that says when `expected` messages are there."""

    def __init__(self, name: str, expected: int) -> None:
        super().__init__(name)
        self.left = expected
        self.received = 0
        self.complete = asyncio.get_running_loop().create_future()

    def took(self, count: int) -> None:
        """So many more were read."""
        self.received += count
        self.left -= count
        if self.left <= 0 and not self.complete.done():
            self.complete.set_result(None)


class Drainer(Counting):
    """Takes all there is in each cycle."""

    async def on_execute(self) -> None:
        self.took(len(self.inp.drain()))


class Single(Counting):
    """Takes one message in each cycle."""

    async def on_execute(self) -> None:
        self.inp.read_nowait()
        self.took(1)


class Clocked(Counting):
    """Notes when it ran, before it reads."""

    def __init__(self, name: str, expected: int) -> None:
        super().__init__(name, expected)
        self.ran: list[int] = []

    async def on_execute(self) -> None:
        self.ran.append(perf_counter_ns())
        self.inp.read_nowait()
        self.took(1)


class Ages(Counting):
    """Notes how old each message is when it is read; the writer put the time of writing into `tm`."""

    def __init__(self, name: str, expected: int) -> None:
        super().__init__(name, expected)
        self.ages: list[int] = []

    async def on_execute(self) -> None:
        sample = self.inp.read_nowait()
        self.ages.append(perf_counter_ns() - sample.tm)
        self.took(1)


@asynccontextmanager
async def _joined(out: Component, in_: Component, **options: Any) -> AsyncIterator[tuple[Kernel, Connector]]:
    """A kernel with two components and one connector between their only ports."""
    async with Kernel() as kernel:
        await kernel.add(out)
        await kernel.add(in_)
        connector = await kernel.connect(out.ports["out"], in_.ports["inp"], **options)
        yield kernel, connector


async def flush_pair(count: int) -> Reading:
    """write_nowait and read_nowait in one task."""
    source, sink = Source("source"), Sink("sink")
    async with _joined(source, sink) as (_, connector):
        sample, write, read = TimedDouble(0, 1.0), source.out.write_nowait, sink.inp.read_nowait
        began = perf_counter_ns()
        for _ in repeat(None, count):
            write(sample)
            read()
        return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, count))


class ArraySource(Component):
    """Where arrays come from."""

    out = OutPort(TimedDoubleSeq)


class ArraySink(Component):
    """Where arrays end."""

    inp = InPort(TimedDoubleSeq)


async def flush_array(count: int) -> Reading:
    """The same as `flush_pair` with an array of 1 MB, the record built once."""
    source, sink = ArraySource("source"), ArraySink("sink")
    async with _joined(source, sink) as (_, connector):
        sample = TimedDoubleSeq(0, [0.0] * _MEGABYTE)
        write, read = source.out.write_nowait, sink.inp.read_nowait
        began = perf_counter_ns()
        for _ in repeat(None, count):
            write(sample)
            read()
        return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, count))


async def _produce(source: Source, count: int) -> None:
    sample, write = TimedDouble(0, 1.0), source.out.write
    for _ in repeat(None, count):
        await write(sample)


async def new_tasks(count: int) -> Reading:
    """new/all without loss between two tasks that await."""
    source, sink = Source("source"), Sink("sink")

    async def consume() -> None:
        read = sink.inp.read
        for _ in repeat(None, count):
            await read()

    async with _joined(source, sink, subscription="new", push="all", **LOSSLESS) as (_, connector):
        began = perf_counter_ns()
        await asyncio.gather(_produce(source, count), consume())
        return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, count))


async def _into_event_context(sink: Counting, count: int) -> Reading:
    source = Source("source")
    async with _joined(source, sink, **LOSSLESS) as (kernel, connector):
        await kernel.start(EventContext(), sink, activate=True)
        began = perf_counter_ns()
        await _produce(source, count)
        await sink.complete
        return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, sink.received))


async def event_drain(count: int) -> Reading:
    """flush, awaited writes into an event context whose component takes all there is."""
    return await _into_event_context(Drainer("sink", count), count)


async def event_single(count: int) -> Reading:
    """flush, awaited writes into an event context whose component takes one message in each cycle."""
    return await _into_event_context(Single("sink", count), count)


async def _wake(count: int, subscription: str) -> Reading:
    source, sink = Source("source"), Clocked("sink", count)
    async with _joined(source, sink, subscription=subscription) as (kernel, connector):
        await kernel.start(EventContext(), sink, activate=True)
        sample, write = TimedDouble(0, 1.0), source.out.write_nowait
        wrote: list[int] = []
        for _ in repeat(None, count):
            await asyncio.sleep(PACE)
            wrote.append(perf_counter_ns())
            write(sample)
        await sink.complete
        latencies = tuple(after - before for before, after in zip(wrote, sink.ran, strict=True))
        return Reading(count, latencies_ns=latencies, ledger=Ledger.of(connector, sink.received))


async def flush_wake(count: int) -> Reading:
    """flush into an idle event context: from the write to the first line of on_execute."""
    return await _wake(count, "flush")


async def new_wake(count: int) -> Reading:
    """new into an idle event context: from the write to the first line of on_execute."""
    return await _wake(count, "new")


async def periodic_all(count: int) -> Reading:
    """periodic/all: a burst for each period; the rate is by the clock on the wall, the cost by the processor's."""
    source = Source("source")
    options: dict[str, Any] = {"length": BURST, "out_length": BURST, "push_rate": PUSH_RATE}
    bursts = -(-count // BURST)
    size = -(-count // bursts)
    sink = Drainer("sink", size)
    async with _joined(source, sink, subscription="periodic", push="all", **options) as (kernel, connector):
        await kernel.start(EventContext(), sink, activate=True)
        loop = asyncio.get_running_loop()
        began, used = perf_counter_ns(), process_time_ns()
        for _ in repeat(None, bursts):
            await _produce(source, size)
            await sink.complete
            sink.left, sink.complete = size, loop.create_future()
        used, elapsed = process_time_ns() - used, perf_counter_ns() - began
        sent = bursts * size
        return Reading(sent, max(1, used) / sent, sent * 1e9 / elapsed, (), Ledger.of(connector, sink.received))


async def periodic_age(count: int) -> Reading:
    """periodic/new from a producer of 1 kHz into an event context: how old a message is when it is read."""
    ticker, sink = Ticker("ticker"), Ages("sink", count)
    options: dict[str, Any] = {"subscription": "periodic", "push": "new", "push_rate": PUSH_RATE}
    async with _joined(ticker, sink, **options) as (kernel, connector):
        await kernel.start(EventContext(), sink, activate=True)
        await kernel.start(PeriodicContext(rate=1e9 / PRODUCER_PERIOD_NS), ticker, activate=True)
        await sink.complete
        return Reading(count, latencies_ns=tuple(sink.ages[:count]), ledger=Ledger.of(connector, sink.received))
