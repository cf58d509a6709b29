"""Workloads of throughput and wake-up: two components and one connector, with the checks and counts of a user's run."""

from __future__ import annotations

import asyncio
from array import array
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import repeat
from time import perf_counter_ns, process_time_ns
from typing import Any, Final, TypeAlias

from aiorts import Component, Connector, EventContext, InPort, Kernel, OutPort
from aiorts.types import TimedDouble, TimedDoubleSeq, u8
from aiorts_bench.harness.case import Ledger, Reading
from aiorts_bench.push.bare import DEPTH, PACE

LOSSLESS: Final = {"length": DEPTH, "full": "block", "timeout": None}
PUSH_RATE: Final = 200.0
"""Hz of the periodic connectors: one period is `PACE`."""
BURST: Final = 1000
"""Messages for each period of the periodic throughput."""
FAN_OUT: Final = 100
"""Readers of one writer."""


@dataclass(frozen=True)
class Pose:
    """A user's plain dataclass with a range on one field: checked at each write."""

    tm: int = 0
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    quality: u8 = 0


Payload: TypeAlias = float | int
"""The payload of a message: a float as it is; a whole number stands for an array of that many bytes."""


class Source(Component):
    """A component with the port that the workload writes to."""

    def __init__(self, name: str, type_: type = TimedDouble) -> None:
        super().__init__(name)
        self.out: OutPort[Any] = self.add_port("out", OutPort(type_))


class Sink(Component):
    """A component with the port that the workload, or a derived class, reads from."""

    def __init__(self, name: str, type_: type = TimedDouble) -> None:
        super().__init__(name)
        self.inp: InPort[Any] = self.add_port("inp", InPort(type_))


class Counting(Sink):
    """A sink whose future `complete` is done when `expected` messages were read."""

    def __init__(self, name: str, expected: int, type_: type = TimedDouble) -> None:
        super().__init__(name, type_)
        self.left = expected
        self.received = 0
        self.complete = asyncio.get_running_loop().create_future()

    def took(self, count: int) -> None:
        """Count `count` messages that were read."""
        self.received += count
        self.left -= count
        if self.left <= 0 and not self.complete.done():
            self.complete.set_result(None)


class Drainer(Counting):
    """Reads everything in each cycle."""

    async def on_execute(self) -> None:
        self.took(len(self.inp.drain()))


class Single(Counting):
    """Reads one message in each cycle."""

    async def on_execute(self) -> None:
        self.inp.read_nowait()
        self.took(1)


class Clocked(Counting):
    """Records when it ran, before it reads one message."""

    def __init__(self, name: str, expected: int) -> None:
        super().__init__(name, expected)
        self.ran = array("q")

    async def on_execute(self) -> None:
        self.ran.append(perf_counter_ns())
        self.inp.read_nowait()
        self.took(1)


class Idle(Component):
    """A component whose port has no connector."""

    inp = InPort(TimedDouble)

    async def on_execute(self) -> None:
        self.inp.drain()


@lru_cache(maxsize=4)
def record(payload: Payload) -> TimedDouble | TimedDoubleSeq:
    """The record that a workload writes each time: a float, or an array of that many bytes."""
    if isinstance(payload, float):
        return TimedDouble(0, payload)
    import numpy  # late: the command starts without it

    return TimedDoubleSeq(0, numpy.ones(max(1, payload // 8)))


@asynccontextmanager
async def joined(out: Component, *ins: Component, **options: Any) -> AsyncIterator[tuple[Kernel, list[Connector]]]:
    """Open a kernel with a writer, its readers, and one connector to the port `inp` of each."""
    async with Kernel() as kernel:
        await kernel.add(out)
        connectors = []
        for component in ins:
            await kernel.add(component)
            connectors.append(await kernel.connect(out.ports["out"], component.ports["inp"], **options))
        yield kernel, connectors


def pair(payload: Payload | Pose = 1.0, **options: Any) -> Callable[[int], Any]:
    """A workload: write_nowait and read_nowait in one task."""

    async def run(count: int) -> Reading:
        sample = payload if isinstance(payload, Pose) else record(payload)
        source, sink = Source("source", type(sample)), Sink("sink", type(sample))
        async with joined(source, sink, **options) as (_, (connector,)):
            write, read = source.out.write_nowait, sink.inp.read_nowait
            began = perf_counter_ns()
            for _ in repeat(None, count):
                write(sample)
                read()
            return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, count))

    return run


async def fan_out(count: int) -> Reading:
    """Write to `FAN_OUT` readers with flush; the cost is that of one delivery."""
    source, sinks = Source("source"), [Sink(f"sink{number}") for number in range(FAN_OUT)]
    turns = max(1, count // FAN_OUT)
    async with joined(source, *sinks) as (_, connectors):
        sample, write = record(1.0), source.out.write_nowait
        reads = [sink.inp.read_nowait for sink in sinks]
        began = perf_counter_ns()
        for _ in repeat(None, turns):
            write(sample)
            for read in reads:
                read()
        elapsed = perf_counter_ns() - began
        ledger = sum((Ledger.of(connector, turns) for connector in connectors), Ledger())
        return Reading.timed(turns * FAN_OUT, elapsed, ledger)


async def pairs(count: int) -> Reading:
    """Write from `FAN_OUT` writers in turn, each to its reader: as many connectors and cold caches as `fan_out`."""
    turns = max(1, count // FAN_OUT)
    async with Kernel() as kernel:
        ends, connectors = [], []
        for number in range(FAN_OUT):
            source = await kernel.add(Source(f"source{number}"))
            sink = await kernel.add(Sink(f"sink{number}"))
            connectors.append(await kernel.connect(source.out, sink.inp))
            ends.append((source.out.write_nowait, sink.inp.read_nowait))
        sample = record(1.0)
        began = perf_counter_ns()
        for _ in repeat(None, turns):
            for write, read in ends:
                write(sample)
                read()
        elapsed = perf_counter_ns() - began
        ledger = sum((Ledger.of(connector, turns) for connector in connectors), Ledger())
        return Reading.timed(turns * FAN_OUT, elapsed, ledger)


async def _produce(source: Source, count: int, payload: Payload = 1.0) -> None:
    sample, write = record(payload), source.out.write
    for _ in repeat(None, count):
        await write(sample)


def tasks(payload: Payload = 1.0) -> Callable[[int], Any]:
    """A workload: `new` and `all`, without loss, between two tasks that await."""

    async def run(count: int) -> Reading:
        type_ = type(record(payload))
        source, sink = Source("source", type_), Sink("sink", type_)

        async def consume() -> None:
            read = sink.inp.read
            for _ in repeat(None, count):
                await read()

        async with joined(source, sink, subscription="new", push="all", **LOSSLESS) as (_, (connector,)):
            began = perf_counter_ns()
            await asyncio.gather(_produce(source, count, payload), consume())
            return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, count))

    return run


async def _into_event_context(sink: Counting, count: int) -> Reading:
    source = Source("source")
    async with joined(source, sink, **LOSSLESS) as (kernel, (connector,)):
        await kernel.start(EventContext(), sink, activate=True)
        began = perf_counter_ns()
        await _produce(source, count)
        await sink.complete
        return Reading.timed(count, perf_counter_ns() - began, Ledger.of(connector, sink.received))


async def event_drain(count: int) -> Reading:
    """Write with flush, awaited, to an event context whose component reads everything in each cycle."""
    return await _into_event_context(Drainer("sink", count), count)


async def event_single(count: int) -> Reading:
    """Write with flush, awaited, to an event context whose component reads one message in each cycle."""
    return await _into_event_context(Single("sink", count), count)


def idle_to_run(subscription: str) -> Callable[[int], Any]:
    """A workload: paced writes to an idle event context; latency is from the write to the first line of on_execute."""

    async def run(count: int) -> Reading:
        source, sink = Source("source"), Clocked("sink", count)
        async with joined(source, sink, subscription=subscription) as (kernel, (connector,)):
            await kernel.start(EventContext(), sink, activate=True)
            sample, write = record(1.0), source.out.write_nowait
            wrote = array("q")
            used, began = process_time_ns(), perf_counter_ns()
            for _ in repeat(None, count):
                await asyncio.sleep(PACE)
                wrote.append(perf_counter_ns())
                write(sample)
            await sink.complete
            cpu = 100 * (process_time_ns() - used) / (perf_counter_ns() - began)
            latencies = tuple(after - before for before, after in zip(wrote, sink.ran, strict=True))
            ledger = Ledger.of(connector, sink.received)
            return Reading({"cpu": cpu}, count, {"latency": latencies}, ledger)

    return run


def bursts(payload: Payload = 1.0) -> Callable[[int], Any]:
    """A workload: periodic/all, a burst for each period; the rate is by wall clock, the cost by processor time."""

    async def run(count: int) -> Reading:
        type_ = type(record(payload))
        options: dict[str, Any] = {"length": BURST, "out_length": BURST, "push_rate": PUSH_RATE}
        number = -(-count // BURST)
        size = -(-count // number)
        source, sink = Source("source", type_), Drainer("sink", size, type_)
        async with joined(source, sink, subscription="periodic", push="all", **options) as (kernel, (connector,)):
            await kernel.start(EventContext(), sink, activate=True)
            loop = asyncio.get_running_loop()
            began, used = perf_counter_ns(), process_time_ns()
            for _ in repeat(None, number):
                await _produce(source, size, payload)
                await sink.complete
                sink.left, sink.complete = size, loop.create_future()
            used, elapsed = max(1, process_time_ns() - used), perf_counter_ns() - began
            sent = number * size
            values = {"cost": used / sent, "rate": sent * 1e9 / elapsed, "cpu": 100 * used / elapsed}
            return Reading(values, sent, ledger=Ledger.of(connector, sink.received))

    return run


def crowd(count: int) -> Callable[[], Any]:
    """A context manager with `count` idle components, each active in an event context of its own."""

    @asynccontextmanager
    async def beside() -> AsyncIterator[None]:
        async with Kernel(name="crowd") as kernel:
            for number in range(count):
                idle = await kernel.add(Idle(f"idle{number}"))
                await kernel.start(EventContext(), idle, activate=True)
            yield

    return beside
