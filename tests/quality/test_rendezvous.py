"""`length=0`: a write is done when the reader has taken its sample; until then that sample is unread data."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts import (
    Component,
    Composite,
    Connector,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    Synchronizer,
    ThreadContext,
    wait_any,
)
from aiorts.errors import DeclarationError, StateError, WiringError, WriteTimeout
from aiorts.kernel.ports.connector import unread_of
from aiorts.testing import simulated
from aiorts.types import TimedLong

pytestmark = pytest.mark.row(38)


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Both(Component):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong)


class Taking(Component):
    """Takes one sample in each cycle that has one."""

    inp = InPort(TimedLong)

    def __init__(self, name: str = "taking") -> None:
        super().__init__(name)
        self.taken: list[int] = []
        self.cycles = 0

    def on_execute(self) -> None:
        self.cycles += 1
        if self.inp.is_new:
            self.taken.append(self.inp.read_nowait().data)


class Writing(Component):
    """Writes the next number in each cycle, and waits until it was taken."""

    out = OutPort(TimedLong)

    def __init__(self, name: str = "writing") -> None:
        super().__init__(name)
        self.written = 0

    async def on_execute(self) -> None:
        await self.out.write(long(self.written))
        self.written += 1


class Slow(Component):
    """Keeps its context from running anything else for a second."""

    async def on_execute(self) -> None:
        await asyncio.sleep(1)


def long(number: int) -> TimedLong:
    return TimedLong(0, number)


def data(samples: list[TimedLong]) -> list[int]:
    return [sample.data for sample in samples]


def counts(connector: Connector) -> tuple[int, int, int, dict[str, int]]:
    """Written, delivered, buffered, dropped."""
    ledger = connector.statistics
    assert ledger.balanced
    return ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)


async def connected(kernel: Kernel, **options: Any) -> tuple[Source, Sink, Connector]:
    source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
    return source, sink, await kernel.connect(source.out, sink.inp, **{"length": 0, "timeout": None, **options})


async def writing(source: Source | Both, *numbers: int) -> list[asyncio.Task[bool]]:
    """A task for each of these writes, all waiting."""
    tasks = [asyncio.create_task(source.out.write(long(number))) for number in numbers]
    await asyncio.sleep(0)
    assert not any(task.done() for task in tasks)
    return tasks


# -- a write and a read meet -------------------------------------------------------------------------------------------


@simulated
async def test_a_write_is_done_when_its_sample_was_taken(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        (write,) = await writing(source, 1)
        await asyncio.sleep(100)
        assert not write.done()
        assert counts(wire) == (0, 0, 0, {})
        assert sink.inp.read_nowait() == long(1)
        assert counts(wire) == (1, 1, 0, {})
        assert not write.done()
        assert await write is True
        assert sink.inp.last_source is wire


@simulated
async def test_a_read_that_waits_takes_the_next_write(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(1)
        await source.out.write(long(1))
        assert read.done()
        assert await read == long(1)
        assert counts(wire) == (1, 1, 0, {})


@simulated
async def test_a_write_that_waits_is_unread_data(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        assert not sink.inp.is_new
        assert sink.inp.peek() is None
        writes = await writing(source, 1, 2, 3, 4)
        assert sink.inp.is_new
        assert unread_of(wire) == 4
        assert sink.inp.peek() == long(1)
        assert await wait_any(sink.inp) == (sink.inp,)
        assert sink.inp.read_nowait() == long(1)
        assert await sink.inp.read() == long(2)
        assert data(sink.inp.drain()) == [3, 4]
        assert not sink.inp.is_new
        assert await asyncio.gather(*writes) == [True] * 4
        assert counts(wire) == (4, 4, 0, {})


@simulated
async def test_latest_takes_the_newest_and_lets_all_writers_go_on(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        other = await kernel.add(Source("other"))
        second = await kernel.connect(other.out, sink.inp, length=0, timeout=None)
        writes = [*await writing(source, 1, 2), *await writing(other, 3), *await writing(source, 4)]
        assert sink.inp.latest == long(4)
        assert await asyncio.gather(*writes) == [True] * 4
        assert sink.inp.latest == long(4)
        assert counts(wire) == (3, 1, 0, {"superseded": 2})
        assert counts(second) == (1, 0, 0, {"superseded": 1})


@simulated
async def test_writes_of_several_connectors_are_read_in_the_order_of_arrival(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        meets, buffered = await kernel.add(Source("meets")), await kernel.add(Source("buffered"))
        await kernel.connect(meets.out, sink.inp, length=0, timeout=None)
        await kernel.connect(buffered.out, sink.inp, length=2)
        await writing(source, 1)
        buffered.out.write_nowait(long(2))
        await writing(meets, 3)
        (gone,) = await writing(source, 4)
        await writing(source, 5)
        buffered.out.write_nowait(long(6))
        buffered.out.write_nowait(long(7))  # overwrites 2
        gone.cancel()
        await asyncio.sleep(0)
        assert data(sink.inp.drain()) == [1, 3, 5, 6, 7]


@simulated
async def test_the_newest_is_another_when_the_newest_write_was_cancelled(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        other = await kernel.add(Source("other"))
        await kernel.connect(other.out, sink.inp)
        await writing(source, 1)
        other.out.write_nowait(long(2))
        (gone,) = await writing(source, 3)
        gone.cancel()
        await asyncio.sleep(0)
        assert sink.inp.latest == long(2)


@simulated
async def test_samples_are_stamped_as_by_any_connector(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel, stamp="read")
        await writing(source, 1)
        await asyncio.sleep(1)
        assert sink.inp.read_nowait().tm == kernel.time_ns()


# -- who gives up ------------------------------------------------------------------------------------------------------


@simulated
async def test_a_write_that_nobody_takes_in_time_is_written_and_dropped(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, timeout=0.5)
        with pytest.raises(WriteTimeout, match=r"source\.out: no room in time at sink\.inp \(0\.5 s\)"):
            await source.out.write(long(1))
        assert not sink.inp.is_new
        assert counts(wire) == (1, 0, 0, {"timeout": 1})


@simulated
async def test_a_cancelled_write_wrote_nothing(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        first, second, third = await writing(source, 1, 2, 3)
        second.cancel()
        await asyncio.sleep(0)
        assert counts(wire) == (0, 0, 0, {})
        assert data(sink.inp.drain()) == [1, 3]
        assert await asyncio.gather(first, third) == [True, True]
        assert counts(wire) == (2, 2, 0, {})


@simulated
async def test_a_cancelled_read_takes_nothing(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        writes = [asyncio.create_task(source.out.write(long(1)))]
        await asyncio.sleep(0)
        read.cancel()
        await asyncio.sleep(0)
        assert read.cancelled()
        assert not writes[0].done()
        assert sink.inp.read_nowait() == long(1)
        assert counts(wire) == (1, 1, 0, {})


# -- a write that must not wait ----------------------------------------------------------------------------------------


@simulated
async def test_write_nowait_needs_a_read_that_waits(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        with pytest.raises(WouldBlock, match=r"sink\.inp does not await a sample \(length = 0\)"):
            source.out.write_nowait(long(1))
        looking = asyncio.create_task(wait_any(sink.inp))
        await asyncio.sleep(0)
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(2))
        looking.cancel()
        await asyncio.sleep(0)
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        assert source.out.write_nowait(long(3)) is True
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(4))
        assert await read == long(3)
        assert counts(wire) == (1, 1, 0, {})


@simulated
async def test_what_was_given_to_a_read_that_is_cancelled_stays_unread(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        source.out.write_nowait(long(1))
        read.cancel()
        await asyncio.sleep(0)
        assert counts(wire) == (1, 0, 1, {})
        (write,) = await writing(source, 2)
        assert counts(wire) == (1, 0, 1, {})
        assert data(sink.inp.drain()) == [1, 2]
        await write
        assert counts(wire) == (2, 2, 0, {})


@simulated
async def test_write_nowait_writes_to_nobody_when_one_reader_does_not_wait(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        plain, full = await kernel.add(Sink("plain")), await kernel.add(Sink("full"))
        buffered = await kernel.connect(source.out, plain.inp)
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(1))
        assert counts(buffered) == (0, 0, 0, {})
        read = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        await kernel.connect(source.out, full.inp, length=1, full="block")
        assert source.out.write_nowait(long(2)) is True
        assert await read == long(2)
        with pytest.raises(WouldBlock):
            source.out.write_nowait(long(3))
        assert counts(wire) == (1, 1, 0, {})
        assert counts(buffered) == (1, 0, 1, {})


@simulated
async def test_readers_with_room_have_the_sample_at_once(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        plain, other = await kernel.add(Sink("plain")), await kernel.add(Sink("other"))
        await kernel.connect(source.out, plain.inp)
        late = await kernel.connect(source.out, other.inp, length=0, timeout=2.0)
        (write,) = await writing(source, 1)
        assert plain.inp.read_nowait() == long(1)
        assert sink.inp.read_nowait() == long(1)
        await asyncio.sleep(1)
        assert not write.done()
        with pytest.raises(WriteTimeout, match=r"other\.inp \(2 s\)"):
            await write
        assert counts(wire) == (1, 1, 0, {})
        assert counts(late) == (1, 0, 0, {"timeout": 1})


# -- who goes while a write waits --------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["disconnected", "removed", "deactivated", "stopped"])
@simulated
async def test_a_write_that_waits_ends_when_its_reader_goes(simulated_clock: SimulatedClock, how: str) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        context = await kernel.start(ExternalContext(), sink, activate=True)
        (write,) = await writing(source, 1)
        if how == "disconnected":
            await kernel.disconnect(wire)
        elif how == "removed":
            await kernel.remove(sink)
        elif how == "deactivated":
            await context.deactivate(sink)
        else:
            await context.stop()
        assert await write is True
        assert counts(wire) == (1, 0, 0, {"inactive" if how != "disconnected" else how: 1})


@simulated
async def test_what_is_written_to_a_reader_that_is_not_active_is_dropped(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        context = await kernel.start(ExternalContext(), sink)
        assert await source.out.write(long(1)) is True
        assert source.out.write_nowait(long(2)) is True
        await context.stop()
        assert await source.out.write(long(3)) is True
        assert counts(wire) == (3, 0, 0, {"inactive": 3})


@simulated
async def test_a_write_that_waits_ends_with_its_component(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        writer, sink = await kernel.add(Writing()), await kernel.add(Sink("sink"))
        wire = await kernel.connect(writer.out, sink.inp, length=0, timeout=None)
        context = await kernel.start(PeriodicContext(rate=10.0), writer, activate=True)
        await asyncio.sleep(1)
        assert sink.inp.is_new
        await context.stop()
        assert not sink.inp.is_new
        assert counts(wire) == (0, 0, 0, {})


# -- contexts ----------------------------------------------------------------------------------------------------------


@simulated
async def test_a_write_that_waits_wakes_an_event_context(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, taking = await kernel.add(Source("source")), await kernel.add(Taking())
        wire = await kernel.connect(source.out, taking.inp, length=0)
        await kernel.start(EventContext(), taking, activate=True)
        for number in range(5):
            await source.out.write(long(number))
        await writing(source, 5, 6, 7)
        await asyncio.sleep(1)
        assert (taking.taken, taking.cycles) == (list(range(8)), 8)
        assert counts(wire) == (8, 8, 0, {})


@simulated
async def test_a_write_that_gave_up_runs_nobody(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, taking = await kernel.add(Source("source")), await kernel.add(Taking())
        wire = await kernel.connect(source.out, taking.inp, length=0)
        context = await kernel.start(EventContext(), taking, await kernel.add(Slow("slow")), activate=True)
        context.trigger(context.members[1])
        await asyncio.sleep(0.1)
        (write,) = await writing(source, 1)
        write.cancel()
        await asyncio.sleep(5)
        assert (taking.cycles, taking.taken) == (0, [])
        assert counts(wire) == (0, 0, 0, {})


@simulated
async def test_writer_and_reader_run_in_step(simulated_clock: SimulatedClock) -> None:
    """The writer is as fast as the reader, whatever its rate."""
    async with Kernel() as kernel:
        writer, taking = await kernel.add(Writing()), await kernel.add(Taking())
        wire = await kernel.connect(writer.out, taking.inp, length=0, timeout=None)
        await kernel.start(PeriodicContext(rate=10.0), taking, activate=True)
        await kernel.start(PeriodicContext(rate=1000.0), writer, activate=True)
        await asyncio.sleep(2.05)
        assert taking.taken == list(range(len(taking.taken)))
        assert len(taking.taken) == pytest.approx(20, abs=1)
        assert writer.written == len(taking.taken)
        assert counts(wire) == (len(taking.taken), len(taking.taken), 0, {})


@simulated
async def test_a_synchronizer_matches_writes_that_wait(simulated_clock: SimulatedClock) -> None:
    class Fusing(Component):
        one = InPort(TimedLong)
        two = InPort(TimedLong)

    async with Kernel() as kernel:
        first, second = await kernel.add(Source("first")), await kernel.add(Source("second"))
        fusing = await kernel.add(Fusing("fusing"))
        await kernel.connect(first.out, fusing.one, length=0)
        await kernel.connect(second.out, fusing.two, length=0)
        sync = Synchronizer(fusing.one, fusing.two, policy="exact")
        match = asyncio.create_task(sync.match())
        await asyncio.sleep(0)
        await asyncio.gather(first.out.write(long(1)), second.out.write(long(2)))
        assert tuple(await match) == (long(1), long(2))


@pytest.mark.parametrize("which", ["reader", "writer", "both"])
def test_ends_may_run_in_threads_of_their_own(which: str) -> None:
    class Blocking(Component):
        out = OutPort(TimedLong)

        def __init__(self) -> None:
            super().__init__("blocking")
            self.written = 0

        def on_execute(self) -> None:
            if self.written < 50:
                self.out.write_blocking(long(self.written), timeout=30)
                self.written += 1

    class Reading(Component):
        inp = InPort(TimedLong)

        def __init__(self) -> None:
            super().__init__("reading")
            self.taken: list[int] = []

        def on_execute(self) -> None:
            if len(self.taken) < 50:
                self.taken.append(self.inp.read_blocking(timeout=30).data)

    async def main() -> None:
        async with Kernel() as kernel:
            reader: Reading | Sink = Reading() if which != "writer" else Sink("sink")
            writer: Blocking | Source = Blocking() if which != "reader" else Source("source")
            await kernel.add(reader)
            await kernel.add(writer)
            wire = await kernel.connect(writer.out, reader.inp, length=0, timeout=30)
            for one in (reader, writer):
                if isinstance(one, Reading | Blocking):
                    await kernel.start(ThreadContext(rate=1000.0), one, activate=True)
            if isinstance(writer, Source):
                for number in range(50):
                    await writer.out.write(long(number))
            taken = [(await reader.inp.read(timeout=30)).data for _ in range(50)] if isinstance(reader, Sink) else None
            async with asyncio.timeout(30):
                while counts(wire)[1] < 50:
                    await asyncio.sleep(0.001)
            assert counts(wire) == (50, 50, 0, {})
            if isinstance(reader, Reading):
                async with asyncio.timeout(30):
                    while len(reader.taken) < 50:
                        await asyncio.sleep(0.001)
                taken = reader.taken
            assert taken == list(range(50))

    asyncio.run(main())


def test_a_foreign_threads_samples_are_taken_one_by_one() -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            source, sink, wire = await connected(kernel)

            def write() -> None:
                for number in range(100):
                    source.out.write_from_thread(long(number), full="block")

            thread = threading.Thread(target=write)
            thread.start()
            taken = [(await sink.inp.read(timeout=30)).data for _ in range(100)]
            thread.join(30)
            await asyncio.sleep(0)
            assert taken == list(range(100))
            assert counts(wire) == (100, 100, 0, {})
            written = source.out.thread_writes
            assert (written.accepted, written.waiting, dict(written.dropped)) == (100, 0, {})

    asyncio.run(main())


# -- who must not meet -------------------------------------------------------------------------------------------------


@simulated
async def test_writer_and_reader_in_one_context_are_refused_when_they_are_connected(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel() as kernel:
        source, sink, both = await kernel.add(Source("source")), await kernel.add(Sink("sink")), Both("both")
        await kernel.add(both)
        with pytest.raises(WiringError, match=r"both\.out -> both\.inp: length = 0: .* both are ports of both; run"):
            await kernel.connect(both.out, both.inp, length=0)
        context = await kernel.start(PeriodicContext(rate=1.0, name="main"), source, sink)
        with pytest.raises(WiringError, match=r"source\.out -> sink\.inp: length = 0: .* both run in main; run one"):
            await kernel.connect(source.out, sink.inp, length=0)
        assert not source.out.connectors
        await context.stop()
        composite = await kernel.add(Composite("pair", source, sink))
        with pytest.raises(WiringError, match=r"both are members of pair; run one"):
            await kernel.connect(source.out, sink.inp, length=0)
        await kernel.remove(composite)
        await kernel.connect(source.out, sink.inp, length=0)


@simulated
async def test_writer_and_reader_are_refused_in_one_context(simulated_clock: SimulatedClock) -> None:
    refused = r"cannot run in main: the connector source\.out-sink\.inp has length = 0, .*; run one of them in another"
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        with pytest.raises(StateError, match=refused):
            await kernel.start(PeriodicContext(rate=1.0, name="main"), source, sink)
        assert not kernel.contexts
        context = await kernel.start(PeriodicContext(rate=1.0, name="main"))
        with pytest.raises(StateError, match=refused):
            await context.add(source, sink)
        assert context.members == ()
        await context.add(source)
        with pytest.raises(StateError, match=refused):
            await context.add(sink)
        assert context.members == (source,)
        await kernel.start(EventContext(), sink)
        with pytest.raises(StateError, match=refused):
            await context.add(sink)


@simulated
async def test_writer_and_reader_are_refused_in_one_composite(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        with pytest.raises(StateError, match=r"cannot run in pair: .* length = 0"):
            await kernel.add(Composite("pair", source, sink))
        part = await kernel.add(Composite("part", source))
        with pytest.raises(StateError, match=r"cannot run in part: .* length = 0"):
            await part.add_members(sink)
        with pytest.raises(StateError, match=r"cannot run in whole: .* length = 0"):
            await kernel.add(Composite("whole", part, sink))
        with pytest.raises(StateError, match=r"cannot run in main: .* length = 0"):
            await kernel.start(PeriodicContext(rate=1.0, name="main"), part, sink)
        context = await kernel.start(PeriodicContext(rate=1.0, name="main"), part)
        with pytest.raises(StateError, match=r"cannot run in (main|part): .* length = 0"):
            await part.add_members(sink)
        with pytest.raises(StateError, match=r"cannot run in main: .* length = 0"):
            await context.add(sink)
        assert part.members == (source,)


@simulated
async def test_no_real_time_thread_meets_anybody(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, _, _ = await connected(kernel)
        with pytest.raises(StateError, match=r"has length = 0, and no real-time thread"):
            await kernel.start(RealtimeContext(rate=10.0), source)


def test_an_in_port_does_not_ask_for_it() -> None:
    """It is for the connection to say."""
    with pytest.raises(DeclarationError, match=r"length = 0: expected a whole number from 1"):
        InPort(TimedLong, length=0)
