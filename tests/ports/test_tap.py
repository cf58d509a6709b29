"""A tap: a service takes what an out-port writes, in the write itself, and the system does not know it."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, KernelService, OutPort, PeriodicContext, ThreadContext
from aiorts.kernel.ports.connector import unread_of
from aiorts.system import wait_finished
from aiorts.testing import simulated

if TYPE_CHECKING:
    from aiorts import Connector


class Source(Component):
    """Sends 1, 2, ... and ends with `count`."""

    out = OutPort(int)
    count = 5
    sent = 0

    def on_execute(self) -> None:
        self.sent += 1
        self.out.write_nowait(self.sent)
        if self.sent == self.count:
            self.finish()


class Sink(Component):
    """Takes it."""

    inp = InPort(int)

    def on_execute(self) -> None:
        self.inp.drain()


class Taker(KernelService):
    """Takes what it taps, unless it is to leave it."""

    name = "taker"
    leaves = False

    def __init__(self, kernel: Any) -> None:
        super().__init__(kernel)
        self.took: list[int] = []

    def tap(self, out: OutPort[Any], **options: Any) -> Connector:
        return self.kernel.connections.tap(self, out, self._take, **{"length": 10, **options})

    def _take(self, port: InPort[Any]) -> None:
        if not self.leaves:
            self.took += port.drain()


@simulated
async def test_it_has_each_sample_when_the_write_returns_and_its_ledger_balances() -> None:
    async with Kernel() as kernel:
        taker, source, sink = kernel.service(Taker), await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = taker.tap(source.out)
        for sample in range(100):
            if sample == 50:
                await kernel.connect(source.out, sink.inp, length=1000)
            source.out.write_nowait(sample)
            assert taker.took[-1:] == [sample]
        assert taker.took == list(range(100))
        ledger = connector.statistics
        assert (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)) == (100, 100, 0, {})
        assert sink.inp.drain() == list(range(50, 100))
        connector.close()
        source.out.write_nowait(100)
        assert (connector.closed, taker.took[-1], sink.inp.drain()) == (True, 99, [100])


@simulated
async def test_the_system_is_what_it_is_without_it() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        taker = kernel.service(Taker)
        before = kernel.profile().to_plain()
        events: list[Any] = []
        from aiorts.events import Event

        kernel.bus.subscribe(Event, events.append)
        connector = taker.tap(source.out)
        assert (kernel.profile().to_plain(), events) == (before, [])
        assert (source.out.connectors, kernel.connectors, source.out.profile.connectors) == ((), {}, ())
        made = await kernel.connect(source.out, sink.inp)
        assert source.out.connectors == (made,)
        await kernel.disconnect(made)
        source.out.write_nowait(1)
        assert (source.out.connectors, taker.took) == ((), [1])
        connector.close()


@simulated
async def test_what_it_leaves_unread_holds_up_writers_or_is_dropped_and_not_the_end_of_a_run() -> None:
    async with Kernel() as kernel:
        taker, source = kernel.service(Taker), await kernel.add(Source("source"))
        taker.leaves = True
        blocking = taker.tap(source.out, length=2, full="block")
        assert await source.out.write(1)
        assert await source.out.write(2)
        waiting = asyncio.ensure_future(source.out.write(3))
        await kernel.sleep(1.0)
        assert not waiting.done()
        assert blocking.in_.drain() == [1, 2, 3]
        assert await waiting
        blocking.close()
        dropping = taker.tap(source.out, length=2)
        await kernel.start(PeriodicContext(10.0), source, activate=True)
        await asyncio.wait_for(wait_finished(kernel), 10.0)
        assert (unread_of(dropping), dict(dropping.statistics.dropped)) == (2, {"overwritten": 3})


@simulated
async def test_it_may_be_made_longer_and_shorter_while_it_holds_samples() -> None:
    async with Kernel() as kernel:
        taker, source = kernel.service(Taker), await kernel.add(Source("source"))
        taker.leaves = True
        connector = taker.tap(source.out, length=3)
        for length, sent, left in ((3, 4, [2, 3, 4]), (6, 4, [1, 2, 3, 4]), (2, 3, [2, 3])):
            kernel.connections.resize_tap(connector, length)
            for number in range(1, sent + 1):
                source.out.write_nowait(number)
            assert (connector.in_.drain(), connector.profile.length) == (left, length)
        assert connector.statistics.balanced


@pytest.mark.slow
@pytest.mark.anyio
async def test_what_a_thread_writes_is_taken_on_the_loop() -> None:
    async with Kernel() as kernel:
        taker, source = kernel.service(Taker), await kernel.add(Source("source"))
        source.count = 200
        connector = taker.tap(source.out, length=1000)
        await kernel.start(ThreadContext(rate=2000.0), source, activate=True)
        await asyncio.wait_for(wait_finished(kernel), 10.0)
        while unread_of(connector):
            await asyncio.sleep(0.01)
        assert taker.took == list(range(1, 201))


@simulated
async def test_what_its_taker_raises_is_logged_and_the_writer_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    class Bad(Taker):
        def _take(self, port: InPort[Any]) -> None:
            super()._take(port)
            raise ZeroDivisionError("no")

    async with Kernel() as kernel:
        taker, source, sink = kernel.service(Bad), await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        taker.tap(source.out)
        await kernel.connect(source.out, sink.inp)
        await kernel.start(EventContext(), sink, activate=True)
        with caplog.at_level(logging.ERROR, "aiorts"):
            source.out.write_nowait(1)
            source.out.write_nowait(2)
        assert (taker.took, source.out.connectors[0].statistics.written) == ([1, 2], 2)
    said = "service taker: source.out: its tap failed: ZeroDivisionError: no"
    assert [record.getMessage() for record in caplog.records] == [said, said]
