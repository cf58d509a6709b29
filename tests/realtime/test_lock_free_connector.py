"""Connectors of real-time threads: the rules of all connectors, without a lock, whatever the threads do meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import (
    Component,
    Connector,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
    WouldBlock,
)
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.ports.connector import transport_of, unread_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.realtime.lock_free import LockFreeReceiver, let_go, make_all_lock_free, make_lock_free
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from ports.parts import Sink, Source, long
from ports.test_connector import COMBINATIONS, Schedule

pytestmark = pytest.mark.anyio


@pytest.fixture
def restless() -> Iterator[None]:
    """Threads change places as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


async def reached(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "did not happen in time"
        await asyncio.sleep(0.001)


class Flipping(Schedule):
    """A schedule in which the reader goes into a real-time thread and comes back, between any two steps."""

    flips = 0

    def compare(self, step: str) -> None:
        super().compare(step)
        port = self.sink.inp
        if self.random.random() < 0.3:
            before = [connector for connector, _ in self.all]
            (let_go if isinstance(receiver_of(port), LockFreeReceiver) else make_lock_free)(port)
            self.flips += 1
            assert [connector for connector, _ in self.all] == before
            super().compare(step)


@pytest.mark.slow(kept_by="test_in_virtual_time_samples_cross_at_exact_moments")
@pytest.mark.row(39, 40, 41)
@pytest.mark.campaign
def test_a_crossing_connector_obeys_the_reference_model_also_when_it_becomes_one_in_between() -> None:
    async def main(clock: SimulatedClock) -> None:
        flips = 0
        for number in range(max(cases(10_000), 3 * len(COMBINATIONS))):
            schedule = Flipping(number)
            await schedule.play(clock)
            flips += schedule.flips
        assert flips > 100

    simulate(main)


# -- two real threads --------------------------------------------------------------------------------------------------


class Auditor:
    """Reads the ledger as fast as it can, in a third thread."""

    def __init__(self, connector: Connector, length: int) -> None:
        self.connector, self.length = connector, length
        self.faults: list[str] = []
        self.looks = 0
        self.over = False
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self) -> None:
        written = delivered = 0
        while not self.over:
            ledger = self.connector.statistics
            self.looks += 1
            if not ledger.balanced or ledger.delivered < delivered or ledger.written < written:
                self.faults.append(f"{ledger} after {written}, {delivered}")
            if not 0 <= ledger.buffered <= self.length:
                self.faults.append(f"buffered: {ledger}")
            written, delivered = ledger.written, ledger.delivered

    def end(self) -> None:
        self.over = True
        self.thread.join()


READS: dict[str, Callable[[InPort[Any]], list[int]]] = {
    "read": lambda port: [port.read_nowait().data] if port.is_new else [],
    "drain": lambda port: [sample.data for sample in port.drain()],
    "latest": lambda port: [port.latest.data] if port.is_new and port.latest is not None else [],
}


async def stress(
    subscription: str, push: str, full: str, length: int, how: str, count: int
) -> tuple[list[int], Connector, Auditor]:
    """A writer and a reader in bare threads: the harshest neighbours there are."""
    options: dict[str, Any] = {"subscription": subscription, "push": push, "full": full, "length": length}
    if push == "skip":
        options["skip"] = 2
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        cell(source).realtime = cell(sink).realtime = True
        make_all_lock_free(sink.inp)
        connector = await kernel.connect(source.out, sink.inp, **options)
        auditor = Auditor(connector, length)
        seen: list[int] = []
        done = threading.Event()

        def write() -> None:
            for number in range(count):
                while True:
                    try:
                        source.out.write_nowait(long(number))
                    except WouldBlock:
                        time.sleep(0)
                        continue
                    break
            done.set()

        def read() -> None:
            while not done.is_set() or sink.inp.is_new:
                with contextlib.suppress(WouldBlock):  # overwritten between the question and the read
                    seen.extend(READS[how](sink.inp))

        threads = [threading.Thread(target=write), threading.Thread(target=read)]
        for thread in threads:
            thread.start()
        for thread in threads:
            await asyncio.to_thread(thread.join)
        auditor.end()
        return seen, connector, auditor


@pytest.mark.slow(kept_by="test_a_ledger_is_not_read_in_the_middle_of_a_write")
@settings(
    max_examples=cases(1000),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.sampled_from([c for c in COMBINATIONS if c[0] != "periodic"]),
    st.sampled_from([1, 2, 8]),
    st.sampled_from(sorted(READS)),
)
@pytest.mark.campaign
@pytest.mark.usefixtures("restless")
def test_between_two_threads_the_ledger_balances_at_each_look_and_order_is_kept(
    combination: tuple[str, str, str], length: int, how: str
) -> None:
    subscription, push, full = combination
    count = 800
    seen, connector, auditor = asyncio.run(stress(subscription, push, full, length, how, count))
    assert auditor.faults == []
    assert auditor.looks > 0
    ledger = connector.statistics
    assert ledger.written == count
    assert ledger.buffered == 0
    if how != "latest":  # asked again, it is the same
        assert all(one < two for one, two in itertools.pairwise(seen)), "order, nothing twice"
        assert ledger.delivered == len(seen)
    else:
        assert all(one <= two for one, two in itertools.pairwise(seen))
    if full == "block" and push in ("all", "fifo") and how != "latest":
        assert seen == list(range(count))
        assert dict(ledger.dropped) == {}
    if full != "reject" and push in ("all", "fifo", "new"):
        assert seen[-1] == count - 1  # the newest is never stranded


async def test_a_sample_written_before_the_reader_is_armed_wakes_it_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.inp)
        make_lock_free(sink.inp)
        kind, written = type(sink.inp), list[bool]()
        before = kind._open_host

        def in_between(port: InPort[Any]) -> Any:
            host = before(port)
            if not written:
                written.append(source.out.write_nowait(long(7)))
            return host

        monkeypatch.setattr(kind, "_open_host", in_between)
        assert (await asyncio.wait_for(sink.inp.read(), 5.0)).data == 7
        assert written == [True]


async def test_a_ledger_is_not_read_in_the_middle_of_a_write() -> None:
    """A sample that is written and not in its buffer yet would count as delivered."""
    seen: list[int] = []
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.inp, stamp="send")
        make_lock_free(sink.inp)
        looker = threading.Thread(target=lambda: seen.append(connector.statistics.delivered))

        def in_the_middle() -> int:
            looker.start()
            time.sleep(0.01)
            assert seen == []
            return 1

        transport: Any = transport_of(connector)
        transport.clock = SimpleNamespace(time_ns=in_the_middle, monotonic_ns=kernel.clock.monotonic_ns)
        source.out.write_nowait(long(1))
        looker.join()
        assert seen == [0]


async def test_a_sample_that_comes_in_while_its_connector_ends_is_dropped_as_disconnected() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.inp, stamp="send")
        make_lock_free(sink.inp)

        def in_the_middle() -> int:
            kernel.connections.end(connector)
            return 1

        transport: Any = transport_of(connector)
        transport.clock = SimpleNamespace(time_ns=in_the_middle, monotonic_ns=kernel.clock.monotonic_ns)
        assert source.out.write_nowait(long(1)) is True
        ledger = connector.statistics
        assert (ledger.written, ledger.buffered, dict(ledger.dropped)) == (1, 0, {"disconnected": 1})


# -- in their contexts -------------------------------------------------------------------------------------------------


class Servo(Component):
    """Answers what it reads, in any context."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[int] = []

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            self.seen.append(sample.data)
            await self.out.write(sample)


class Echo(Component):
    """Reads in an event context."""

    inp = InPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[int] = []

    async def on_execute(self) -> None:
        self.seen.append((await self.inp.read()).data)


@pytest.mark.slow(kept_by="test_in_virtual_time_samples_cross_at_exact_moments")
@pytest.mark.row(9, 44)
async def test_loop_to_real_time_and_back_loses_nothing_with_block() -> None:
    count = 3_000
    async with Kernel() as kernel:
        source, servo, echo = (
            await kernel.add(Source("source")),
            await kernel.add(Servo("servo")),
            await kernel.add(Echo("echo")),
        )
        there = await kernel.connect(source.out, servo.inp, full="block", length=4, timeout=None)
        back = await kernel.connect(servo.out, echo.inp, full="overwrite", length=count)
        await kernel.start(EventContext(), echo, activate=True)
        context = await kernel.start(RealtimeContext(2000.0), servo, activate=True)
        for number in range(count):
            assert await source.out.write(long(number)) is True
            assert there.statistics.balanced
        await reached(lambda: len(echo.seen) == count)
        assert servo.seen == echo.seen == list(range(count))
        assert dict(there.statistics.dropped) == dict(back.statistics.dropped) == {}
        assert context.state(servo) is LifecycleState.ACTIVE


@pytest.mark.slow(kept_by="test_a_sample_written_before_the_reader_is_armed_wakes_it_all_the_same")
async def test_one_wake_up_is_asked_for_until_the_loop_runs_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0

    class Burst(Component):
        out = OutPort(TimedLong)

        def on_execute(self) -> None:
            for number in range(500):
                self.out.write_nowait(long(number))
            self.finish()

    async with Kernel() as kernel:
        burst, sink = await kernel.add(Burst("burst")), await kernel.add(Sink("sink"))
        await kernel.connect(burst.out, sink.inp, length=1000)
        context = await kernel.start(RealtimeContext(100.0), burst)
        notify = sink.inp._on_loop

        def count(callback: Callable[[], None]) -> None:
            nonlocal asked
            asked += 1
            notify(callback)

        monkeypatch.setattr(type(sink.inp), "_on_loop", lambda self, callback: count(callback))
        reading = asyncio.ensure_future(sink.inp.read())
        await asyncio.sleep(0)
        activating = asyncio.ensure_future(context.activate(burst))
        await asyncio.sleep(0)
        time.sleep(0.05)  # the loop stands still meanwhile
        assert (await asyncio.wait_for(reading, 5.0)).data == 0
        await activating
        await reached(lambda: len(sink.inp.drain()) + 1 >= 0 and context.state(burst) is LifecycleState.INACTIVE)
    assert asked == 1


@pytest.mark.slow(kept_by="test_the_lock_of_a_port_is_never_taken_by_a_real_time_thread")
async def test_a_real_time_writer_never_waits_for_a_full_reader() -> None:
    class Stubborn(Component):
        out = OutPort(TimedLong)

        def __init__(self, name: str) -> None:
            super().__init__(name)
            self.refused = 0

        async def on_execute(self) -> None:
            try:
                await self.out.write(long(1))
            except WouldBlock:
                self.refused += 1

    async with Kernel() as kernel:
        stubborn, sink = await kernel.add(Stubborn("stubborn")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(stubborn.out, sink.inp, full="block", length=2, timeout=None)
        await kernel.start(RealtimeContext(500.0), stubborn, activate=True)
        await reached(lambda: stubborn.refused > 5)
        assert unread_of(connector) == 2
        assert stubborn.last_error is None


@pytest.mark.slow(
    kept_by="realtime/test_realtime_context.py::test_a_hook_that_suspends_is_an_error_that_names_it_and_says_what_to_do"
)
async def test_a_read_that_would_wait_is_an_error_of_the_component_that_names_the_port() -> None:
    class Waits(Component):
        inp = InPort(TimedLong)

        async def on_execute(self) -> None:
            await self.inp.read()

    async with Kernel() as kernel:
        waits = await kernel.add(Waits("waits"))
        context = await kernel.start(RealtimeContext(200.0), waits, activate=True)
        await reached(lambda: context.state(waits) is LifecycleState.ERROR)
        assert isinstance(waits.last_error, WouldBlock)
        assert "waits.inp: no unread sample, and a hook of a real-time context cannot wait" in str(waits.last_error)


@pytest.mark.slow(kept_by="first")
async def test_the_lock_of_a_port_is_never_taken_by_a_real_time_thread() -> None:
    """Held by somebody forever, it holds up nobody."""

    class Blocker(Component):
        inp = InPort(TimedLong)

        def __init__(self, name: str) -> None:
            super().__init__(name)
            self.seen: list[int] = []

        def on_execute(self) -> None:
            self.seen.append(self.inp.read_blocking().data)

    async with Kernel() as kernel:
        servo, source, blocker = (
            await kernel.add(Servo("servo")),
            await kernel.add(Source("source")),
            await kernel.add(Blocker("blocker")),
        )
        await kernel.connect(source.out, servo.inp, length=100)
        await kernel.connect(servo.out, blocker.inp, length=100)
        await kernel.start(ThreadContext(), blocker, activate=True)
        context = await kernel.start(RealtimeContext(500.0), servo, activate=True)
        source.out.write_nowait(long(1))
        await reached(lambda: blocker.seen == [1])
        lock = receiver_of(blocker.inp).lock
        assert lock is not None
        released, held = threading.Event(), threading.Event()

        def hold() -> None:
            with lock:
                held.set()
                released.wait(5.0)

        holder = threading.Thread(target=hold)
        holder.start()
        held.wait(5.0)
        source.out.write_nowait(long(2))
        # The loop does not turn here: it may wait for that lock, the real-time thread does not.
        until = time.monotonic() + 5.0
        while len(servo.seen) < 2 and time.monotonic() < until:
            time.sleep(0.001)
        seen, ticks = servo.seen.copy(), context.ticks
        while context.ticks < ticks + 10 and time.monotonic() < until:
            time.sleep(0.001)
        went_on = context.ticks >= ticks + 10
        released.set()
        holder.join()
        assert seen == [1, 2]
        assert went_on
        await reached(lambda: blocker.seen == [1, 2])


@pytest.mark.slow(kept_by="test_in_virtual_time_samples_cross_at_exact_moments")
@pytest.mark.parametrize("writer_is_real_time", [True, False])
async def test_between_a_thread_that_blocks_and_a_real_time_thread(writer_is_real_time: bool) -> None:
    count = 500

    class Writer(Component):
        out = OutPort(TimedLong)
        number = 0

        def on_execute(self) -> None:
            if self.number == count:
                self.finish()
                return
            if writer_is_real_time:
                self.out.write_nowait(long(self.number))
            else:
                assert self.out.write_blocking(long(self.number), 10.0)
            self.number += 1

    class Reader(Component):
        inp = InPort(TimedLong)

        def on_activated(self) -> None:
            self.seen: list[int] = []

        def on_execute(self) -> None:
            if writer_is_real_time:
                self.seen.append(self.inp.read_blocking().data)
            else:
                self.seen += [sample.data for sample in self.inp.drain()]

    async with Kernel() as kernel:
        writer, reader = await kernel.add(Writer("writer")), await kernel.add(Reader("reader"))
        full = "overwrite" if writer_is_real_time else "block"
        length = count if writer_is_real_time else 2
        connector = await kernel.connect(writer.out, reader.inp, full=full, length=length, timeout=None)
        kinds = (RealtimeContext(2000.0), ThreadContext())
        first, second = (reader, writer) if writer_is_real_time else (writer, reader)
        await kernel.start(kinds[1], first)
        await kernel.start(kinds[0], second)
        await reader.context.activate(reader)
        await writer.context.activate(writer)
        await reached(lambda: len(reader.seen) == count)
        assert reader.seen == list(range(count))
        assert dict(connector.statistics.dropped) == {}


@pytest.mark.slow(kept_by="test_in_virtual_time_samples_cross_at_exact_moments")
async def test_between_two_real_time_threads_and_with_fan_in_and_fan_out() -> None:
    class Counter(Component):
        out = OutPort(TimedLong)
        number = 0

        def on_execute(self) -> None:
            if self.number < 200:
                self.out.write_nowait(long(self.number))
                self.number += 1

    async with Kernel() as kernel:
        counters = [await kernel.add(Counter(f"counter{i}")) for i in range(3)]
        servo, echo = await kernel.add(Servo("servo")), await kernel.add(Echo("echo"))
        connectors = await kernel.connect(*(c.out for c in counters), servo.inp, echo.inp, length=1000)
        await kernel.start(EventContext(), echo, activate=True)
        await kernel.start(RealtimeContext(500.0), servo, activate=True)
        await kernel.start(RealtimeContext(1000.0), counters[0], activate=True)
        await kernel.start(ThreadContext(1000.0), counters[1], activate=True)
        await kernel.start(RealtimeContext(700.0), counters[2], activate=True)
        await reached(lambda: len(servo.seen) == len(echo.seen) == 600)
        for seen in (servo.seen, echo.seen):
            assert sorted(seen) == sorted([*range(200)] * 3)
        assert all(not connector.statistics.dropped for connector in connectors)
        assert [connector.statistics.delivered for connector in connectors] == [200] * 6


@pytest.mark.slow(kept_by="test_in_virtual_time_samples_cross_at_exact_moments")
@pytest.mark.row(39)
@pytest.mark.parametrize("push", ["all", "fifo", "new", "skip"])
async def test_a_periodic_connector_carries_out_of_and_into_a_real_time_thread(push: str) -> None:
    class Counter(Component):
        out = OutPort(TimedLong)
        number = 0

        def on_execute(self) -> None:
            if self.number < 60:
                self.number += 1
                self.out.write_nowait(long(self.number))

    options: dict[str, Any] = {"subscription": "periodic", "push": push, "push_rate": 200.0, "out_length": 100}
    if push == "skip":
        options["skip"] = 1
    async with Kernel() as kernel:
        counter, servo = await kernel.add(Counter("counter")), await kernel.add(Servo("servo"))
        connector = await kernel.connect(counter.out, servo.inp, length=100, **options)
        await kernel.start(RealtimeContext(500.0), servo, activate=True)
        await kernel.start(RealtimeContext(1000.0), counter, activate=True)
        await reached(lambda: counter.number == 60 and connector.statistics.buffered == 0)
        ledger = connector.statistics
        await reached(lambda: len(servo.seen) == ledger.delivered)
        assert servo.seen == sorted(set(servo.seen))
        if push in ("all", "fifo"):
            assert servo.seen == list(range(1, 61))
        elif push == "skip":
            assert servo.seen == list(range(2, 61, 2))
        else:
            assert servo.seen[-1] == 60
            assert ledger.dropped.get("superseded", 0) == 60 - len(servo.seen)


@pytest.mark.slow(kept_by="test_a_sample_that_comes_in_while_its_connector_ends_is_dropped_as_disconnected")
async def test_connections_come_and_go_and_components_change_their_context_while_samples_flow() -> None:
    class Counter(Component):
        out = OutPort(TimedLong)
        number = 0

        def on_execute(self) -> None:
            self.number += 1
            self.out.write_nowait(long(self.number))

    async with Kernel() as kernel:
        counter, sink = await kernel.add(Counter("counter")), await kernel.add(Sink("sink"))
        context = await kernel.start(RealtimeContext(2000.0), counter, activate=True)
        ledgers = []
        for _ in range(30):
            connector = await kernel.connect(counter.out, sink.inp, length=4)
            await asyncio.sleep(0.003)
            sink.inp.drain()
            await asyncio.sleep(0.001)
            await kernel.disconnect(connector)
            ledgers.append(connector)
        await asyncio.sleep(0.005)
        for connector in ledgers:
            ledger = connector.statistics
            assert ledger.balanced
            assert ledger.buffered == 0
        kept = await kernel.connect(counter.out, sink.inp, length=4)
        for _ in range(5):
            await context.remove(counter)
            fast = receiver_of(sink.inp).lock is None
            counter.out.write_nowait(long(-1))
            assert sink.inp.drain()[-1].data == -1
            await context.add(counter)
            await context.activate(counter)
            await asyncio.sleep(0.005)
            assert kept.statistics.balanced
        assert fast  # out of the thread, ports are as before
        assert counter.last_error is None


@pytest.mark.row(29)
def test_in_virtual_time_samples_cross_at_exact_moments() -> None:
    async def main(clock: SimulatedClock) -> list[int]:
        moments: list[int] = []

        class Clocked(Component):
            out = OutPort(TimedLong)

            async def on_execute(self) -> None:
                await self.out.write(TimedLong(0, self.clock.monotonic_ns()))

        async with Kernel() as kernel:
            clocked, sink = await kernel.add(Clocked("clocked")), await kernel.add(Sink("sink"))
            await kernel.connect(clocked.out, sink.inp)
            await kernel.start(RealtimeContext(10.0), clocked, activate=True)
            for _ in range(20):
                sample = await sink.inp.read()
                assert sample.data == clock.monotonic_ns()
                moments.append(sample.data)
        return moments

    assert simulate(main) == [n * 100_000_000 for n in range(20)]


@pytest.mark.slow(
    kept_by="ports/test_in_port.py::test_samples_for_an_inactive_component_are_dropped_and_activation_starts_empty"
)
async def test_samples_for_an_inactive_real_time_reader_are_dropped_as_such() -> None:
    async with Kernel() as kernel:
        source, servo = await kernel.add(Source("source")), await kernel.add(Servo("servo"))
        connector = await kernel.connect(source.out, servo.inp, full="block", length=1, timeout=None)
        context = await kernel.start(RealtimeContext(20.0), servo)
        assert source.out.write_nowait(long(1)) is True
        assert dict(connector.statistics.dropped) == {"inactive": 1}
        await context.activate(servo)
        await source.out.write(long(2))
        await reached(lambda: servo.seen == [2])
        await context.set_rate(0.1)
        await source.out.write(long(3))
        waiting = asyncio.ensure_future(source.out.write(long(4)))
        await asyncio.sleep(0.01)
        assert not waiting.done()
        await context.deactivate(servo)
        assert await asyncio.wait_for(waiting, 5.0) is True
        ledger = connector.statistics
        assert (ledger.written, ledger.delivered, dict(ledger.dropped)) == (4, 1, {"inactive": 3})
