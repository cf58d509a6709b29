"""Ports between a thread context and the loop: order, back-pressure both ways, ledgers, endings."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort, SimulatedClock, ThreadContext, WouldBlock
from aiorts.errors import ClosedError, ReadTimeout, StateError, ThreadError, WriteTimeout
from aiorts.kernel.ports.connector import transport_of, unread_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.receiver import Receiver
from aiorts.realtime.lock_free import make_lock_free
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from ports.parts import Sink, Source, long

pytestmark = pytest.mark.anyio


class Writer(Component):
    """Writes numbers from its thread, a burst in each cycle."""

    out = OutPort(TimedLong)

    def __init__(self, count: int, *, blocking: bool = False) -> None:
        super().__init__()
        self.count = count
        self.blocking = blocking
        self.written = 0

    def on_execute(self) -> None:
        for _ in range(100):
            if self.written == self.count:
                self.finish()
                return
            if self.blocking:
                assert self.out.write_blocking(long(self.written)) is True
            else:
                self.out.write_nowait(long(self.written))
            self.written += 1


class Reader(Component):
    """Reads in its thread, waiting."""

    inp = InPort(TimedLong)

    def __init__(self, count: int, slow: float = 0.0) -> None:
        super().__init__()
        self.count = count
        self.slow = slow
        self.seen: list[int] = []
        self.done = threading.Event()

    def on_execute(self) -> None:
        if self.slow:
            time.sleep(self.slow)
        self.seen.append(self.inp.read_blocking(5.0).data)
        if len(self.seen) == self.count:
            self.done.set()
            self.finish()


async def reached(condition: Any, seconds: float = 5.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "did not happen in time"
        await asyncio.sleep(0.001)


@pytest.mark.slow
@pytest.mark.row(44)
async def test_a_thread_waits_for_a_slow_reader_on_the_loop(anyio_backend: Any) -> None:
    count = 2_000
    async with Kernel() as kernel:
        writer, sink = await kernel.add(Writer(count, blocking=True)), await kernel.add(Sink())
        connector = await kernel.connect(writer.out, sink.inp, full="block", length=4, timeout=5.0)
        await kernel.start(ThreadContext(), writer, activate=True)
        seen: list[int] = []
        while len(seen) < count:
            assert unread_of(connector) <= 4
            seen.append((await asyncio.wait_for(sink.inp.read(), 5.0)).data)
        assert seen == list(range(count))
        assert connector.statistics.dropped == {}
        assert connector.statistics.written == count


@pytest.mark.slow
@pytest.mark.row(44)
async def test_the_loop_waits_for_a_slow_reader_in_a_thread(anyio_backend: Any) -> None:
    count = 2_000
    async with Kernel() as kernel:
        source, reader = await kernel.add(Source()), await kernel.add(Reader(count))
        connector = await kernel.connect(source.out, reader.inp, full="block", length=4, timeout=None)
        await kernel.start(ThreadContext(), reader, activate=True)
        for number in range(count):
            assert await source.out.write(long(number)) is True
            assert connector.statistics.balanced
        await reached(reader.done.is_set)
        assert reader.seen == list(range(count))
        assert connector.statistics.dropped == {}


@pytest.mark.slow(kept_by="test_the_ledger_balances_while_two_threads_hammer_the_connector")
async def test_between_two_threads_nothing_is_lost_with_block(anyio_backend: Any) -> None:
    count = 2_000
    async with Kernel() as kernel:
        writer, reader = await kernel.add(Writer(count, blocking=True)), await kernel.add(Reader(count))
        connector = await kernel.connect(writer.out, reader.inp, full="block", length=4, timeout=5.0)
        await kernel.start(ThreadContext(), reader, activate=True)
        await kernel.start(ThreadContext(), writer, activate=True)
        await reached(reader.done.is_set)
        assert reader.seen == list(range(count))
        assert connector.statistics.dropped == {}


@pytest.mark.slow(kept_by="test_the_ledger_balances_while_two_threads_hammer_the_connector")
@pytest.mark.row(39)
async def test_new_never_leaves_the_newest_sample_unread_across_threads(anyio_backend: Any) -> None:
    class Pairs(Component):
        """Writes two samples at once, then is silent until it is told to go on."""

        out = OutPort(TimedLong)
        round = -1

        def __init__(self) -> None:
            super().__init__()
            self.go = threading.Semaphore(0)

        def on_execute(self) -> None:
            if not self.go.acquire(timeout=0.2):
                return
            self.round += 1
            self.out.write_nowait(long(2 * self.round))
            self.out.write_nowait(long(2 * self.round + 1))

    class Newest(Component):
        inp = InPort(TimedLong)
        last = -1

        async def on_execute(self) -> None:
            self.last = self.inp.read_nowait().data

    async with Kernel() as kernel:
        pairs, task_sink, context_sink = await kernel.add(Pairs()), await kernel.add(Sink()), await kernel.add(Newest())
        await kernel.connect(pairs.out, task_sink.inp, context_sink.inp, subscription="new")
        await kernel.start(EventContext(), context_sink, activate=True)
        await kernel.start(ThreadContext(), pairs, activate=True)
        seen = -1

        async def read() -> None:
            nonlocal seen
            async for sample in task_sink.inp:
                seen = sample.data

        reading = asyncio.create_task(read())
        for number in range(1_000):
            pairs.go.release()
            await reached(lambda wanted=2 * number + 1: seen == wanted and context_sink.last == wanted)
        reading.cancel()
        await asyncio.wait([reading])


@pytest.mark.row(60)
@pytest.mark.campaign
@pytest.mark.parametrize("full", ["overwrite", "reject"])
async def test_the_ledger_balances_while_two_threads_hammer_the_connector(full: str, anyio_backend: Any) -> None:
    class Drainer(Component):
        inp = InPort(TimedLong)
        taken = 0

        def on_execute(self) -> None:
            self.taken += len(self.inp.drain())
            self.taken += self.inp.is_new and self.inp.latest is not None
            self.inp.peek()

    count = max(5_000, cases(100_000))
    async with Kernel() as kernel:
        writer, drainer, source = (
            await kernel.add(Writer(count)),
            await kernel.add(Drainer()),
            await kernel.add(Source()),
        )
        one = await kernel.connect(writer.out, drainer.inp, full=full, length=16)
        two = await kernel.connect(source.out, drainer.inp, full=full, length=16)
        await kernel.start(ThreadContext(), drainer, activate=True)
        await kernel.start(ThreadContext(), writer, activate=True)
        number = 0
        while writer.written < count:
            for _ in range(20):
                source.out.write_nowait(long(number))
                number += 1
            for connector in (one, two):
                ledger = connector.statistics
                assert ledger.balanced
                assert 0 <= ledger.buffered <= 16
                assert ledger.delivered >= 0
            await asyncio.sleep(0.0002)  # a loop that never waits hands the interpreter over every 5 ms only
        await reached(lambda: unread_of(one) == unread_of(two) == 0)
        await asyncio.sleep(0.01)
        ledgers = [one.statistics, two.statistics]
        assert [ledger.written for ledger in ledgers] == [count, number]
        assert drainer.taken == sum(ledger.delivered for ledger in ledgers)


@pytest.mark.slow(kept_by="test_a_thread_waits_for_data_and_room_in_virtual_time")
@pytest.mark.fault("B07")
async def test_a_thread_that_finds_no_room_ends_at_its_deadline(anyio_backend: Any) -> None:
    class Stuck(Component):
        out = OutPort(TimedLong)
        results: list[Any] = []  # noqa: RUF012 - one instance

        def on_execute(self) -> None:
            start = time.monotonic()
            try:
                self.out.write_blocking(long(1))
                self.out.write_blocking(long(2))
            except WriteTimeout as error:
                self.results.append((str(error), time.monotonic() - start))
            self.finish()

    async with Kernel() as kernel:
        stuck, one, two, free = [await kernel.add(part) for part in (Stuck(), Sink(), Sink(), Sink())]
        assert isinstance(stuck, Stuck)
        for sink, timeout in ((one, 0.5), (two, 0.6)):
            await kernel.connect(stuck.out, sink.ports["inp"], full="block", length=1, timeout=timeout)
        await kernel.connect(stuck.out, free.ports["inp"])
        await kernel.start(ThreadContext(), stuck, activate=True)
        await reached(lambda: stuck.results)
        [(text, elapsed)] = stuck.results
        assert "(0.5 s)" in text
        assert "(0.6 s)" in text
        assert "free" not in text
        assert 0.6 <= elapsed < 1.1  # together, not one after the other
        assert [dict(connector.statistics.dropped) for connector in stuck.out.connectors] == [
            {"timeout": 1},
            {"timeout": 1},
            {},
        ]
        assert all(connector.statistics.written == 2 for connector in stuck.out.connectors)


@pytest.mark.parametrize("how", ["disconnect", "deactivate reader", "stop"])
async def test_a_thread_that_waits_for_room_goes_on_when_there_is_nothing_to_wait_for(
    how: str, anyio_backend: Any
) -> None:
    class Blocked(Component):
        out = OutPort(TimedLong)
        outcome: Any = None
        writes = 0

        def on_execute(self) -> None:
            try:
                self.outcome = self.out.write_blocking(long(self.writes))
            except ClosedError as error:
                self.outcome = error
                raise
            self.writes += 1
            if self.writes == 3:
                self.finish()

    async with Kernel() as kernel:
        blocked, sink = await kernel.add(Blocked()), await kernel.add(Sink())
        reading = await kernel.start(EventContext(), sink, activate=True)
        connector = await kernel.connect(blocked.out, sink.inp, full="block", length=2, timeout=None)
        context = await kernel.start(ThreadContext(), blocked, activate=True)
        await reached(lambda: connector.statistics.written == 2 and bool(transport_of(connector).waiting))
        if how == "disconnect":
            await kernel.disconnect(connector)
            await reached(lambda: blocked.writes == 3)
            assert dict(connector.statistics.dropped) == {"disconnected": 3}
        elif how == "deactivate reader":
            await reading.deactivate()
            await reached(lambda: blocked.writes == 3)
            assert dict(connector.statistics.dropped) == {"inactive": 3}
        else:
            await asyncio.wait_for(context.stop(), 1.0)
            assert isinstance(blocked.outcome, ClosedError)
            assert blocked.last_error is None
            assert connector.statistics.written == 2
            assert not transport_of(connector).waiting


async def test_a_thread_that_waits_for_data_has_a_time_out_and_ends_with_its_context(anyio_backend: Any) -> None:
    class Patient(Component):
        inp = InPort(TimedLong)
        timed_out = waiting = 0

        def on_execute(self) -> None:
            if not self.timed_out:
                try:
                    self.inp.read_blocking(0.05)
                except ReadTimeout:
                    self.timed_out = 1
            self.waiting = 1
            self.inp.read_blocking()

    async with Kernel() as kernel:
        patient = await kernel.add(Patient())
        context = await kernel.start(ThreadContext(), patient, activate=True)
        await reached(lambda: patient.waiting)
        await asyncio.wait_for(context.stop(), 1.0)
        assert patient.timed_out
        assert patient.last_error is None


async def test_the_blocking_calls_are_refused_where_they_would_block_the_loop(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        await kernel.connect(source.out, sink.inp)
        with pytest.raises(StateError, match=r"await write\(\)"):
            source.out.write_blocking(long(1))
        with pytest.raises(StateError, match=r"await read\(\)"):
            sink.inp.read_blocking()
        with pytest.raises(StateError, match="ThreadContext"):
            await asyncio.to_thread(source.out.write_blocking, long(1))
        with pytest.raises(StateError, match="ThreadContext"):
            await asyncio.to_thread(sink.inp.read_blocking)


async def test_in_debug_mode_a_port_is_used_in_its_own_thread_only(anyio_backend: Any) -> None:
    class Foreign(Component):
        out = OutPort(TimedLong)
        runs = 0

        def on_execute(self) -> None:
            self.out.write_nowait(long(self.runs))
            self.runs += 1

    async with Kernel(debug=True) as kernel:
        foreign, sink, source = await kernel.add(Foreign()), await kernel.add(Sink()), await kernel.add(Source())
        await kernel.connect(foreign.out, sink.inp)
        inner = await kernel.connect(source.out, sink.inp)
        context = await kernel.start(ThreadContext(rate=500.0), foreign, activate=True)
        assert (await asyncio.wait_for(sink.inp.read(), 1.0)).data >= 0
        assert foreign.last_error is None  # waking a reader on the loop is no use of its port
        with pytest.raises(ThreadError, match="used from thread"):
            foreign.out.write_nowait(long(1))
        for call in (sink.inp.read_nowait, sink.inp.peek, sink.inp.drain, lambda: sink.inp.is_new):
            with pytest.raises(ThreadError):
                await asyncio.to_thread(call)
        assert inner.statistics.balanced
        await context.stop()


WAYS: list[dict[str, Any]] = [
    {},
    {"length": 1},
    {"subscription": "new"},
    {"subscription": "new", "push": "skip", "skip": 0},
    {"stamp": "send"},
]


@pytest.mark.fault("A16")
@pytest.mark.parametrize("options", WAYS, ids=lambda options: "-".join(map(str, options.values())) or "flush")
@pytest.mark.parametrize("several", [False, True], ids=["one writer", "two writers"])
async def test_a_foreign_thread_that_cannot_wake_a_waiting_reader_is_told_at_once(
    several: bool, options: dict[str, Any], anyio_backend: Any
) -> None:
    async with Kernel() as kernel:
        source, other, sink = await kernel.add(Source()), await kernel.add(Source()), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.inp, **options)
        if several:
            await kernel.connect(other.out, sink.inp)
        reading = asyncio.create_task(sink.inp.read())
        await asyncio.sleep(0)
        with pytest.raises(ThreadError, match=r"sink\.inp: .*write with port\.write_from_thread\(sample\)"):
            await asyncio.to_thread(source.out.write_nowait, long(1))
        [connector] = source.out.connectors
        assert connector.statistics.balanced
        assert connector.statistics.written == unread_of(connector) == 0
        source.out.write_nowait(long(2))
        assert (await asyncio.wait_for(reading, 5.0)).data == 2
        sink.inp.drain()
        await asyncio.to_thread(source.out.write_from_thread, long(3))  # what it says is to be done
        assert (await asyncio.wait_for(sink.inp.read(), 5.0)).data == 3


@pytest.mark.fault("A16")
async def test_a_foreign_thread_cannot_wake_an_event_context_and_is_told(anyio_backend: Any) -> None:
    class Counter(Sink):
        seen = 0

        async def on_execute(self) -> None:
            self.seen += len(self.inp.drain())

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Counter("sink"))
        await kernel.connect(source.out, sink.inp)
        await kernel.start(EventContext(), sink, activate=True)
        with pytest.raises(ThreadError, match=r"sink\.inp: "):
            await asyncio.to_thread(source.out.write_nowait, long(1))
        source.out.write_nowait(long(2))
        await reached(lambda: sink.seen == 1)


@pytest.mark.fault("A16")
@pytest.mark.parametrize(
    ("options", "activate", "dropped"),
    [({"subscription": "periodic", "push_rate": 100.0}, True, {}), ({}, False, {"inactive": 1})],
    ids=["at the end of a period", "not active"],
)
async def test_a_foreign_thread_writes_where_the_sample_wakes_no_reader_at_once(
    options: dict[str, Any], activate: bool, dropped: dict[str, int], anyio_backend: Any
) -> None:
    class Counter(Sink):
        seen = 0

        async def on_execute(self) -> None:
            self.seen += len(self.inp.drain())

    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Counter("sink"))
        connector = await kernel.connect(source.out, sink.inp, **options)
        await kernel.start(EventContext(), sink, activate=activate)
        await asyncio.to_thread(source.out.write_nowait, long(1))
        await reached(lambda: sink.seen == 1 - sum(dropped.values()))
        found = connector.statistics
        assert (found.written, {why: n for why, n in found.dropped.items() if n}) == (1, dropped)


WRITES: dict[str, Callable[[OutPort[TimedLong]], object]] = {
    "write_nowait": lambda out: out.write_nowait(long(1)),
    "write in another loop": lambda out: asyncio.run(asyncio.wait_for(out.write(long(1)), 1.0)),
}
MORE: list[dict[str, Any]] = [
    *WAYS,
    {"stamp": "read"},
    {"length": 1, "full": "reject"},
    {"length": 1, "full": "block"},
    {"length": 0},
    {"lifespan": 1.0},
    {"keep_last": True},
    {"measure": 10},
    {"max_gap": 5.0},
    {"convert": lambda sample: sample},
    {"subscription": "periodic", "push_rate": 5.0},
]


@pytest.mark.fault("A16")
@pytest.mark.parametrize("write", WRITES)
@pytest.mark.parametrize("options", MORE, ids=lambda options: "-".join(options) or "default")
@pytest.mark.parametrize("place", [0, 1, 2], ids=["the first waits", "the second waits", "the last waits"])
async def test_a_write_that_a_foreign_thread_may_not_make_reaches_no_reader(
    place: int, options: dict[str, Any], write: str, anyio_backend: Any
) -> None:
    """Of three readers one sleeps: it gets the sample with the others, or nobody does."""
    async with Kernel() as kernel:
        source = await kernel.add(Source())
        sinks = [await kernel.add(Sink(f"sink{number}")) for number in range(3)]
        connectors = [
            await kernel.connect(source.out, sink.inp, **(options if number == place else {}))
            for number, sink in enumerate(sinks)
        ]
        reading = asyncio.create_task(sinks[place].inp.read())
        await asyncio.sleep(0)
        try:
            await asyncio.wait_for(asyncio.to_thread(WRITES[write], source.out), 5.0)
            raised = None
        except (ThreadError, WouldBlock) as error:
            raised = error
        written = [connector.statistics.written for connector in connectors]
        assert written == ([0] * 3 if raised is not None else [1] * 3), raised
        assert all(connector.statistics.balanced for connector in connectors)
        if raised is not None:
            assert not any(sink.inp.is_new for sink in sinks)
        reading.cancel()
        await asyncio.wait([reading])


@pytest.mark.fault("A16")
@pytest.mark.parametrize("options", [{}, {"stamp": "read"}], ids=["plain", "stamped"])
async def test_a_foreign_thread_that_cannot_wake_a_waiting_writer_takes_nothing(
    options: dict[str, Any], anyio_backend: Any
) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.inp, length=1, full="block", **options)
        await source.out.write(long(1))
        writing = asyncio.create_task(source.out.write(long(2)))
        await asyncio.sleep(0)
        for read in (sink.inp.read_nowait, lambda: sink.inp.latest, sink.inp.drain):
            with pytest.raises(ThreadError, match=r"sink\.inp: .* nothing was read; read on that loop"):
                await asyncio.to_thread(read)
        assert connector.statistics.delivered == 0
        assert sink.inp.read_nowait().data == 1
        assert await asyncio.wait_for(writing, 5.0)


async def test_statistics_of_an_unshared_connector_are_read_on_the_loop(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        connector = await kernel.connect(source.out, sink.inp)
        with pytest.raises(ThreadError, match="statistics"):
            await asyncio.to_thread(lambda: connector.statistics)


@pytest.mark.slow
async def test_a_port_shared_with_a_thread_wakes_an_event_context_for_every_spell_of_data(anyio_backend: Any) -> None:
    class Counting(Component):
        inp = InPort(TimedLong)
        taken = 0

        async def on_execute(self) -> None:
            self.inp.read_nowait()
            self.taken += 1

    count = 5_000
    async with Kernel() as kernel:
        writer, counting = await kernel.add(Writer(count)), await kernel.add(Counting())
        connector = await kernel.connect(writer.out, counting.inp, length=count)
        await kernel.start(EventContext(), counting, activate=True)
        await kernel.start(ThreadContext(), writer, activate=True)
        await reached(lambda: counting.taken == count)
        assert connector.statistics.dropped == {}


async def test_periodic_samples_of_a_thread_arrive_on_the_loop(anyio_backend: Any) -> None:
    async with Kernel() as kernel:
        writer, sink = await kernel.add(Writer(2_000)), await kernel.add(Sink())
        connector = await kernel.connect(
            writer.out, sink.inp, subscription="periodic", push="all", push_rate=1000.0, out_length=10, length=10
        )
        await kernel.start(ThreadContext(), writer, activate=True)
        await reached(lambda: writer.written == 2_000)
        await reached(lambda: transport_of(connector).buffered == unread_of(connector))
        ledger = connector.statistics
        assert ledger.written == 2_000
        assert ledger.balanced
        assert sink.inp.drain()[-1].data == 1_999
        with pytest.raises(WouldBlock):
            sink.inp.read_nowait()


@pytest.mark.parametrize("timeout", [0.5, 3.0])
def test_a_thread_waits_for_data_and_room_in_virtual_time(timeout: float) -> None:
    class Waiting(Component):
        inp, out = InPort(TimedLong), OutPort(TimedLong)

        def __init__(self) -> None:
            super().__init__("waiting")
            self.moments: list[tuple[str, int]] = []

        def on_execute(self) -> None:
            for call in (lambda: self.inp.read_blocking(timeout), lambda: self.out.write_blocking(long(1), timeout)):
                try:
                    call()
                    outcome = "done"
                except (ReadTimeout, WriteTimeout) as error:
                    outcome = type(error).__name__
                self.moments.append((outcome, self.clock.monotonic_ns()))
            self.finish()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            waiting, source, sink = await kernel.add(Waiting()), await kernel.add(Source()), await kernel.add(Sink())
            await kernel.connect(source.out, waiting.inp)
            await kernel.connect(waiting.out, sink.inp, full="block", length=1)
            waiting.out.write_nowait(long(0))
            context = await kernel.start(ThreadContext(), waiting, activate=True)
            await kernel.sleep(1.0)
            source.out.write_nowait(long(7))
            await kernel.sleep(1.0)
            sink.inp.read_nowait()
            await kernel.sleep(5.0)
            await context.stop()
            second = 1_000_000_000
            assert waiting.moments == (
                [("ReadTimeout", second // 2), ("WriteTimeout", second)]
                if timeout < 1.0
                else [("done", second), ("done", 2 * second)]
            )

    simulate(main)


class Vanishing(deque[Any]):
    """Another thread takes back what is in it, once, in the moment in which it is read."""

    times = 1

    def popleft(self) -> Any:
        if self.times:
            self.times -= 1
            self.clear()
        return super().popleft()


class Listener(Component):
    inp = InPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[Any] = []

    def on_execute(self) -> None:
        try:
            self.seen.append(self.inp.read_blocking(1.0).data)
        except ReadTimeout as error:
            self.seen.append(type(error))


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("comes_late", [True, False])
async def test_what_vanishes_while_it_is_read_across_threads_was_never_there(comes_late: bool) -> None:
    """At a port without a lock a sample may be overwritten or disconnected between a look and the reading."""
    async with Kernel() as kernel:
        source, listener = await kernel.add(Source()), await kernel.add(Listener("listener"))
        connector = await kernel.connect(source.out, listener.inp)
        make_lock_free(listener.inp)
        transport_of(connector).queue = Vanishing()
        await kernel.start(ThreadContext(), listener, activate=True)
        source.out.write_nowait(long(1))
        if comes_late:
            await kernel.sleep(0.2)
            source.out.write_nowait(long(2))
        async with asyncio.timeout(20):
            while not listener.seen:
                await kernel.sleep(0.01)
        assert listener.seen[0] == (2 if comes_late else ReadTimeout)


async def test_what_vanishes_while_it_is_awaited_was_never_there() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source()), await kernel.add(Sink())
        connector = await kernel.connect(source.out, sink.inp)
        make_lock_free(sink.inp)
        transport_of(connector).queue = Vanishing()
        source.out.write_nowait(long(1))
        reading = asyncio.create_task(sink.inp.read())
        await kernel.sleep(0.05)
        assert not reading.done()
        source.out.write_nowait(long(2))
        assert (await reading).data == 2


async def test_ports_get_their_locks_on_the_loop_and_not_while_somebody_there_is_inside(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where a component joins a context that runs, and where it is connected while it is about to."""
    locked_in: list[int] = []
    make_locked = Receiver.make_locked

    def noted(receiver: Receiver) -> None:
        if receiver.lock is None:
            locked_in.append(threading.get_ident())
        make_locked(receiver)

    monkeypatch.setattr(Receiver, "make_locked", noted)
    inside, goes_on = threading.Event(), threading.Event()

    class Both(Component):
        inp = InPort(TimedLong)
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            inside.set()
            assert goes_on.wait(20.0)

    async with Kernel() as kernel:
        source, first, both, sink, late = (
            *(await kernel.add(Source("source")), await kernel.add(Both("first")), await kernel.add(Both("both"))),
            *(await kernel.add(Sink("sink")), await kernel.add(Sink("late"))),
        )
        await kernel.connect(source.out, both.inp)
        await kernel.connect(both.out, sink.inp)
        context = await kernel.start(ThreadContext(rate=100.0), first, activate=True)
        while not inside.is_set():
            await kernel.sleep(0.01)
        joining = asyncio.create_task(context.add(both, timeout=20.0))
        await kernel.sleep(0.01)
        await kernel.connect(both.out, late.inp)
        assert both not in context.members
        goes_on.set()
        await joining
        assert both in context.members
        assert all(receiver_of(port).lock is not None for port in (first.inp, both.inp, sink.inp, late.inp))
        assert locked_in == [threading.get_ident()] * 4
