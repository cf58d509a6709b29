"""What else the kernel does while a write waits for its read: reloads, restarts, listeners, threads, a run's end."""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts import (
    Component,
    Composite,
    Connector,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    SimulatedClock,
    Supervision,
    ThreadContext,
)
from aiorts.errors import AiortsError, ClosedError, ReadTimeout, StateError, ThreadError, WriteTimeout
from aiorts.events import ConnectorEvent
from aiorts.system import build, load, wait_finished
from aiorts.testing import simulate, simulated
from aiorts.types import TimedLong
from campaign import CAMPAIGN
from reload_files import Source as File

pytestmark = pytest.mark.row(38)


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Writer(Component):
    """Writes its next number in each cycle."""

    out = OutPort(TimedLong)
    count = 0

    async def on_execute(self) -> None:
        await self.out.write(long(self.count))
        self.count += 1


def long(number: int) -> TimedLong:
    return TimedLong(0, number)


def data(samples: list[TimedLong]) -> list[int]:
    return [sample.data for sample in samples]


def counts(connector: Connector) -> tuple[int, int, int, dict[str, int]]:
    """Written, delivered, buffered, dropped."""
    ledger = connector.statistics
    assert ledger.balanced
    return ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)


MIDDLE = """
class Middle(Component):
    data = InPort(TimedLong)
    out = OutPort(TimedLong)

    async def on_execute(self):
        # before
        for sample in self.data.drain():
            await self.out.write(sample)
"""
EDITS = {
    "good": ("# before", "pass"),
    "bad": ("# before", "1 / 0"),
}


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("options", [{"length": 0}, {"length": 1, "full": "block"}], ids=["rendezvous", "block"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("edit", EDITS)
def test_no_sample_is_lost_while_the_reader_gets_other_code(
    tmp_path: Path, edit: str, seed: int, options: dict[str, Any]
) -> None:
    """Bad code leaves a sample unread, and the writer waits: the old code runs for it, though no other sample comes."""

    async def main() -> None:
        file = File(tmp_path, MIDDLE)
        try:
            async with Kernel() as kernel:
                writer = await kernel.create(Writer, "writer")
                middle: Any = await kernel.create(file.get("Middle"), "middle")
                sink = await kernel.create(Sink, "sink")
                first = await kernel.connect(writer.out, middle.data, timeout=None, **options)
                last = await kernel.connect(middle.out, sink.inp, length=100_000)
                await kernel.start(EventContext(), middle, activate=True)
                context = await kernel.start(PeriodicContext(rate=100.0), writer, activate=True)
                await kernel.sleep(0.2)
                file.write(MIDDLE.replace(*EDITS[edit]))
                with suppress(AiortsError):
                    await kernel.reload("Middle", cycles=3, seconds=0.1)
                await kernel.sleep(0.2)
                await context.stop()
                await kernel.sleep(0.1)
                assert writer.count > 30
                assert data(sink.inp.drain()) == list(range(writer.count))
                for connector in (first, last):
                    assert counts(connector) == (writer.count, writer.count, 0, {})
        finally:
            file.forget()

    simulate(main(), seed=seed)


@simulated
async def test_a_reader_that_is_restarted_meets_its_writer_again(simulated_clock: SimulatedClock) -> None:
    class Failing(Component):
        inp = InPort(TimedLong)

        def on_execute(self) -> None:
            if self.inp.read_nowait().data == 3:
                raise RuntimeError("three")

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Failing("sink"))
        before = await kernel.connect(source.out, sink.inp, length=0)
        await kernel.start(EventContext(), sink, activate=True)
        kernel.supervise(sink, Supervision("restart"))
        writes = [asyncio.create_task(source.out.write(long(number))) for number in range(6)]
        assert await asyncio.gather(*writes) == [True] * 6
        assert counts(before) == (6, 4, 0, {"inactive": 2})
        await asyncio.sleep(5)
        after = kernel.connectors[before.name]
        assert after is not before
        assert after.profile == before.profile
        await source.out.write(long(7))
        assert counts(after) == (1, 1, 0, {})


@simulated
async def test_listeners_hear_what_becomes_of_each_sample(simulated_clock: SimulatedClock) -> None:
    heard: list[tuple[str, int | None]] = []

    def hear(event: ConnectorEvent) -> None:
        heard.append((str(event.kind), None if event.sample is None else event.sample.data))

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=0.1)
        kernel.listen(wire, hear, "send", "received", "buffer_read", "superseded", "buffer_write_timeout")
        write = asyncio.create_task(source.out.write(long(1)))
        await asyncio.sleep(0)
        assert sink.inp.read_nowait() == long(1)
        await write
        writes = [asyncio.create_task(source.out.write(long(number))) for number in (2, 3)]
        await asyncio.sleep(0)
        assert sink.inp.latest == long(3)
        await asyncio.gather(*writes)
        with pytest.raises(WriteTimeout):
            await source.out.write(long(4))
        await asyncio.sleep(0)
        sends = [(kind, number) for number in (1, 2, 3, 4) for kind in ("send", "received")]
        assert sorted(heard) == sorted(
            [*sends, ("buffer_read", 1), ("buffer_read", 3), ("superseded", 2), ("buffer_write_timeout", 4)]
        )
        assert counts(wire) == (4, 2, 0, {"superseded": 1, "timeout": 1})


@simulated
async def test_a_write_that_waits_when_a_listener_comes_and_goes_is_still_waited_for(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None)
        first = asyncio.create_task(source.out.write(long(1)))
        await asyncio.sleep(0)
        remove = kernel.listen(wire, lambda event: None)
        second = asyncio.create_task(source.out.write(long(2)))
        await asyncio.sleep(0)
        remove()
        first.cancel()
        await asyncio.sleep(0)
        assert data(sink.inp.drain()) == [2]
        assert await second is True
        assert counts(wire) == (1, 1, 0, {})


@simulated
async def test_a_run_waits_for_a_write_that_waits(simulated_clock: SimulatedClock) -> None:
    class Done(Component):
        out = OutPort(TimedLong)

        def on_activated(self) -> None:
            self.task = asyncio.create_task(self.send())
            self.finish()

        async def send(self) -> None:
            for number in range(5):
                await self.out.write(long(number))

    class Slow(Component):
        inp = InPort(TimedLong)

        def on_execute(self) -> None:
            if self.inp.is_new:
                self.inp.read_nowait()

    async with Kernel() as kernel:
        done, slow = await kernel.add(Done("done")), await kernel.add(Slow("slow"))
        wire = await kernel.connect(done.out, slow.inp, length=0, timeout=None)
        await kernel.start(PeriodicContext(rate=2.0), slow, activate=True)
        await kernel.start(EventContext(), done, activate=True)
        assert await wait_finished(kernel) == ()
        assert counts(wire) == (5, 5, 0, {})


@simulated
async def test_a_run_names_a_reader_that_never_takes(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None)
        await kernel.start(EventContext(), sink, activate=True)
        await kernel.start(PeriodicContext(rate=1.0), source, activate=True)
        write = asyncio.create_task(source.out.write(long(1)))
        source.finish()
        assert await wait_finished(kernel) == (wire,)
        write.cancel()


@simulated
async def test_a_thread_that_waits_for_a_read_ends_with_its_context(simulated_clock: SimulatedClock) -> None:
    ended: list[type[BaseException]] = []

    class Blocking(Component):
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            try:
                self.out.write_blocking(long(1))
            except (ClosedError, WriteTimeout) as error:
                ended.append(type(error))

    async with Kernel() as kernel:
        blocking, sink = await kernel.add(Blocking("blocking")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(blocking.out, sink.inp, length=0, timeout=0.25)
        context = await kernel.start(ThreadContext(rate=10.0), blocking, activate=True)
        await asyncio.sleep(0.5)
        assert sink.inp.is_new
        assert ended[0] is WriteTimeout
        await context.stop()
        assert ended[-1] is ClosedError
        assert not sink.inp.is_new
        assert counts(wire) == (len(ended) - 1, 0, 0, {"timeout": len(ended) - 1})


@simulated
async def test_in_debug_mode_it_is_the_same(simulated_clock: SimulatedClock) -> None:
    async with Kernel(debug=True) as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None, stamp="send", measure=10)
        writes = [asyncio.create_task(source.out.write(long(number))) for number in range(3)]
        await asyncio.sleep(0)
        writes[1].cancel()
        await asyncio.sleep(0)
        assert data(sink.inp.drain()) == [0, 2]
        assert counts(wire) == (2, 2, 0, {})
        assert wire.timing is not None


@simulated
async def test_a_thread_that_must_not_wait_gives_to_a_read_on_the_loop(simulated_clock: SimulatedClock) -> None:
    class Offering(Component):
        out = OutPort(TimedLong)
        given = refused = 0

        def on_execute(self) -> None:
            try:
                self.out.write_nowait(long(self.given))
                self.given += 1
            except WouldBlock:
                self.refused += 1

    async with Kernel() as kernel:
        offering, sink = await kernel.add(Offering("offering")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(offering.out, sink.inp, length=0)
        context = await kernel.start(ThreadContext(rate=100.0), offering, activate=True)
        await asyncio.sleep(0.1)
        assert offering.refused > 5
        taken = [(await sink.inp.read(timeout=5)).data for _ in range(20)]
        await context.stop()
        assert taken == list(range(20))
        assert offering.given == 20
        assert counts(wire) == (20, 20, 0, {})


@simulated
async def test_a_foreign_thread_takes_nothing_since_it_cannot_wake_the_writer(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None)
        write = asyncio.create_task(source.out.write(long(1)))
        await asyncio.sleep(0)
        with pytest.raises(ThreadError, match="cannot wake the writer"):
            await asyncio.to_thread(sink.inp.read_nowait)
        assert not write.done()
        assert sink.inp.read_nowait() == long(1)
        await write
        assert counts(wire) == (1, 1, 0, {})


@simulated
async def test_members_with_schedules_of_their_own_may_meet(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        apart = Composite("apart", sink, own_schedule=True)
        await kernel.add(Composite("whole", source, apart))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None)
        await kernel.start(EventContext(), apart, activate=True)
        write = asyncio.create_task(source.out.write(long(1)))
        await asyncio.sleep(0)
        assert sink.inp.read_nowait() == long(1)
        assert await write is True
        with pytest.raises(StateError, match="length = 0"):
            await kernel.contexts["event0"].add(source)
        assert counts(wire) == (1, 1, 0, {})


@pytest.mark.parametrize("said", ["length = 0", 'sync_readwrite = "YES"', 'dataflow_type = "duplex"'])
def test_a_system_file_asks_for_it(tmp_path: Path, said: str) -> None:
    """Its writer waits for a reader that runs twenty times a second."""
    (tmp_path / "parts.py").write_text(PARTS)
    file = tmp_path / "system.toml"
    file.write_text(SYSTEM.replace("SAID", said))

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(file))
            assert await wait_finished(kernel) == ()
            (wire,) = kernel.connectors.values()
            assert (wire.profile.length, wire.profile.full) == (0, "block")
            assert counts(wire) == (20, 20, 0, {})
            taking: Any = kernel.components["taking"]
            assert taking.taken == list(range(20))

    simulate(main())


PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Writing(Component):
    out = OutPort(TimedLong)
    async def on_execute(self):
        for number in range(20):
            await self.out.write(TimedLong(0, number))
        self.finish()

class Taking(Component):
    inp = InPort(TimedLong)
    def on_activated(self):
        self.taken = []
    def on_execute(self):
        if self.inp.is_new:
            self.taken.append(self.inp.read_nowait().data)
"""
SYSTEM = """
schema = 1
[components.writing]
type = "parts.py:Writing"
[components.taking]
type = "parts.py:Taking"
[[connections]]
from = "writing.out"
to = "taking.inp"
SAID
[contexts.a]
kind = "periodic"
rate = 100.0
members = ["writing"]
[contexts.b]
kind = "periodic"
rate = 20.0
members = ["taking"]
"""


@pytest.mark.slow(kept_by="test_a_thread_that_waits_for_a_read_ends_with_its_context")
def test_every_sample_of_threads_is_taken_or_timed_out() -> None:
    """The writers' time-outs end while the reader takes: each sample is one or the other."""
    count = 3_000 if CAMPAIGN else 300

    class Impatient(Component):
        out = OutPort(TimedLong)

        def __init__(self, name: str) -> None:
            super().__init__(name)
            self.random = random.Random(name)
            self.sent = 0
            self.taken: list[int] = []
            self.late = 0

        def on_execute(self) -> None:
            for _ in range(50):
                if self.sent == count:
                    return
                self.sent += 1
                try:
                    self.out.write_blocking(long(self.sent), timeout=self.random.choice((0.0, 0.0001, 0.001, 0.01)))
                    self.taken.append(self.sent)
                except WriteTimeout:
                    self.late += 1

    class Greedy(Component):
        inp = InPort(TimedLong)

        def __init__(self, name: str) -> None:
            super().__init__(name)
            self.random = random.Random(name)
            self.got: dict[str, list[int]] = {}

        def on_execute(self) -> None:
            with suppress(ReadTimeout, WouldBlock, ClosedError):
                for _ in range(50):
                    sample = self.inp.read_nowait() if self.random.random() < 0.5 else self.inp.read_blocking(0.002)
                    source = self.inp.last_source
                    assert source is not None
                    self.got.setdefault(source.out.path, []).append(sample.data)

    async def main() -> None:
        async with Kernel() as kernel:
            writers = [await kernel.add(Impatient(f"writer{number}")) for number in range(2)]
            reader = await kernel.add(Greedy("reader"))
            wires = [await kernel.connect(writer.out, reader.inp, length=0) for writer in writers]
            for one in (reader, *writers):
                await kernel.start(ThreadContext(rate=1000.0), one, activate=True)
            async with asyncio.timeout(60):
                while any(len(one.taken) + one.late < count for one in writers):
                    await asyncio.sleep(0.01)
            for context in tuple(kernel.contexts.values()):
                await context.stop()
            for writer, wire in zip(writers, wires, strict=True):
                assert reader.got.get(writer.out.path, []) == writer.taken
                lost = {"timeout": writer.late} if writer.late else {}
                assert counts(wire) == (count, len(writer.taken), 0, lost)
            assert any(writer.taken for writer in writers)

    asyncio.run(main())


@simulated
async def test_samples_are_converted_when_they_are_written(simulated_clock: SimulatedClock) -> None:
    """One that cannot be converted is lost at once, and its writer does not wait."""

    def halved(sample: TimedLong) -> TimedLong:
        if sample.data % 2:
            raise ValueError("odd")
        return long(sample.data // 2)

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        wire = await kernel.connect(source.out, sink.inp, length=0, timeout=None, convert=halved)
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(1))
        assert await source.out.write(long(3)) is True
        writes = [asyncio.create_task(source.out.write(long(number))) for number in (4, 6, 8)]
        await asyncio.sleep(0)
        writes[1].cancel()
        await asyncio.sleep(0)
        assert sink.inp.peek() == long(2)
        assert data(sink.inp.drain()) == [2, 4]
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        assert source.out.write_nowait(long(5)) is True
        assert source.out.write_nowait(long(10)) is True
        assert await read == long(5)
        assert counts(wire) == (5, 3, 0, {"unconverted": 2})
