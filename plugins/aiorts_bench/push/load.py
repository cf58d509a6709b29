"""Measures one way of pushing under load: paced producers, a reader of known capacity; latency, age, drops, CPU."""

from __future__ import annotations

import asyncio
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import perf_counter_ns, process_time_ns
from typing import Any, Final

from aiorts import Connector, EventContext, Kernel, PeriodicContext
from aiorts.clock import SystemClock
from aiorts_bench.harness.bench import Options
from aiorts_bench.harness.case import CPU, RATE, Case, Ledger, Measure, Reading, tails
from aiorts_bench.harness.report import Figure, Row, Series
from aiorts_bench.push.flow import Payload, Sink, Source, record

OFFERED: Final = Measure("offered", "1/s", "more")
"""Messages a second that all producers wrote together."""
LATENCY_TAILS: Final = tails("latency", 50, 99, 99.9, 100, unit="ms", digits=3)
AGE: Final = tails("age", 50, 99, unit="ms", digits=3)
COLUMNS: Final = (OFFERED, *LATENCY_TAILS, *AGE, CPU)
BURSTS: Final = 1000.0
"""The most wake-ups of a producer in a second, on absolute deadlines by the kernel's timers."""
_CLOCK: Final = SystemClock()
CAPACITY: Final = 1000.0
"""Messages that the reader of the load curves takes in a second."""
_LOADS: Final = (100, 200, 500, 800, 1000, 1250, 2000, 5000, 10_000)
_QUICK_LOADS: Final = (100, 500, 1000, 2000, 10_000)


@dataclass(frozen=True, slots=True)
class Load:
    """A way of pushing, and the load on it.

    Attributes:
        payload: 1.0 for a float record, or the bytes of an array.
        producer_rate: messages each producer writes in a second; None for as fast as it can.
        consumer_rate: cycles of each reader in a second, one message in each; None for an event-driven reader that
            reads everything.
        length: None where the push policy replaces what is unread.
    """

    subscription: str
    push: str = "all"
    full: str = "overwrite"
    payload: Payload = 1.0
    fan_in: int = 1
    fan_out: int = 1
    producer_rate: float | None = 1000.0
    consumer_rate: float | None = None
    length: int | None = 8
    push_rate: float | None = None

    @property
    def options(self) -> dict[str, Any]:
        """The options for `Kernel.connect`."""
        options: dict[str, Any] = {"subscription": self.subscription, "push": self.push, "full": self.full}
        more = {"skip": 1 if self.push == "skip" else None, "length": self.length, "push_rate": self.push_rate}
        return {**options, **{name: value for name, value in more.items() if value is not None}, "timeout": None}

    @property
    def milliseconds(self) -> int:
        """The length of one round at scale 1: twenty periods of the slowest rate in it."""
        slowest = min(rate for rate in (self.producer_rate, self.consumer_rate, self.push_rate, 80.0) if rate)
        return round(20_000 / slowest)


class Taker(Sink):
    """Reads one message in each cycle, or all; records the latency of each and the age of the newest value."""

    def __init__(self, name: str, type_: type, everything: bool) -> None:
        super().__init__(name, type_)
        self.everything = everything
        self.received = 0
        self.latencies = array("q")
        self.ages = array("q")
        self._newest = 0

    async def on_execute(self) -> None:
        port = self.inp
        samples = port.drain() if self.everything else [port.read_nowait()] if port.is_new else []
        now = perf_counter_ns()
        self.received += len(samples)
        self.latencies.extend(now - sample.tm for sample in samples)
        if samples:
            self._newest = max(self._newest, samples[-1].tm)
        if self._newest:
            self.ages.append(now - self._newest)


async def _produce(source: Source, load: Load, ends: int) -> None:
    """Write at the rate of the load until `ends`, catching up after a delay.

    Above `BURSTS` a second all messages that are due are written at once: a wake-up costs more than a write.
    """
    template = record(load.payload)
    type_: Any = type(template)
    data, write = template.data, source.out.write
    start, began, sent = _CLOCK.monotonic_ns(), perf_counter_ns(), 0
    while (now := perf_counter_ns()) < ends:
        due = sent + 256 if load.producer_rate is None else int((now - began) * load.producer_rate / 1e9) + 1
        while sent < due and (now := perf_counter_ns()) < ends:
            await write(type_(now, data))
            sent += 1
        if load.producer_rate is None:
            await asyncio.sleep(0)
        else:
            step = max(1, round(load.producer_rate / BURSTS))
            due_ns = start + round((sent + step - 1) * 1e9 / load.producer_rate)
            await source.sleep(max(0.0, (due_ns - _CLOCK.monotonic_ns()) / 1e9))


def workload(load: Load) -> Callable[[int], Any]:
    """A workload: run the load for that many milliseconds."""

    async def run(milliseconds: int) -> Reading:
        type_ = type(record(load.payload))
        sources = [Source(f"source{number}", type_) for number in range(load.fan_in)]
        takers = [Taker(f"sink{number}", type_, load.consumer_rate is None) for number in range(load.fan_out)]
        async with Kernel() as kernel:
            connectors: list[Connector] = []
            for component in (*sources, *takers):
                await kernel.add(component)
            for source in sources:
                connectors += [await kernel.connect(source.out, taker.inp, **load.options) for taker in takers]
            rate = load.consumer_rate
            context = EventContext() if rate is None else PeriodicContext(rate=rate)
            await kernel.start(context, *takers, activate=True)
            used, began = process_time_ns(), perf_counter_ns()
            ends = began + milliseconds * 1_000_000
            producers = [asyncio.create_task(_produce(source, load, ends)) for source in sources]
            await asyncio.sleep(max(0.0, (ends - perf_counter_ns()) / 1e9))
            used, elapsed = process_time_ns() - used, perf_counter_ns() - began
            reading = _reading(connectors, takers, elapsed, used)
            for producer in producers:
                producer.cancel()  # one may wait for room in a full buffer
            await asyncio.gather(*producers, return_exceptions=True)
            return reading

    return run


def _reading(connectors: list[Connector], takers: list[Taker], elapsed: int, used: int) -> Reading:
    received = sum(taker.received for taker in takers)
    ledger = sum((Ledger.of(connector, 0) for connector in connectors), Ledger(received=received))
    values = {"rate": received * 1e9 / elapsed, "offered": ledger.written * 1e9 / elapsed, "cpu": 100 * used / elapsed}
    pools = {
        "latency": [one for taker in takers for one in taker.latencies],
        "age": [one for taker in takers for one in taker.ages],
    }
    return Reading(values, max(1, received), pools, ledger)


def case(name: str, load: Load, axes: dict[str, str]) -> Case:
    """The case of a load."""
    run = workload(load)
    return Case(name, "", RATE, run, load.milliseconds, columns=COLUMNS, drawn=AGE, warm=False, axes=axes)


_POLICIES: Final = {
    "flush, overwrite": Load("flush"),
    "flush, reject": Load("flush", full="reject"),
    "flush, block": Load("flush", full="block"),
    "new/all": Load("new"),
    "new/new": Load("new", "new", length=None),
    "periodic/new, 200 Hz": Load("periodic", "new", push_rate=200.0),
}


def figures(options: Options) -> tuple[Figure, ...]:
    """Latency, age and throughput against load, from a tenth of what the reader can take to ten times as much."""
    loads = _QUICK_LOADS if options.quick else _LOADS
    cases = []
    for name, policy in _POLICIES.items():
        for rate in loads:
            load = replace(policy, producer_rate=float(rate), consumer_rate=CAPACITY)
            cases.append(case(f"{name} at {rate}/s", load, {"policy": name, "producer-rate": str(rate)}))
    scale = 0.4 if options.quick else 1.0
    short = replace(options, rounds=min(options.rounds, 3), scale=min(options.scale, scale))
    loop = options.loops[-1]
    note = (
        f"{loop}; a reader of {CAPACITY:.0f} cycles a second (dashed) that takes one message in each; "
        "length 8, new/new 1; median of the rounds with its middle half"
    )
    return curves(short.rows(tuple(cases), loop=loop), note, CAPACITY)


_CURVES: Final = (
    (RATE, "Delivered"),
    (AGE[0], "Age of the newest value when the reader runs: median"),
    (AGE[1], "Age of the newest value when the reader runs: 99th percentile"),
    (LATENCY_TAILS[0], "Latency, write to read: median"),
    (LATENCY_TAILS[1], "Latency, write to read: 99th percentile"),
)


def curves(rows: Iterable[Row], note: str = "", mark: float | None = None) -> tuple[Figure, ...]:
    """Figures over the producer's rate, with a line for each combination of the other axes.

    There are no figures when no combination was measured at two rates.
    """
    lines: dict[str, list[tuple[float, Row]]] = {}
    for row in rows:
        rate = row.case.axes.get("producer-rate", "")
        rest = [text for axis, text in row.case.axes.items() if axis != "producer-rate" and text != "-"]
        if rate and rate != "max":
            lines.setdefault(", ".join(rest) or "all", []).append((float(rate), row))
    if not any(len(line) > 1 for line in lines.values()):
        return ()
    found = []
    for measure, title in _CURVES:
        series = tuple(Series(name, _points(line, measure)) for name, line in lines.items())
        axes = ("messages offered by each producer", "1/s", measure.name, measure.unit)
        found.append(Figure(title, *axes, series, "xy", note, mark))
    return tuple(found)


def _points(line: list[tuple[float, Row]], measure: Measure) -> tuple[tuple[float, float, float, float], ...]:
    return tuple(
        (rate, spread.median, spread.q1, spread.q3)
        for rate, row in sorted(line, key=lambda point: point[0])
        if (figured := row.figures.get(measure.name)) is not None
        for spread in (figured.spread,)
    )
