"""Writes of foreign threads: counts, order, room, endings, and what each wrong use is answered with."""

from __future__ import annotations

import asyncio
import contextlib
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.errors import ClosedError, ConfigurationError, PortTypeError, ReadTimeout, StateError, ThreadError
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDoubleSeq, TimedLong
from campaign import CAMPAIGN, cases, time_limit
from ports.parts import Sink, Source, data, long

pytestmark = pytest.mark.anyio

LIMIT, BATCH = 1024, 256


def threads(*bodies: Callable[[], object]) -> tuple[list[threading.Thread], list[BaseException]]:
    """Started; and what they raise."""
    raised: list[BaseException] = []

    def run(body: Callable[[], object]) -> None:
        try:
            body()
        except BaseException as error:
            raised.append(error)

    made = [threading.Thread(target=run, args=(body,), daemon=True) for body in bodies]
    for thread in made:
        thread.start()
    return made, raised


async def joined(*bodies: Callable[[], object]) -> list[BaseException]:
    """What the threads raised, once all have ended; the loop goes on meanwhile."""
    made, raised = threads(*bodies)
    for thread in made:
        await asyncio.to_thread(thread.join, 60)
        assert not thread.is_alive()
    return raised


def at_once(body: Callable[[], object]) -> None:
    """Run in a thread while the loop stands still."""
    made, raised = threads(body)
    made[0].join(20)
    assert not made[0].is_alive()
    if raised:
        raise raised[0]


def counts(out: OutPort[Any]) -> tuple[int, int, int, dict[str, int], int]:
    now = out.thread_writes
    assert now.accepted == now.written + now.waiting + sum(now.dropped.values())
    return now.accepted, now.written, now.waiting, dict(now.dropped), now.refused


async def turns(condition: Callable[[], bool]) -> None:
    """Let the loop turn until it is so, at most a thousand times."""
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0)
    raise AssertionError("it did not come about")


@contextmanager
def switching_often() -> Iterator[None]:
    """Threads take turns a thousand times as often as usual."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(5e-6)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


async def test_a_port_without_thread_writes_has_counts_of_nothing() -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        assert counts(source.out) == (0, 0, 0, {}, 0)


async def test_1024_wait_and_the_next_is_refused_and_the_loop_takes_256_in_a_turn() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.inp, length=2 * LIMIT)
        answers: list[bool] = []
        at_once(lambda: answers.extend(source.out.write_from_thread(long(n)) for n in range(LIMIT + 3)))
        assert answers == [True] * LIMIT + [False] * 3
        assert counts(source.out) == (LIMIT, 0, LIMIT, {}, 3)
        assert connector.statistics.written == 0
        seen = [0]
        while seen[-1] < LIMIT:
            await asyncio.sleep(0)
            if connector.statistics.written != seen[-1]:
                seen.append(connector.statistics.written)
        assert seen == [0, 256, 512, 768, 1024]
        assert counts(source.out) == (LIMIT, LIMIT, 0, {}, 3)
        assert data(sink.inp.drain()) == list(range(LIMIT))


async def test_a_write_on_the_loop_overtakes_those_that_wait() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.inp)
        at_once(lambda: source.out.write_from_thread(long(1)))
        source.out.write_nowait(long(2))
        assert [(await sink.inp.read()).data, (await sink.inp.read()).data] == [2, 1]


async def test_a_reading_task_and_an_event_context_wake() -> None:
    class Doer(Component):
        inp = InPort(TimedLong)

        def __init__(self) -> None:
            super().__init__()
            self.seen: list[int] = []

        def on_execute(self) -> None:
            self.seen += data(self.inp.drain())

    async with Kernel() as kernel:
        source, sink, doer = Source("source"), Sink("sink"), Doer()
        for one in (source, sink, doer):
            await kernel.add(one)
        await kernel.connect(source.out, sink.inp)
        await kernel.connect(source.out, doer.inp)
        await kernel.start(EventContext(), doer, activate=True)
        reading = asyncio.ensure_future(sink.inp.read())
        await asyncio.sleep(0)
        assert await joined(lambda: source.out.write_from_thread(long(7))) == []
        assert (await asyncio.wait_for(reading, 20)).data == 7
        await turns(lambda: doer.seen == [7])


async def test_a_reader_without_room_holds_the_rest_and_each_waits_its_time() -> None:
    async with Kernel() as kernel:
        source, slow, other = Source("source"), Sink("slow"), Sink("other")
        for one in (source, slow, other):
            await kernel.add(one)
        connector = await kernel.connect(source.out, slow.inp, length=2, full="block", timeout=0.01)
        await kernel.connect(source.out, other.inp, length=8)
        at_once(lambda: [source.out.write_from_thread(long(n)) for n in range(4)])
        await turns(lambda: connector.statistics.written == 2)
        assert counts(source.out) == (4, 2, 2, {}, 0)
        assert data(other.inp.drain()) == [0, 1, 2]
        while counts(source.out)[2]:
            await asyncio.sleep(0.005)
        assert counts(source.out) == (4, 2, 0, {"timeout": 2}, 0)
        assert connector.statistics.dropped == {"timeout": 2}
        assert data(slow.inp.drain()) == [0, 1]
        assert data(other.inp.drain()) == [3]


@pytest.mark.parametrize("debug", [False, True])
async def test_room_that_is_made_lets_the_rest_in(debug: bool) -> None:
    async with Kernel(debug=debug) as kernel:
        source, slow = await kernel.add(Source("source")), await kernel.add(Sink("slow"))
        connector = await kernel.connect(source.out, slow.inp, length=1, full="block", timeout=None)
        at_once(lambda: [source.out.write_from_thread(long(n)) for n in range(50)])
        assert [(await asyncio.wait_for(slow.inp.read(), 20)).data for _ in range(50)] == list(range(50))
        await turns(lambda: counts(source.out) == (50, 50, 0, {}, 0))
        assert connector.statistics.delivered == 50


@pytest.mark.slow
async def test_a_thread_blocks_while_1024_wait() -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.inp, length=10_000)
        reached = threading.Event()

        def write() -> None:
            for n in range(LIMIT):
                source.out.write_from_thread(long(n), full="block")
            reached.set()
            for n in range(LIMIT, 3 * LIMIT):
                assert source.out.write_from_thread(long(n), full="block")

        made, raised = threads(write)
        assert reached.wait(20)
        made[0].join(0.05)
        assert made[0].is_alive()
        assert counts(source.out) == (LIMIT, 0, LIMIT, {}, 0)
        await asyncio.to_thread(made[0].join, 20)
        assert raised == []
        await turns(lambda: counts(source.out) == (3 * LIMIT, 3 * LIMIT, 0, {}, 0))
        assert data(sink.inp.drain()) == list(range(3 * LIMIT))


@pytest.mark.parametrize("end", ["kernel", "component", "port"])
async def test_what_waits_is_dropped_as_closed_and_a_thread_that_blocks_gets_a_closed_error(end: str) -> None:
    async with Kernel() as kernel:
        source = await kernel.add(Source("source"))
        out = source.add_port("more", OutPort(TimedLong)) if end == "port" else source.out
        at_once(lambda: [out.write_from_thread(long(n)) for n in range(LIMIT)])
        made, raised = threads(lambda: out.write_from_thread(long(0), full="block"))
        made[0].join(0.05)
        assert made[0].is_alive()
        if end == "kernel":
            closing = asyncio.ensure_future(kernel.aclose())
        elif end == "component":
            closing = asyncio.ensure_future(kernel.remove(source))
        else:
            source.remove_port("more")
            closing = asyncio.ensure_future(asyncio.sleep(0))
        await asyncio.to_thread(made[0].join, 20)
        await closing
        assert [type(error) for error in raised] == [ClosedError]
        accepted, written, waiting, dropped, refused = counts(out)
        assert (accepted, waiting, refused) == (LIMIT, 0, 0)
        assert written + dropped["closed"] == LIMIT
        with pytest.raises(ClosedError, match="clos"):
            at_once(lambda: out.write_from_thread(long(0)))
        assert counts(out)[0] == LIMIT


async def test_a_thread_that_blocks_goes_on_once_there_is_room_though_a_reader_holds_the_rest() -> None:
    async with Kernel() as kernel:
        source, slow = await kernel.add(Source("source")), await kernel.add(Sink("slow"))
        await kernel.connect(source.out, slow.inp, length=2, full="block", timeout=None)
        at_once(lambda: [source.out.write_from_thread(long(n)) for n in range(LIMIT)])
        made, raised = threads(lambda: [source.out.write_from_thread(long(n), full="block") for n in range(2)])
        await asyncio.to_thread(made[0].join, 20)
        assert not made[0].is_alive()
        assert raised == []
        assert counts(source.out) == (LIMIT + 2, 2, LIMIT, {}, 0)
        assert not source.out.write_from_thread(long(0))


async def test_a_component_that_is_being_removed_accepts_nothing_more() -> None:
    class Camera(Source):
        async def on_finalize(self) -> None:
            raised.extend(await joined(lambda: self.out.write_from_thread(long(2))))

    raised: list[BaseException] = []
    async with Kernel() as kernel:
        camera = await kernel.add(Camera())
        at_once(lambda: camera.out.write_from_thread(long(1)))
        await kernel.remove(camera)
        assert [type(error) for error in raised] == [ClosedError]
        assert counts(camera.out) == (1, 0, 0, {"closed": 1}, 0)


async def test_a_sample_that_waits_for_room_when_the_kernel_closes_is_in_one_ledger_as_in_the_other() -> None:
    async with Kernel() as kernel:
        source, slow = await kernel.add(Source("source")), await kernel.add(Sink("slow"))
        connector = await kernel.connect(source.out, slow.inp, length=1, full="block", timeout=None)
        at_once(lambda: [source.out.write_from_thread(long(n)) for n in range(10)])
        await turns(lambda: connector.statistics.written == 1)
        assert counts(source.out) == (10, 1, 9, {}, 0)
    await turns(lambda: counts(source.out) == (10, 2, 0, {"closed": 8}, 0))
    assert connector.statistics.written == 2
    assert connector.statistics.dropped == {"disconnected": 2}


async def test_the_sample_is_checked_in_the_thread() -> None:
    class Shaped(Component):
        out = OutPort(TimedDoubleSeq)

    class Reader(Component):
        inp = InPort(TimedDoubleSeq, shape=(3,))

    async with Kernel() as kernel:
        source, shaped, reader = Source("source"), Shaped("shaped"), Reader("reader")
        for one in (source, shaped, reader):
            await kernel.add(one)
        await kernel.connect(shaped.out, reader.inp)
        bad: Any = "text"
        with pytest.raises(PortTypeError, match=r"source\.out: expected a TimedLong, got str"):
            at_once(lambda: source.out.write_from_thread(bad))
        with pytest.raises(PortTypeError, match=r"the shape of reader\.inp"):
            at_once(lambda: shaped.out.write_from_thread(TimedDoubleSeq(0, [1.0])))
        assert counts(source.out) == counts(shaped.out) == (0, 0, 0, {}, 0)


async def test_a_mutable_sample_is_copied_and_a_port_that_stamps_stamps_in_the_thread() -> None:
    @dataclass
    class Reading:
        tm: int
        values: list[int]

    class Camera(Component):
        out = OutPort(Reading, stamp="write")

    class Viewer(Component):
        inp = InPort(Reading)

    async with Kernel() as kernel:
        camera, viewer = await kernel.add(Camera()), await kernel.add(Viewer())
        await kernel.connect(camera.out, viewer.inp)
        sample = Reading(0, [1, 2])
        before = kernel.clock.time_ns()
        at_once(lambda: camera.out.write_from_thread(sample))
        after = kernel.clock.time_ns()
        sample.values.append(3)
        read = await viewer.inp.read()
        assert list(read.values) == [1, 2]
        assert before <= read.tm <= after


@pytest.mark.slow
async def test_wrong_uses_are_refused_with_what_to_do() -> None:
    async with Kernel() as kernel:
        source, fast = await kernel.add(Source("source")), await kernel.add(Source("fast"))
        with pytest.raises(ThreadError, match=r"source\.out: .*would block the event loop; await write\(\) here"):
            source.out.write_from_thread(long(1), full="block")
        word: Any = "overwrite"
        with pytest.raises(ConfigurationError, match=r"""full = 'overwrite': expected "reject" or "block\""""):
            source.out.write_from_thread(long(1), full=word)
        with pytest.raises(ClosedError, match="was super"):
            Source.out.write_from_thread(long(1))
        with pytest.raises(ClosedError, match="is in no kernel yet, or closing"):
            Source("alone").out.write_from_thread(long(1))
        for context in (RealtimeContext(100.0), ThreadContext(100.0)):
            await kernel.start(context, fast)
            with pytest.raises(
                StateError, match=r"fast\.out: .*in a thread, which alone writes here; add it to a context on"
            ):
                at_once(lambda: fast.out.write_from_thread(long(1)))
            await kernel.stop(context)
        at_once(lambda: source.out.write_from_thread(long(1)))
        asked: list[BaseException] = await joined(lambda: source.out.thread_writes)
        assert [type(error) for error in asked] == [ThreadError]
        assert source.out.write_from_thread(long(2)) is True  # on the loop, it is one thread of many


@pytest.mark.slow
@pytest.mark.parametrize("full", ["reject", "block"])
@pytest.mark.parametrize("often", [False, True])
async def test_eight_threads_lose_nothing_uncounted_and_each_keeps_its_order(full: Any, often: bool) -> None:
    written, each = 8, 1250  # 10^4

    await _eight(full, often, written, each)


@pytest.mark.timeout(time_limit(600))
@pytest.mark.skipif(not CAMPAIGN, reason="a long one; AIORTS_CAMPAIGN=1")
@pytest.mark.parametrize("full", ["reject", "block"])
async def test_a_million_writes_of_eight_threads_are_counted(full: Any) -> None:
    await _eight(full, False, 8, 125_000)


async def _eight(full: Any, often: bool, writers: int, each: int) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        connector = await kernel.connect(source.out, sink.inp, length=300, full="block", timeout=None)
        accepted: list[list[int]] = [[] for _ in range(writers)]

        def write(writer: int) -> None:
            for number in range(each):
                if source.out.write_from_thread(TimedLong(writer, number), full=full):
                    accepted[writer].append(number)

        seen: list[list[int]] = [[] for _ in range(writers)]

        async def read() -> None:
            while True:
                sample = await sink.inp.read()
                seen[sample.tm].append(sample.data)
                now = source.out.thread_writes
                assert now.accepted == now.written + now.waiting

        reading = asyncio.ensure_future(read())
        with switching_often() if often else contextmanager(lambda: iter((None,)))():
            assert await joined(*(lambda writer=writer: write(writer) for writer in range(writers))) == []  # type: ignore[misc]
        total = sum(map(len, accepted))
        while not reading.done() and sum(map(len, seen)) < total:
            await asyncio.sleep(0.001)
        reading.cancel()
        assert seen == accepted
        assert counts(source.out) == (total, total, 0, {}, writers * each - total)
        assert connector.statistics.delivered == total
        if full == "block":
            assert total == writers * each


class Neighbour(Component):
    """Notes when it ran."""

    def __init__(self) -> None:
        super().__init__()
        self.ran: list[float] = []

    def on_execute(self) -> None:
        self.ran.append(time.perf_counter())


class Taker(Component):
    """Takes all that came."""

    inp = InPort(TimedLong, length=4 * LIMIT)

    def __init__(self) -> None:
        super().__init__()
        self.seen = [0] * 8

    def on_execute(self) -> None:
        for sample in self.inp.drain():
            assert sample.data == self.seen[sample.tm]
            self.seen[sample.tm] += 1


async def p99_beside(each: int, *, writes: bool) -> float:
    """How far the 99th percentile of a 100 Hz neighbour's cycles is off its period, beside eight threads."""
    async with Kernel() as kernel:
        source, taker, neighbour = Source("source"), Taker(), Neighbour()
        for one in (source, taker, neighbour):
            await kernel.add(one)
        await kernel.connect(source.out, taker.inp, full="block", timeout=None)
        await kernel.start(PeriodicContext(100.0), neighbour, activate=True)
        await kernel.start(EventContext(), taker, activate=True)

        def work(writer: int) -> None:
            for number in range(each):
                sample = TimedLong(writer, number)
                if writes:
                    source.out.write_from_thread(sample, full="block")

        assert await joined(*(partial(work, writer) for writer in range(8))) == []
        total = 8 * each if writes else 0
        while sum(taker.seen) < total:
            await asyncio.sleep(0.01)
        assert counts(source.out) == (total, total, 0, {}, 0)
        off = sorted(abs(after - before - 0.01) for before, after in pairwise(neighbour.ran))
        return off[len(off) * 99 // 100]


@pytest.mark.timeout(time_limit(600))
@pytest.mark.skipif(not CAMPAIGN, reason="a long one; AIORTS_CAMPAIGN=1")
async def test_a_neighbour_keeps_its_times_beside_a_million_writes_as_beside_threads_that_only_compute() -> None:
    # Threads that compute take the interpreter from the loop, whatever they do with the result.
    computing = await p99_beside(3_000_000 // 8, writes=False)
    writing = await p99_beside(1_000_000 // 8, writes=True)
    print(f"p99 off the period: {writing * 1000:.1f} ms writing, {computing * 1000:.1f} ms computing")
    assert writing <= 2 * computing


@pytest.mark.slow
@pytest.mark.parametrize("full", ["overwrite", "block"])
def test_whatever_happens_in_whatever_order_every_sample_is_read_or_counted_once(full: str) -> None:
    for seed in range(cases(1000)):
        simulate(partial(_anything, seed=seed, full=full), seed=seed)


async def _anything(clock: SimulatedClock, *, seed: int, full: str) -> None:
    choice = random.Random(seed)
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        options: dict[str, Any] = {"timeout": choice.choice([None, 1.0])} if full == "block" else {}
        length = choice.choice([1, 3, 2000])
        connector = await kernel.connect(source.out, sink.inp, length=length, full=full, **options)
        number = accepted = refused = 0
        read: list[int] = []
        connectors = [connector]
        for _ in range(choice.randrange(1, 30)):
            match choice.randrange(6):
                case 0 | 1:
                    for _ in range(choice.choice([1, 5, 300, 1200])):
                        if source.out.write_from_thread(long(number)):
                            accepted += 1
                        else:
                            assert source.out.thread_writes.waiting == LIMIT
                            refused += 1
                        number += 1
                case 2:
                    await asyncio.sleep(choice.choice([0, 0, 0.4, 1.0, 10.0]))
                case 3:
                    read += data(sink.inp.drain())
                case 4:
                    with contextlib.suppress(ReadTimeout):
                        read.append((await sink.inp.read(timeout=choice.choice([0, 0.3]))).data)
                case 5:
                    await kernel.disconnect(connectors[-1])
                    connectors.append(await kernel.connect(source.out, sink.inp, length=length, full=full, **options))
            now = source.out.thread_writes
            assert (now.accepted, now.refused) == (accepted, refused)
            assert now.accepted == now.written + now.waiting + sum(now.dropped.values())
            assert now.waiting <= LIMIT
    now = source.out.thread_writes
    if now.waiting:
        await asyncio.sleep(0)
        now = source.out.thread_writes
    assert (now.accepted, now.waiting) == (accepted, 0)
    assert accepted == now.written + sum(now.dropped.values())
    ledgers = [one.statistics for one in connectors]
    assert all(one.balanced for one in ledgers)
    assert sum(one.delivered for one in ledgers) == len(read)
    assert sum(one.written for one in ledgers) == now.written + now.dropped.get("timeout", 0)
    assert read == sorted(set(read))
