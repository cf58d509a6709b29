"""`keep_last=True`: a new connector is offered the sample that the writer wrote last, once."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import (
    Component,
    Connector,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
    WouldBlock,
)
from aiorts.errors import StateError, WiringError, WriteTimeout
from aiorts.testing import simulated
from campaign import cases
from ports.parts import Sink, Source, long


def counts(connector: Connector) -> tuple[int, int, int, dict[str, int]]:
    """Written, delivered, buffered, dropped."""
    ledger = connector.statistics
    assert ledger.balanced
    return ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)


async def last_of(kernel: Kernel, source: Source) -> int | None:
    """What a new connector is offered."""
    sink = await kernel.create(Sink)
    wire = await kernel.connect(source.out, sink.inp, keep_last=True)
    offered = [sample.data for sample in sink.inp.drain()]
    assert counts(wire) == (len(offered), len(offered), 0, {})
    await kernel.remove(sink)
    return offered[0] if offered else None


async def one_writer(kernel: Kernel) -> tuple[Source, Sink]:
    return await kernel.add(Source("source")), await kernel.add(Sink("sink"))


@simulated
async def test_what_was_written_before_anybody_asked_for_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, _ = await one_writer(kernel)
        assert await last_of(kernel, source) is None
        for number in (1, 2, 3):
            source.out.write_nowait(long(number))
        assert [await last_of(kernel, source) for _ in range(3)] == [3, 3, 3]


@pytest.mark.parametrize("full", ["overwrite", "reject", "block"])
@pytest.mark.parametrize("reads", [0, 1, 2, 3])
@simulated
async def test_the_end_of_a_queue_or_what_was_read_last(simulated_clock: SimulatedClock, full: str, reads: int) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        await kernel.connect(source.out, sink.inp, full=full, length=3)
        for number in (1, 2, 3):
            source.out.write_nowait(long(number))
        for _ in range(reads):
            sink.inp.read_nowait()
        assert await last_of(kernel, source) == 3


LOSSES: dict[str, Any] = {
    "latest": lambda kernel, sink, wire: sink.inp.latest,
    "drain": lambda kernel, sink, wire: sink.inp.drain(),
    "disconnect": lambda kernel, sink, wire: kernel.disconnect(wire),
    "remove": lambda kernel, sink, wire: kernel.remove(sink),
    "join a context": lambda kernel, sink, wire: kernel.start(ExternalContext(), sink),
    "join and activate": lambda kernel, sink, wire: kernel.start(ExternalContext(), sink, activate=True),
    "a thread": lambda kernel, sink, wire: kernel.start(ThreadContext(10.0), sink),
    "listened to": lambda kernel, sink, wire: kernel.listen(wire, lambda event: None),
    "real time": lambda kernel, sink, wire: kernel.start(RealtimeContext(10.0), sink),
}


@pytest.mark.parametrize("before", [0, 2])
@pytest.mark.parametrize("lose", LOSSES.values(), ids=LOSSES)
@simulated
async def test_whoever_empties_a_queue_leaves_the_last_with_the_writer(
    simulated_clock: SimulatedClock, lose: Any, before: int
) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        wire = await kernel.connect(source.out, sink.inp)
        for number in (1, 2):
            source.out.write_nowait(long(number))
        for _ in range(before):
            sink.inp.read_nowait()
        done = lose(kernel, sink, wire)
        if asyncio.iscoroutine(done):
            await done
        assert await last_of(kernel, source) == 2
        source.out.write_nowait(long(3))
        assert await last_of(kernel, source) == 3


@simulated
async def test_a_reader_of_several_writers(simulated_clock: SimulatedClock) -> None:
    """Its own last sample is of one of them."""
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        other = await kernel.add(Source("other"))
        await kernel.connect(source.out, sink.inp)
        source.out.write_nowait(long(1))
        assert sink.inp.read_nowait() == long(1)
        await kernel.connect(other.out, sink.inp)
        other.out.write_nowait(long(11))
        assert sink.inp.read_nowait() == long(11)
        assert (await last_of(kernel, source), await last_of(kernel, other)) == (1, 11)
        for number in (2, 3):
            source.out.write_nowait(long(number))
            other.out.write_nowait(long(10 + number))
        assert sink.inp.read_nowait() == long(2)
        assert sink.inp.latest == long(13)
        assert (await last_of(kernel, source), await last_of(kernel, other)) == (3, 13)


@simulated
async def test_samples_that_no_reader_took_count(simulated_clock: SimulatedClock) -> None:
    """Rejected, skipped, too late or written to an inactive reader: the writer wrote it."""
    async with Kernel() as kernel:
        for options in ({"full": "reject", "length": 1}, {"subscription": "new", "push": "skip", "skip": 5}):
            source, sink = await kernel.create(Source), await kernel.create(Sink)
            await kernel.connect(source.out, sink.inp, **options)
            source.out.write_nowait(long(1))
            source.out.write_nowait(long(2))
            assert await last_of(kernel, source) == 2
            sink.inp.drain()
            assert await last_of(kernel, source) == 2
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        await kernel.connect(source.out, sink.inp, full="block", length=1, timeout=0.1)
        await source.out.write(long(1))
        with pytest.raises(WriteTimeout):
            await source.out.write(long(2))
        assert await last_of(kernel, source) == 2
        await kernel.start(ExternalContext(), sink)
        source.out.write_nowait(long(3))
        assert await last_of(kernel, source) == 3


@simulated
async def test_a_cancelled_write_wrote_nothing(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        await kernel.connect(source.out, sink.inp, full="block", length=1)
        await source.out.write(long(1))
        writing = asyncio.create_task(source.out.write(long(2)))
        await asyncio.sleep(0)
        writing.cancel()
        await asyncio.sleep(0)
        assert await last_of(kernel, source) == 1
        plain = await kernel.create(Sink)
        await kernel.connect(source.out, plain.inp)
        writing = asyncio.create_task(source.out.write(long(3)))
        await asyncio.sleep(0)
        writing.cancel()
        await asyncio.sleep(0)
        await kernel.remove(plain)
        assert await last_of(kernel, source) == 3


@simulated
async def test_it_is_offered_at_the_activation_and_counts_once(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        source.out.write_nowait(long(1))
        wire = await kernel.connect(source.out, sink.inp, keep_last=True)
        assert counts(wire) == (1, 0, 1, {})
        context = await kernel.start(ExternalContext(), sink)
        assert counts(wire) == (0, 0, 0, {})
        source.out.write_nowait(long(2))
        assert counts(wire) == (1, 0, 0, {"inactive": 1})
        await context.activate(sink)
        assert counts(wire) == (2, 0, 1, {"inactive": 1})
        assert sink.inp.read_nowait() == long(2)
        await context.deactivate(sink)
        await context.activate(sink)
        assert counts(wire) == (2, 1, 0, {"inactive": 1})
        source.out.write_nowait(long(3))
        assert sink.inp.read_nowait() == long(3)


@simulated
async def test_an_event_context_runs_for_it(simulated_clock: SimulatedClock) -> None:
    class Reader(Component):
        inp = InPort(type(long(0)))

        def on_activated(self) -> None:
            self.taken: list[int] = []

        def on_execute(self) -> None:
            self.taken += [sample.data for sample in self.inp.drain()]

    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        reader = await kernel.create(Reader)
        source.out.write_nowait(long(1))
        await kernel.connect(source.out, reader.inp, keep_last=True)
        await kernel.start(EventContext(), reader, activate=True)
        await asyncio.sleep(0.1)
        assert reader.taken == [1]
        late = await kernel.create(Source)
        late.out.write_nowait(long(5))
        await kernel.connect(late.out, reader.inp, keep_last=True)
        await asyncio.sleep(0.1)
        assert reader.taken == [1, 5]


@simulated
async def test_no_push_policy_counts_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        source.out.write_nowait(long(1))
        skipping = {"subscription": "new", "push": "skip", "skip": 1, "length": 10}
        wire = await kernel.connect(source.out, sink.inp, keep_last=True, **skipping)
        plain = await kernel.create(Sink)
        await kernel.connect(source.out, plain.inp, **skipping)
        for number in range(2, 8):
            source.out.write_nowait(long(number))
        sent = [sample.data for sample in plain.inp.drain()]
        assert len(sent) == 3
        assert [sample.data for sample in sink.inp.drain()] == [1, *sent]
        assert counts(wire) == (7, 4, 0, {"skipped": 3})


@simulated
async def test_of_a_periodic_connector_it_can_be_read_at_once(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        source.out.write_nowait(long(1))
        options: dict[str, Any] = {"subscription": "periodic", "push_rate": 10.0, "push": "all", "lifespan": 5.0}
        wire = await kernel.connect(source.out, sink.inp, keep_last=True, **options)
        assert sink.inp.read_nowait() == long(1)
        source.out.write_nowait(long(2))
        assert await last_of(kernel, source) == 2
        await asyncio.sleep(0.2)
        assert counts(wire) == (2, 1, 1, {})
        assert await last_of(kernel, source) == 2


@simulated
async def test_a_stamp_is_the_connectors_own(simulated_clock: SimulatedClock) -> None:
    """Another connector is offered what the writer wrote."""
    async with Kernel() as kernel:
        await asyncio.sleep(1)
        for when in ("send", "received", "read"):
            source, sink = await kernel.create(Source), await kernel.create(Sink)
            wire = await kernel.connect(source.out, sink.inp, stamp=when)
            for reads in (False, True):
                source.out.write_nowait(long(1))
                if reads:
                    assert sink.inp.latest != long(1)
                after = await kernel.create(Sink)
                await kernel.connect(source.out, after.inp, keep_last=True)
                assert after.inp.read_nowait() == long(1)
            await kernel.disconnect(wire)


@simulated
async def test_it_expires_by_the_time_it_was_offered(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        source.out.write_nowait(long(1))
        await asyncio.sleep(10)
        wire = await kernel.connect(source.out, sink.inp, keep_last=True, lifespan=1.0)
        await asyncio.sleep(0.5)
        assert sink.inp.is_new
        await asyncio.sleep(0.5)
        with pytest.raises(WouldBlock):
            sink.inp.read_nowait()
        assert counts(wire) == (1, 0, 0, {"expired": 1})
        assert await last_of(kernel, source) == 1


@simulated
async def test_a_reader_in_a_thread(simulated_clock: SimulatedClock) -> None:
    class Reader(Component):
        inp = InPort(type(long(0)))

        def on_activated(self) -> None:
            self.taken: list[int] = []

        def on_execute(self) -> None:
            self.taken += [sample.data for sample in self.inp.drain()]

    async with Kernel() as kernel:
        source, reader = await kernel.create(Source), await kernel.create(Reader)
        source.out.write_nowait(long(1))
        wire = await kernel.connect(source.out, reader.inp, keep_last=True)
        context = await kernel.start(ThreadContext(100.0), reader, activate=True)
        await asyncio.sleep(0.1)
        assert reader.taken == [1]
        assert counts(wire) == (1, 1, 0, {})
        await context.stop()
        assert await last_of(kernel, source) == 1


@simulated
async def test_no_real_time_thread_is_at_such_a_connector(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        wire = await kernel.connect(source.out, sink.inp, keep_last=True)
        for end in (source, sink):
            with pytest.raises(StateError, match=r"has keep_last, and no real-time thread .*; connect without"):
                await kernel.start(RealtimeContext(rate=10.0), end)
        await kernel.disconnect(wire)
        await kernel.start(RealtimeContext(rate=10.0), source)
        with pytest.raises(WiringError, match=r"has keep_last, and source runs in a real-time thread, .*; leave"):
            await kernel.connect(source.out, sink.inp, keep_last=True)


@simulated
async def test_the_last_of_a_real_time_thread(simulated_clock: SimulatedClock) -> None:
    class Writer(Component):
        out = OutPort(type(long(0)))

        def on_activated(self) -> None:
            self.number = 0

        def on_execute(self) -> None:
            self.number += 1
            self.out.write_nowait(long(self.number))

    async with Kernel() as kernel:
        writer, sink = await kernel.create(Writer), await kernel.create(Sink)
        await kernel.connect(writer.out, sink.inp, full="reject", length=2)
        context = await kernel.start(RealtimeContext(100.0), writer, activate=True)
        await asyncio.sleep(0.1)
        await context.stop()
        assert writer.number > 2
        assert await last_of(kernel, writer) == writer.number  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", ["often", 2, [], 0.5])
@simulated
async def test_what_is_neither_true_nor_false_is_refused(simulated_clock: SimulatedClock, bad: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        with pytest.raises(WiringError, match=r"source\.out -> sink\.inp: keep_last = .*: expected true or false"):
            await kernel.connect(source.out, sink.inp, keep_last=bad)


@simulated
async def test_the_last_of_a_rendezvous(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)
        with pytest.raises(WiringError, match="keep_last = True does not go with length = 0"):
            await kernel.connect(source.out, sink.inp, length=0, keep_last=True)
        await kernel.connect(source.out, sink.inp, length=0)
        for number, take in enumerate((sink.inp.read_nowait, lambda: sink.inp.latest)):
            writing = asyncio.create_task(source.out.write(long(number)))
            await asyncio.sleep(0)
            assert take() == long(number)
            await writing
            assert await last_of(kernel, source) == number
            writing = asyncio.create_task(source.out.write(long(77)))
            await asyncio.sleep(0)
            writing.cancel()
            await asyncio.sleep(0)
            assert await last_of(kernel, source) == number


@pytest.mark.slow(kept_by="test_the_end_of_a_queue_or_what_was_read_last")
@pytest.mark.anyio
@pytest.mark.parametrize("blocking", [False, True])
async def test_a_connector_made_while_a_thread_writes_misses_nothing_and_has_nothing_twice(blocking: bool) -> None:
    class Writer(Component):
        out = OutPort(type(long(0)))

        def on_activated(self) -> None:
            self.number = 0

        def on_execute(self) -> None:
            write = self.out.write_blocking if blocking else self.out.write_nowait
            for _ in range(100):
                self.number += 1
                write(long(self.number))

    async with Kernel() as kernel:
        writer, plain = await kernel.create(Writer), await kernel.create(Sink)
        await kernel.connect(writer.out, plain.inp)
        sinks = [await kernel.create(Sink) for _ in range(3)]
        await kernel.start(ThreadContext(500.0), writer, activate=True)
        taken: list[list[int]] = []
        for _ in range(cases(10_000)):
            wires = [await kernel.connect(writer.out, sink.inp, keep_last=True, length=100_000) for sink in sinks]
            await asyncio.sleep(0.002)
            for wire, sink in zip(wires, sinks, strict=True):
                taken.append([sample.data for sample in sink.inp.drain()])
                await kernel.disconnect(wire)
        for numbers in taken:
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.parametrize("options", [{}, {"subscription": "periodic", "push_rate": 10.0, "push": "all"}])
@simulated
async def test_a_conversion_is_the_connectors_own(simulated_clock: SimulatedClock, options: dict[str, Any]) -> None:
    """Another connector is offered what the writer wrote, and converts it itself."""
    async with Kernel() as kernel:
        source, sink = await one_writer(kernel)

        def double(sample: Any) -> Any:
            return long(2 * sample.data)

        wire = await kernel.connect(source.out, sink.inp, convert=double, **options)
        for number in (1, 2):
            source.out.write_nowait(long(number))
            assert await last_of(kernel, source) == number
            await asyncio.sleep(0.2)
            assert sink.inp.read_nowait() == long(2 * number)
            assert await last_of(kernel, source) == number
        await kernel.disconnect(wire)
        assert await last_of(kernel, source) == 2
        wire = await kernel.connect(source.out, sink.inp, convert=double, keep_last=True, **options)
        assert sink.inp.read_nowait() == long(4)
        assert counts(wire) == (1, 1, 0, {})
        failing = await kernel.create(Sink)
        wire = await kernel.connect(source.out, failing.inp, convert=lambda _: 1 / 0, keep_last=True, **options)
        assert counts(wire) == (1, 0, 0, {"unconverted": 1})
