"""`lifespan`: who looks at a queue finds no sample that is too old, and each one that expired is counted."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts import (
    Component,
    Connector,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    Supervision,
    Synchronizer,
    ThreadContext,
    wait_any,
)
from aiorts.errors import ReadTimeout, StateError, WiringError, WriteTimeout
from aiorts.events import ConnectorEvent
from aiorts.kernel.ports.connector import unread_of
from aiorts.testing import simulated
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Counting(Component):
    """Counts its cycles and takes nothing, or all."""

    inp = InPort(TimedLong)

    def __init__(self, name: str, *, drains: bool = False) -> None:
        super().__init__(name)
        self.cycles = 0
        self.drains = drains
        self.taken: list[int] = []

    def on_execute(self) -> None:
        self.cycles += 1
        if self.drains:
            self.taken += data(self.inp.drain())


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
    return source, sink, await kernel.connect(source.out, sink.inp, **{"lifespan": 1.0, **options})


def _read_in_vain(port: InPort[TimedLong]) -> None:
    with pytest.raises(WouldBlock):
        port.read_nowait()


LOOKS: dict[str, Any] = {
    "read_nowait": _read_in_vain,
    "latest": lambda port: port.latest,
    "peek": lambda port: port.peek(),
    "drain": lambda port: port.drain(),
    "is_new": lambda port: port.is_new,
    "statistics": lambda port: port.connectors[0].statistics.buffered,
    "unread": lambda port: unread_of(port.connectors[0]),
}


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
@simulated
async def test_whoever_looks_finds_no_expired_sample(simulated_clock: SimulatedClock, look: Any) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        source.out.write_nowait(long(1))
        await asyncio.sleep(0.999)
        assert sink.inp.is_new
        await asyncio.sleep(0.001)
        look(sink.inp)
        assert counts(wire) == (1, 0, 0, {"expired": 1})
        assert sink.inp.drain() == []


@simulated
async def test_nothing_is_called_when_a_sample_expires(simulated_clock: SimulatedClock) -> None:
    """It is found at the next look, and until then no timer is there."""
    async with Kernel() as kernel:
        source, _, _ = await connected(kernel)
        before = simulated_clock.pending
        source.out.write_nowait(long(1))
        assert simulated_clock.pending == before


@simulated
async def test_what_was_read_stays_readable(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        source.out.write_nowait(long(1))
        assert sink.inp.latest == long(1)
        source.out.write_nowait(long(2))
        await asyncio.sleep(5)
        assert sink.inp.latest == long(1)
        assert counts(wire) == (2, 1, 0, {"expired": 1})


@simulated
async def test_the_time_stamp_of_the_writer_says_nothing(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        source.out.write_nowait(TimedLong(0, 1))
        source.out.write_nowait(TimedLong(2**32 * 10**9 - 1, 2))
        assert data(sink.inp.drain()) == [1, 2]


@pytest.mark.parametrize(
    ("full", "taken"),
    [("overwrite", [1, 2]), ("reject", [1, 2]), ("block", [1, 2])],
    ids=["overwrite", "reject", "block"],
)
@simulated
async def test_a_write_has_the_room_of_what_expired(
    simulated_clock: SimulatedClock, full: str, taken: list[int]
) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=2, full=full)
        for number in (-1, 0):
            source.out.write_nowait(long(number))
        await asyncio.sleep(1)
        assert [source.out.write_nowait(long(number)) for number in taken] == [True, True]
        assert data(sink.inp.drain()) == taken
        assert counts(wire) == (4, 2, 0, {"expired": 2})


@simulated
async def test_a_writer_that_waits_goes_on_when_a_sample_expires(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        loop = asyncio.get_running_loop()
        began = loop.time()
        for number in range(4):
            await source.out.write(long(number))
        assert loop.time() - began == pytest.approx(3.0)
        assert data(sink.inp.drain()) == [3]
        assert counts(wire) == (4, 1, 0, {"expired": 3})


@simulated
async def test_no_timer_is_left_when_no_writer_waits(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=0.1)
        before = simulated_clock.pending
        source.out.write_nowait(long(1))
        with pytest.raises(WriteTimeout):
            await source.out.write(long(2))
        assert simulated_clock.pending == before
        waiting = asyncio.create_task(source.out.write(long(3)))
        await asyncio.sleep(0.01)
        assert sink.inp.read_nowait() == long(1)
        assert sink.inp.read_nowait() == long(3)
        await waiting
        assert simulated_clock.pending == before
        assert counts(wire) == (3, 2, 0, {"timeout": 1})


@simulated
async def test_a_backlog_expires(simulated_clock: SimulatedClock) -> None:
    options: dict[str, Any] = {"subscription": "periodic", "push": "all", "push_rate": 0.5, "lifespan": 1.5}
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, **options)
        source.out.write_nowait(long(1))
        await asyncio.sleep(1)
        source.out.write_nowait(long(2))
        assert counts(wire) == (2, 0, 2, {})
        await asyncio.sleep(0.5)
        assert counts(wire) == (2, 0, 1, {"expired": 1})
        await asyncio.sleep(0.6)
        assert sink.inp.peek() == long(2)
        await asyncio.sleep(0.4)
        assert not sink.inp.is_new
        assert counts(wire) == (2, 0, 0, {"expired": 2})


@simulated
async def test_a_sample_that_is_held_for_a_pull_expires(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, dataflow="pull")
        source.out.write_nowait(long(1))
        await asyncio.sleep(1)
        assert not sink.inp.is_new
        source.out.write_nowait(long(2))
        source.out.write_nowait(long(3))
        assert sink.inp.read_nowait() == long(3)
        assert counts(wire) == (3, 1, 0, {"expired": 1, "superseded": 1})


@simulated
async def test_the_order_of_arrival_stays_beside_a_connector_without_a_lifespan(
    simulated_clock: SimulatedClock,
) -> None:
    async with Kernel() as kernel:
        source, sink, short = await connected(kernel, length=3)
        other = await kernel.add(Source("other"))
        lasting = await kernel.connect(other.out, sink.inp)
        for number in range(3):
            source.out.write_nowait(long(number))
            other.out.write_nowait(long(10 + number))
            await asyncio.sleep(0.4)
        assert counts(short) == (3, 0, 2, {"expired": 1})
        assert data(sink.inp.drain()) == [10, 1, 11, 2, 12]
        await kernel.disconnect(short)
        other.out.write_nowait(long(20))
        assert data(sink.inp.drain()) == [20]
        assert counts(lasting) == (4, 4, 0, {})


@simulated
async def test_an_event_context_does_not_run_for_an_expired_sample(simulated_clock: SimulatedClock) -> None:
    """What it left unread is no cause any more, and expiring is none."""
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Counting("sink"))
        wire = await kernel.connect(source.out, sink.inp, lifespan=1.0)
        await kernel.start(EventContext(), sink, activate=True)
        source.out.write_nowait(long(1))
        await asyncio.sleep(0.1)
        assert sink.cycles == 1
        await asyncio.sleep(5)
        assert sink.cycles == 1
        sink.drains = True
        source.out.write_nowait(long(2))
        await asyncio.sleep(0.1)
        assert (sink.cycles, sink.taken) == (2, [2])
        assert counts(wire) == (2, 1, 0, {"expired": 1})


@simulated
async def test_who_waits_is_not_woken_by_what_expires(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, _ = await connected(kernel)
        source.out.write_nowait(long(1))
        await asyncio.sleep(1)
        with pytest.raises(ReadTimeout):
            await wait_any(sink.inp, timeout=3)
        with pytest.raises(ReadTimeout):
            await sink.inp.read(timeout=3)
        waiting = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(2)
        source.out.write_nowait(long(2))
        assert await waiting == long(2)


@simulated
async def test_a_listener_hears_which_sample_expired(simulated_clock: SimulatedClock) -> None:
    heard: list[ConnectorEvent] = []
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        kernel.listen(wire, heard.append, "expired")
        source.out.write_nowait(long(1))
        await asyncio.sleep(1)
        assert not sink.inp.is_new
        await asyncio.sleep(0)
        assert [(str(event.kind), event.sample) for event in heard] == [("expired", long(1))]


@simulated
async def test_samples_expire_while_listeners_come_and_go(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        for number in range(4):
            source.out.write_nowait(long(number))
            await asyncio.sleep(0.4)
            remove = kernel.listen(wire, lambda event: None)
            await asyncio.sleep(0.4)
            remove()
        assert data(sink.inp.drain()) == [3]
        assert counts(wire) == (4, 1, 0, {"expired": 3})


@simulated
async def test_samples_expire_across_threads(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Counting("sink"))
        wire = await kernel.connect(source.out, sink.inp, lifespan=0.25, length=100)
        context = await kernel.start(ThreadContext(rate=10.0), sink, activate=True)
        for number in range(20):
            source.out.write_nowait(long(number))
            await asyncio.sleep(0.1)
        written, delivered, buffered, dropped = counts(wire)
        assert (written, delivered, buffered + dropped["expired"]) == (20, 0, 20)
        assert buffered <= 3
        sink.drains = True
        await asyncio.sleep(0.1)
        await context.stop()
        assert sink.taken == [18, 19] or sink.taken == [19]


@pytest.mark.parametrize("bad", [0, -1, float("nan"), float("inf"), "soon", True, [1]])
@simulated
async def test_a_lifespan_that_is_no_time_is_refused(simulated_clock: SimulatedClock, bad: Any) -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=r"source\.out -> sink\.inp: lifespan = .*: expected a number from 1e-06"):
            await connected(kernel, lifespan=bad)


@simulated
async def test_no_real_time_thread_is_at_such_a_connector(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        for end in (source, sink):
            with pytest.raises(StateError, match=r"has lifespan, and no real-time thread .*; connect without"):
                await kernel.start(RealtimeContext(rate=10.0), end)
        await kernel.disconnect(wire)
        context = await kernel.start(RealtimeContext(rate=10.0), source)
        with pytest.raises(WiringError, match=r"has lifespan, and source runs in a real-time thread, .*; leave"):
            await kernel.connect(source.out, sink.inp, lifespan=1.0)
        other = await kernel.add(Source("other"))
        await kernel.connect(other.out, sink.inp, lifespan=1.0)
        with pytest.raises(WiringError, match=r"other\.out-sink\.inp has lifespan, and source runs"):
            await kernel.connect(source.out, sink.inp)
        await context.stop()


@simulated
async def test_samples_are_dropped_as_inactive_or_disconnected_as_without_it(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        context = await kernel.start(PeriodicContext(rate=1.0), sink)
        source.out.write_nowait(long(1))
        await context.activate(sink)
        source.out.write_nowait(long(2))
        await context.deactivate(sink)
        await context.activate(sink)
        source.out.write_nowait(long(3))
        await kernel.disconnect(wire)
        assert counts(wire) == (3, 0, 0, {"inactive": 2, "disconnected": 1})


@simulated
async def test_a_thread_that_waits_for_room_goes_on_when_a_sample_expires(simulated_clock: SimulatedClock) -> None:
    class Writer(Component):
        out = OutPort(TimedLong)
        ends: list[float]

        def on_execute(self) -> None:
            for number in range(3):
                self.out.write_blocking(long(number))
                self.ends.append(simulated_clock.monotonic_ns() / 1e9)

    async with Kernel() as kernel:
        writer, sink = await kernel.add(Writer("writer")), await kernel.add(Sink("sink"))
        writer.ends = []
        wire = await kernel.connect(writer.out, sink.inp, lifespan=1.0, full="block", length=1, timeout=None)
        context = await kernel.start(ThreadContext(rate=0.01), writer, activate=True)
        await asyncio.sleep(5)
        first, second, third = writer.ends
        assert (second - first, third - second) == pytest.approx((1.0, 1.0))
        assert counts(wire) == (3, 0, 0, {"expired": 3})
        await context.stop()


@simulated
async def test_a_foreign_thread_waits_for_room_no_longer_than_a_lifespan(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        for number in range(3):
            assert await asyncio.to_thread(source.out.write_from_thread, long(number))
        await asyncio.sleep(2.5)
        assert sink.inp.drain() == [long(2)]
        assert counts(wire) == (3, 1, 0, {"expired": 2})


@pytest.mark.parametrize("action", ["reset", "restart"])
@simulated
async def test_a_component_that_is_helped_keeps_its_connectors_options(
    simulated_clock: SimulatedClock, action: str
) -> None:
    class Failing(Sink):
        def on_execute(self) -> None:
            if self.inp.is_new and self.inp.read_nowait().data == 1:
                raise ValueError("a test")

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.create(Failing, "sink")
        await kernel.connect(source.out, sink.inp, lifespan=1.0, max_gap=60.0, name="wire")
        kernel.supervise(sink, Supervision(action, backoff=0.5))
        await kernel.start(PeriodicContext(rate=0.1), sink, activate=True)
        source.out.write_nowait(long(1))
        await asyncio.sleep(15)
        wire = kernel.connectors["wire"]
        assert (wire.profile.lifespan, wire.profile.max_gap) == (1.0, 60.0)
        assert str(next(iter(kernel.components["sink"].states.values()))) == "active"
        before = counts(wire)[3].get("expired", 0)
        source.out.write_nowait(long(2))
        await asyncio.sleep(1)
        assert counts(wire)[2:] == (0, {**wire.statistics.dropped, "expired": before + 1})


@simulated
async def test_an_operation_ends_what_has_expired_first(simulated_clock: SimulatedClock) -> None:
    """A sample that has expired is dropped as that, whoever empties the queue afterwards."""
    async with Kernel() as kernel:
        source, sink, wire = await connected(kernel)
        context = await kernel.start(PeriodicContext(rate=0.001), sink, activate=True)
        source.out.write_nowait(long(1))
        await asyncio.sleep(1)
        await context.deactivate(sink)
        assert counts(wire) == (1, 0, 0, {"expired": 1})
        await context.activate(sink)
        source.out.write_nowait(long(2))
        await asyncio.sleep(1)
        await kernel.disconnect(wire)
        assert counts(wire) == (2, 0, 0, {"expired": 2})


@simulated
async def test_in_a_strict_rig(simulated_clock: SimulatedClock) -> None:
    """In debug mode every sample goes the checked way."""
    async with Kernel(debug=True) as kernel:
        source, sink, wire = await connected(kernel, length=1, full="block", timeout=None)
        for number in range(3):
            await source.out.write(long(number))
        assert sink.inp.read_nowait() == long(2)
        assert counts(wire) == (3, 1, 0, {"expired": 2})


@simulated
async def test_a_synchroniser_takes_nothing_that_is_too_old(simulated_clock: SimulatedClock) -> None:
    class Fusing(Component):
        one = InPort(TimedLong)
        two = InPort(TimedLong)

    async with Kernel() as kernel:
        left, right = await kernel.add(Source("left")), await kernel.add(Source("right"))
        fusing = await kernel.add(Fusing("fusing"))
        both = Synchronizer(fusing.one, fusing.two, policy="exact")
        await kernel.connect(left.out, fusing.one, lifespan=1.0)
        await kernel.connect(right.out, fusing.two)
        left.out.write_nowait(TimedLong(5, 1))
        await asyncio.sleep(1)
        right.out.write_nowait(TimedLong(5, 2))
        with pytest.raises(WouldBlock):
            both.match_nowait()
        left.out.write_nowait(TimedLong(5, 3))
        assert both.match_nowait() == (TimedLong(5, 3), TimedLong(5, 2))


class _Hurried(SimulatedClock):
    """A clock that goes on at each look at it."""

    step_ns = gone_ns = 0

    def monotonic_ns(self) -> int:
        self.gone_ns += self.step_ns
        return super().monotonic_ns() + self.gone_ns


@pytest.mark.parametrize("sources", [False, True])
def test_drain_gives_what_it_has_taken_when_the_last_sample_expires_in_between(sources: bool) -> None:
    async def run() -> None:
        clock = _Hurried()
        async with Kernel(clock=clock) as kernel:
            source, sink = await kernel.add(Source()), await kernel.add(Sink())
            connector = await kernel.connect(source.out, sink.inp, lifespan=1.0, length=8)
            got = []
            for looks in range(1, 12):
                source.out.write_nowait(long(1))
                source.out.write_nowait(long(2))
                clock.step_ns = 1_000_000_000 // looks
                got.append(len(sink.inp.drain(sources=sources)))
                clock.step_ns = 0
                assert connector.statistics.buffered == 0
                assert connector.statistics.delivered == sum(got)
            assert {0, 1, 2} == set(got)

    asyncio.run(run())
