"""Measures how old the newest value is when it is read while the producer is ten times as fast, and memory's growth."""

from __future__ import annotations

import asyncio
import sys
from array import array
from collections.abc import Callable
from time import perf_counter_ns, process_time_ns
from typing import Any, Final

from aiorts import Component, EventContext, OutPort, PeriodicContext
from aiorts.types import TimedDouble
from aiorts_bench.harness.case import Ledger, Measure, Reading
from aiorts_bench.push.flow import Counting, joined

PRODUCER_RATE: Final = 1000.0
"""Hz of the producer."""
READER_RATE: Final = 100.0
"""Hz of a periodic reader, of a periodic connector, and messages a second that a slow event-driven reader takes."""
GROWTH: Final = Measure("growth", "blocks")
"""Blocks of memory allocated between the first quarter of a round and its end."""


class Ticker(Component):
    """Writes the time, once a cycle."""

    out = OutPort(TimedDouble)

    async def on_execute(self) -> None:
        await self.out.write(TimedDouble(perf_counter_ns(), 0.0))


class Reader(Counting):
    """Records the age of each message when it is read; `tm` is the time of writing.

    Args:
        busy: seconds that it sleeps after each message.
    """

    def __init__(self, name: str, expected: int, busy: float) -> None:
        super().__init__(name, expected)
        self.ages = array("q")
        self.busy = busy
        self.quarter = asyncio.get_running_loop().create_future()
        self._first = -(-expected // 4)

    async def on_execute(self) -> None:
        if not self.inp.is_new:
            return
        sample = self.inp.read_nowait()
        self.ages.append(perf_counter_ns() - sample.tm)
        self.took(1)
        if self.received == self._first:
            self.quarter.set_result(None)
        if self.busy:
            await asyncio.sleep(self.busy)


def age(subscription: str, *, event: bool, busy: bool = False) -> Callable[[int], Any]:
    """A workload: `push="new"` into an event context or a periodic one; `busy` makes the reader slow."""

    async def run(count: int) -> Reading:
        ticker, reader = Ticker("ticker"), Reader("reader", count, 1 / READER_RATE if busy else 0.0)
        options: dict[str, Any] = {"subscription": subscription, "push": "new"}
        if subscription == "periodic":
            options["push_rate"] = READER_RATE
        async with joined(ticker, reader, **options) as (kernel, (connector,)):
            context = EventContext() if event else PeriodicContext(rate=READER_RATE)
            await kernel.start(context, reader, activate=True)
            await kernel.start(PeriodicContext(rate=PRODUCER_RATE), ticker, activate=True)
            used, began = process_time_ns(), perf_counter_ns()
            await reader.quarter
            first = sys.getallocatedblocks()  # garbage in cycles counts, too: the runner turns the collector off
            await reader.complete
            cpu = 100 * (process_time_ns() - used) / (perf_counter_ns() - began)
            growth = sys.getallocatedblocks() - first
            ledger = Ledger.of(connector, reader.received)
            return Reading({"cpu": cpu, GROWTH.name: float(growth)}, count, {"age": tuple(reader.ages)}, ledger)

    return run
