"""Connectors that time their publisher: the figures are those of the kernel's clock, and nothing else changes."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext
from aiorts.kernel.ports.connector import transport_of
from aiorts.testing import simulated
from aiorts.types import TimedLong

pytestmark = pytest.mark.row(61)


class Ticker(Component):
    out = OutPort(TimedLong)

    async def on_execute(self) -> None:
        await self.out.write(TimedLong(self.clock.time_ns(), self.context.ticks))


class Sink(Component):
    inp = InPort(TimedLong)


@simulated
async def test_the_period_of_a_writer_is_seen() -> None:
    async with Kernel() as kernel:
        ticker, sink = await kernel.create(Ticker), await kernel.create(Sink)
        connector = await kernel.connect(ticker.out, sink.inp, measure=10, length=100)
        await kernel.start(PeriodicContext(rate=50.0), ticker, activate=True)
        await kernel.sleep(1.005)
        timing = connector.timing
        assert timing is not None
        assert (timing.period.count, timing.period.min_ns, timing.period.max_ns) == (10, 20_000_000, 20_000_000)
        assert (timing.exec.count, timing.exec.max_ns) == (10, 0)  # virtual time stands still while a sample moves
        assert len(sink.inp.drain()) == connector.statistics.written == 51


@simulated
async def test_a_periodic_publisher_is_timed_by_its_periods_and_only_where_it_sent() -> None:
    async with Kernel() as kernel:
        ticker, sink = await kernel.create(Ticker), await kernel.create(Sink)
        connector = await kernel.connect(
            ticker.out, sink.inp, subscription="periodic", push="all", push_rate=10.0, measure=100, length=100
        )
        context = await kernel.start(PeriodicContext(rate=50.0), ticker, activate=True)
        await kernel.sleep(1.05)
        await context.deactivate()
        await kernel.sleep(5.0)
        timing = connector.timing
        assert timing is not None
        assert timing.exec.count == 11
        assert {timing.period.min_ns, timing.period.max_ns} == {100_000_000}


@simulated
async def test_a_skipped_or_rejected_sample_is_no_send() -> None:
    async with Kernel() as kernel:
        ticker, sink = await kernel.create(Ticker), await kernel.create(Sink)
        skipping = await kernel.connect(ticker.out, sink.inp, subscription="new", push="skip", skip=1, measure=100)
        other = await kernel.create(Sink)
        rejecting = await kernel.connect(ticker.out, other.inp, full="reject", length=2, measure=100)
        for number in range(6):
            ticker.out.write_nowait(TimedLong(0, number))
        assert skipping.timing is not None
        assert rejecting.timing is not None
        assert (skipping.timing.exec.count, rejecting.timing.exec.count) == (3, 2)
        assert skipping.statistics.balanced
        assert rejecting.statistics.balanced


@simulated
async def test_a_writer_that_waited_sends_when_it_is_let_in() -> None:
    async with Kernel() as kernel:
        ticker, sink = await kernel.create(Ticker), await kernel.create(Sink)
        connector = await kernel.connect(ticker.out, sink.inp, full="block", length=1, timeout=None, measure=100)
        writing = [asyncio.ensure_future(ticker.out.write(TimedLong(0, number))) for number in range(3)]
        for _ in range(3):
            await kernel.sleep(2.0)
            sink.inp.read_nowait()
        await asyncio.gather(*writing)
        assert connector.timing is not None
        assert connector.timing.period.count == 2
        assert connector.timing.period.max_ns == 2_000_000_000


@simulated
async def test_who_did_not_ask_gets_none_and_keeps_the_short_way() -> None:
    async with Kernel() as kernel:
        ticker, sink = await kernel.create(Ticker), await kernel.create(Sink)
        connector = await kernel.connect(ticker.out, sink.inp)
        assert connector.timing is None
        assert transport_of(connector).direct
