"""Thread contexts and the clock: virtual time and the thread wait for one another, time-outs are the clock's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.clock import ScaledClock
from aiorts.contexts.thread import ThreadContext
from aiorts.errors import ReadTimeout, WriteTimeout
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from contexts.parts import MS, Reader, S, Sender, Ticker

pytestmark = pytest.mark.anyio


class Plain(Component):
    """Does what it is told in every execution."""

    def __init__(self, name: str = "", execute: Callable[[], None] | None = None) -> None:
        super().__init__(name)
        self.execute = execute
        self.runs = 0

    def on_execute(self) -> None:
        self.runs += 1
        if self.execute is not None:
            self.execute()


async def until(done: Callable[[], bool], seconds: float = 5.0) -> None:
    """Wait for something that a thread does in real time."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it did not happen in time"
        await asyncio.sleep(0.002)


@pytest.mark.row(29)
def test_virtual_time_waits_for_the_thread_and_the_thread_for_virtual_time() -> None:
    async def main(clock: SimulatedClock) -> tuple[list[int], list[int], float]:
        moments: list[int] = []
        began = time.monotonic()

        def work() -> None:
            moments.append(clock.monotonic_ns())
            time.sleep(0.002)  # real time that no virtual time passes in
            moments.append(clock.monotonic_ns())

        async with Kernel() as kernel:
            plain, ticker = await kernel.add(Plain("plain", work)), await kernel.add(Ticker("ticker"))
            context = await kernel.start(ThreadContext(0.1), plain, activate=True)
            await kernel.start(PeriodicContext(1.0), ticker, activate=True)
            await asyncio.sleep(94.5)
            assert context.statistics.lateness_max_ns == 0
            return moments, ticker.begun, time.monotonic() - began

    moments, begun, real = simulate(main)
    assert moments == [n * 10 * S for n in range(10) for _ in range(2)]
    assert begun == [n * S for n in range(95)]
    assert real < 5.0


@pytest.mark.row(29)
async def test_virtual_time_that_is_advanced_by_hand_waits_for_the_thread_too() -> None:
    clock = SimulatedClock()
    moments: list[int] = []

    def work() -> None:
        moments.append(clock.monotonic_ns())
        time.sleep(0.002)
        moments.append(clock.monotonic_ns())

    async with Kernel(clock=clock) as kernel:
        plain = await kernel.add(Plain("plain", work))
        await kernel.start(ThreadContext(10.0), plain, activate=True)
        await clock.advance(0.95)
        assert moments == [n * 100 * MS for n in range(10) for _ in range(2)]


@pytest.mark.row(29)
@pytest.mark.parametrize("times", range(5))
def test_a_read_that_blocks_lets_virtual_time_pass_and_wakes_at_the_moment_of_the_write(times: int) -> None:
    class Source(Component):
        output = OutPort(TimedLong)

        async def on_execute(self) -> None:
            await self.output.write(TimedLong(self.clock.monotonic_ns(), 1))

    class Sink(Component):
        input = InPort(TimedLong)
        echo = OutPort(TimedLong)

        def on_activated(self) -> None:
            self.seen: list[tuple[int, int]] = []

        def on_execute(self) -> None:
            sample = self.input.read_blocking()
            self.seen.append((sample.tm, self.clock.monotonic_ns()))

    async def main(clock: SimulatedClock) -> list[tuple[int, int]]:
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
            await kernel.connect(source.output, sink.input)
            await kernel.start(ThreadContext(), sink, activate=True)
            await kernel.start(PeriodicContext(1.0), source, activate=True)
            await asyncio.sleep(49.5)
            return sink.seen

    seen = simulate(main)
    assert seen == [(n * S, n * S) for n in range(50)]


@pytest.mark.row(29)
def test_time_outs_of_blocking_reads_and_writes_are_virtual() -> None:
    class Impatient(Component):
        input = InPort(TimedLong)
        output = OutPort(TimedLong)

        def on_activated(self) -> None:
            self.late: list[tuple[type[Exception], int]] = []

        def on_execute(self) -> None:
            for wait in (
                lambda: self.input.read_blocking(7.0),
                lambda: self.output.write_blocking(TimedLong(0, 1), 5.0),
            ):
                try:
                    wait()
                except (ReadTimeout, WriteTimeout) as error:
                    self.late.append((type(error), self.clock.monotonic_ns()))

    async def main(clock: SimulatedClock) -> list[tuple[type[Exception], int]]:
        async with Kernel() as kernel:
            impatient = await kernel.add(Impatient("impatient"))
            reader, sender = await kernel.add(Reader("reader")), await kernel.add(Sender("sender"))
            await kernel.connect(impatient.output, reader.input, full="block", length=1)
            await kernel.connect(sender.output, impatient.input)
            await kernel.start(ThreadContext(), impatient, activate=True)
            await asyncio.sleep(30.0)
            return impatient.late

    began = time.monotonic()
    # the first write finds room
    assert simulate(main) == [
        (ReadTimeout, 7 * S),
        (ReadTimeout, 14 * S),
        (WriteTimeout, 19 * S),
        (ReadTimeout, 26 * S),
    ]
    assert time.monotonic() - began < 5.0


def test_without_a_rate_hooks_that_wait_for_nothing_do_not_freeze_virtual_time() -> None:
    async def main(clock: SimulatedClock) -> int:
        async with Kernel() as kernel:
            plain = await kernel.add(Plain("plain"))
            await kernel.start(ThreadContext(), plain, activate=True)
            await asyncio.sleep(0.0995)
            return plain.runs

    assert simulate(main) == 100


@pytest.mark.slow
async def test_on_a_scaled_clock_periods_and_time_outs_are_scaled() -> None:
    class Impatient(Component):
        input = InPort(TimedLong)
        late: int = 0

        def on_execute(self) -> None:
            try:
                self.input.read_blocking(5.0)
            except ReadTimeout:
                self.late += 1

    async with Kernel(clock=ScaledClock(100.0)) as kernel:
        impatient, plain = await kernel.add(Impatient("impatient")), await kernel.add(Plain("plain"))
        await kernel.start(ThreadContext(), impatient, activate=True)
        await kernel.start(ThreadContext(1.0), plain, activate=True)
        await until(lambda: impatient.late >= 3 and plain.runs > 10, 3.0)
