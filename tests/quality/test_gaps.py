"""`max_gap`: an event when a writer has not written for longer, one when it writes again."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest

from aiorts import (
    Component,
    Composite,
    Connector,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.cli.runtime.dump import state_of
from aiorts.cli.runtime.status import figures_of, text_of
from aiorts.errors import PortTypeError, StateError, WiringError
from aiorts.events import Event, WriterBack, WriterSilent
from aiorts.testing import simulate, simulated
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Ticker(Component):
    """Writes in each cycle unless it is quiet."""

    out = OutPort(TimedLong)
    quiet = False

    def on_execute(self) -> None:
        if not self.quiet:
            self.out.write_nowait(TimedLong(0, 1))


class Heard:
    """The events of one kernel, each with the time it came at."""

    def __init__(self, kernel: Kernel) -> None:
        self.events: list[tuple[str, float]] = []
        self._kernel = kernel
        for kind in (WriterSilent, WriterBack):
            kernel.bus.subscribe(kind, self._note)

    def _note(self, event: Event) -> None:
        self.events.append((type(event).__name__, round(self._kernel.clock.monotonic_ns() / 1e9, 6)))

    def take(self) -> list[tuple[str, float]]:
        taken, self.events = self.events, []
        return taken


async def connected(kernel: Kernel, **options: Any) -> tuple[Source, Sink, Connector]:
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    return source, sink, await kernel.connect(source.out, sink.inp, **{"max_gap": 1.0, **options})


def write(source: Source) -> None:
    source.out.write_nowait(TimedLong(0, 1))


@simulated
async def test_a_gap_is_found_within_two_of_them_and_its_end_at_once(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        source, _, wire = await connected(kernel)
        for _ in range(10):
            write(source)
            await asyncio.sleep(0.9)
        assert heard.take() == []
        await asyncio.sleep(10)
        ((what, when),) = heard.take()
        assert what == "WriterSilent"
        assert 9.1 < when <= 10.2
        assert (wire.statistics.missed_gaps, wire.statistics.silent) == (1, True)
        write(source)
        now = round(kernel.clock.monotonic_ns() / 1e9, 6)
        await asyncio.sleep(0)
        assert heard.take() == [("WriterBack", now)]
        assert (wire.statistics.missed_gaps, wire.statistics.silent) == (1, False)
        await asyncio.sleep(5)
        assert [what for what, _ in heard.take()] == ["WriterSilent"]


@simulated
async def test_a_writer_with_just_this_period_is_in_time(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        ticker, sink = await kernel.add(Ticker("ticker")), await kernel.add(Sink("sink"))
        await kernel.connect(ticker.out, sink.inp, max_gap=0.1)
        await kernel.start(PeriodicContext(rate=10.0), ticker, activate=True)
        await asyncio.sleep(60)
        assert heard.take() == []
        ticker.quiet = True
        await asyncio.sleep(60)
        assert [what for what, _ in heard.take()] == ["WriterSilent"]
        ticker.quiet = False
        await asyncio.sleep(60)
        assert [what for what, _ in heard.take()] == ["WriterBack"]


@simulated
async def test_it_counts_while_both_ends_are_active(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        ticker, sink = await kernel.add(Ticker("ticker")), await kernel.add(Sink("sink"))
        await kernel.connect(ticker.out, sink.inp, max_gap=0.5)
        writer = await kernel.start(PeriodicContext(rate=10.0), ticker)
        reader = await kernel.start(EventContext(), sink)
        before = simulated_clock.pending
        for change in (writer.activate, writer.deactivate, reader.activate):
            await change()
            await asyncio.sleep(5)
            assert heard.take() == []
            assert simulated_clock.pending == before
        ticker.quiet = True
        await writer.activate()
        await asyncio.sleep(5)
        assert [what for what, _ in heard.take()] == ["WriterSilent"]
        await writer.deactivate()
        ticker.quiet = False
        await asyncio.sleep(5)
        await writer.activate()
        await asyncio.sleep(5)
        assert [what for what, _ in heard.take()] == ["WriterBack"]
        await writer.stop()
        await kernel.remove(ticker)
        await asyncio.sleep(5)
        assert heard.take() == []


def test_it_keeps_no_simulation_alive() -> None:
    """Where nothing else can happen the writer is silent soon, and then nothing is left."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            source, sink, _ = await connected(kernel)
            write(source)
            sink.inp.drain()
            await sink.inp.read()

    with pytest.raises(StateError, match="nothing"):
        simulate(main)


@simulated
async def test_a_write_that_is_refused_is_none(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        source, _, _ = await connected(kernel)
        await asyncio.sleep(3)
        assert [what for what, _ in heard.take()] == ["WriterSilent"]
        for _ in range(2):
            with pytest.raises(PortTypeError):
                source.out.write_nowait("no sample")  # type: ignore[arg-type]
            await asyncio.sleep(3)
            assert heard.take() == []
        write(source)
        await asyncio.sleep(0)
        assert [what for what, _ in heard.take()] == ["WriterBack"]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"lifespan": 0.5},
        {"subscription": "new"},
        {"subscription": "periodic", "push_rate": 3.0},
        {"dataflow": "pull"},
        {"full": "reject", "length": 1},
    ],
    ids=str,
)
@simulated
async def test_each_kind_of_connector_is_watched(simulated_clock: SimulatedClock, options: dict[str, Any]) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        source, _, _ = await connected(kernel, **options)
        kernel.listen(source.out.connectors[0], lambda event: None)
        for _ in range(3):
            for _ in range(3):
                write(source)
                await asyncio.sleep(0.9)
            assert [what for what, _ in heard.take()] in ([], ["WriterBack"])
            await asyncio.sleep(3)
            assert [what for what, _ in heard.take()] == ["WriterSilent"]


@simulated
async def test_a_write_that_waits_for_room_is_one(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        source, sink, _ = await connected(kernel, full="block", length=1, timeout=None)
        write(source)
        await asyncio.sleep(3)
        waiting = asyncio.create_task(source.out.write(TimedLong(0, 2)))
        await asyncio.sleep(0.1)
        assert [what for what, _ in heard.take()] == ["WriterSilent", "WriterBack"]
        sink.inp.drain()
        await waiting


@simulated
async def test_each_is_a_line_in_the_log(simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "aiorts.kernel")
    async with Kernel() as kernel:
        source, _, _ = await connected(kernel, name="wire")
        await asyncio.sleep(3)
        write(source)
        await asyncio.sleep(0)
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("wire")]
    assert lines == ["wire: source.out has not written for more than 1 s", "wire: source.out writes again"]


@simulated
async def test_the_log_counts_gaps_that_follow_soon(
    simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    async with Kernel() as kernel:
        source, _, wire = await connected(kernel, name="wire")
        for _ in range(31):
            await asyncio.sleep(2.5)
            write(source)
        await kernel.disconnect(wire)
        assert wire.statistics.silent is False
    lines = [record.getMessage() for record in caplog.records if record.getMessage().startswith("wire")]
    assert lines == [
        "wire: source.out has not written for more than 1 s",
        "wire: source.out has not written for more than 1 s, and 23 times more since the line before",
        "wire: source.out was silent 6 times more",
    ]


@simulated
async def test_nothing_is_left_of_it_after_the_end(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        timers, observers = simulated_clock.pending, len(kernel.bus.observers)
        _, _, wire = await connected(kernel)
        assert simulated_clock.pending == timers + 1
        await kernel.disconnect(wire)
        assert (simulated_clock.pending, len(kernel.bus.observers)) == (timers, observers)


@pytest.mark.parametrize("bad", [0, -1, 1e-9, float("nan"), float("inf"), "soon", True])
@simulated
async def test_a_gap_that_is_no_time_is_refused(simulated_clock: SimulatedClock, bad: Any) -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=r"max_gap = .*: expected a number from 0\.001"):
            await connected(kernel, max_gap=bad)


@pytest.mark.parametrize("context", [PeriodicContext, ThreadContext, RealtimeContext])
@simulated
async def test_a_writer_of_any_context_is_watched(simulated_clock: SimulatedClock, context: Any) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        ticker, sink = await kernel.add(Ticker("ticker")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(ticker.out, sink.inp, max_gap=0.25)
        run = await kernel.start(context(rate=10.0), ticker, activate=True)
        for ticker.quiet in (False, True, False, True, False):
            await asyncio.sleep(3)
            assert [what for what, _ in heard.take()] in (["WriterSilent" if ticker.quiet else "WriterBack"], [])
        assert (wire.statistics.missed_gaps, wire.statistics.silent) == (2, False)
        await run.stop()
        await asyncio.sleep(3)
        assert heard.take() == []


@simulated
async def test_members_of_a_composite_are_watched(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        heard = Heard(kernel)
        ticker, sink = await kernel.add(Ticker("ticker")), await kernel.add(Sink("sink"))
        await kernel.connect(ticker.out, sink.inp, max_gap=0.25)
        whole = await kernel.add(Composite("whole", ticker, sink))
        run = await kernel.start(PeriodicContext(rate=10.0), whole)
        await asyncio.sleep(3)
        assert heard.take() == []
        ticker.quiet = True
        await run.activate(whole)
        await asyncio.sleep(3)
        assert [what for what, _ in heard.take()] == ["WriterSilent"]
        ticker.quiet = False
        await asyncio.sleep(3)
        assert [what for what, _ in heard.take()] == ["WriterBack"]
        await run.deactivate(whole)
        await asyncio.sleep(3)
        assert heard.take() == []


def test_the_terminal_and_sigusr1_show_who_is_silent_and_how_old_samples_are() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker, sink = await kernel.create(Ticker, "ticker"), await kernel.create(Sink, "sink")
            await kernel.connect(ticker.out, sink.inp, max_gap=0.25, measure=10, stamp="send")
            await kernel.start(PeriodicContext(10.0), ticker, activate=True)
            await clock.advance(0.3)
            assert len(sink.inp.drain()) == 4
            assert "silent" not in state_of(kernel)[-1]
            assert figures_of(kernel).silent == 0
            ticker.quiet = True
            await clock.advance(1.0)
            line = state_of(kernel)[-1]
            assert line.startswith(
                "connector ticker.out-sink.inp: 4 written, 4 delivered, 0 buffered, 0 dropped, latency "
            )
            assert line.endswith(" ms at worst; its writer is silent")
            assert ", age " in line
            assert figures_of(kernel).silent == 1
            assert "1 silent" in text_of(1.0, figures_of(kernel), None)

    simulate(main)
