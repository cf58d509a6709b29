"""A component is moved between contexts, threads and processes while it runs: nothing is lost, and it goes on."""

from __future__ import annotations

import asyncio
import os
import time
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from anyio import fail_after, sleep

from aiorts import (
    EventContext,
    ExternalContext,
    Kernel,
    LifecycleState,
    PeriodicContext,
    RealtimeContext,
    ThreadContext,
)
from aiorts.errors import ComponentError, DeclarationError, StateError
from aiorts.supervision import Supervision
from aiorts.testing import simulate
from aiorts.types import Point2D, TimedLong
from isolation.isolated_parts import Door, Lamp
from isolation.moved_parts import Careful, Clockwork, Closed, Controller, Counter, Echo, Feed, Heavy, Holder, Log, Seen
from isolation.test_isolated import until

pytestmark = pytest.mark.anyio
ACTIVE = LifecycleState.ACTIVE


async def controlled(kernel: Kernel) -> tuple[Feed, Any, Log, Log, PeriodicContext]:
    """feed -> controller -> log, at 100 Hz."""
    feed, log, places = await kernel.add(Feed("feed")), await kernel.add(Log("log")), await kernel.add(Log("places"))
    controller = await kernel.create(Controller, "ctrl", gain=2)
    await kernel.connect(feed.out, controller.inp, length=100_000)
    await kernel.connect(controller.out, log.inp, length=100_000)
    await kernel.connect(controller.where, places.inp, length=100_000)
    context = await kernel.start(PeriodicContext(100, name="loop"), controller, activate=True)
    return feed, controller, log, places, context


class Input:
    """Writes 1, 2, 3 ... at 1 kHz until it is ended."""

    def __init__(self, feed: Feed) -> None:
        self._feed, self.written = feed, 0
        self._task = asyncio.ensure_future(self._write())

    async def _write(self) -> None:
        began = time.monotonic()
        while True:
            while self.written < (time.monotonic() - began) * 1000:
                self.written += 1
                self._feed.out.write_nowait(TimedLong(0, self.written))
            await asyncio.sleep(0.001)

    def end(self) -> None:
        self._task.cancel()


async def check_all_came(log: Log, written: int, gain: int = 2) -> None:
    """All samples are in the log, in order, each passed on once."""
    found: list[TimedLong] = []
    with fail_after(20):
        while len(found) < written:
            found += log.inp.drain()
            await sleep(0.01)
    assert [(one.tm, one.data) for one in found] == [(one, gain * one) for one in range(1, written + 1)]


@pytest.mark.slow
async def test_into_a_process_and_back_with_its_state_and_all_samples(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        feed, ctrl, log, _places, context = await controlled(kernel)
        names = list(kernel.connectors)
        source = Input(feed)
        await sleep(0.2)
        with fail_after(30):
            there = await kernel.move(ctrl, "process")
        assert (there.pid != os.getpid(), there.state, list(kernel.connectors)) == (True, ACTIVE, names)
        assert kernel.components["ctrl"] is there
        for use in (lambda: ctrl.state, lambda: ctrl.out.write_nowait(TimedLong(0, 0))):
            with pytest.raises(StateError, match=r"ctrl: this handle is not valid .*, <Controller ctrl"):
                use()
        with pytest.raises(StateError, match="this handle is not valid"):
            await kernel.remove(ctrl)
        await sleep(0.3)
        with fail_after(30):
            back = await kernel.move(there, context)
        with pytest.raises(StateError, match=r"ctrl: this handle is not valid"):
            _ = there.state
        await sleep(0.2)
        source.end()
        written = source.written
        await until(lambda: back.count == written)
        assert (type(back), back.gain, list(kernel.connectors)) == (Controller, 2, names)
        assert (list(back.window), back.window.maxlen) == (list(range(written - 4, written + 1)), 5)
        assert [one.getMessage() for one in caplog.records] == []
        assert (back.last, back.integral[0]) == (Seen(written, Point2D(written, 0.0)), written * (written + 1) / 2)
        await check_all_came(log, written)


@pytest.mark.slow
async def test_a_controller_goes_through_all_places_under_1_khz_and_loses_nothing() -> None:
    async with Kernel() as kernel:
        feed, ctrl, log, places, loop_context = await controlled(kernel)
        source = Input(feed)
        stops: list[tuple[str, Any]] = [
            ("thread", ThreadContext(100, name="thread")),
            ("real-time", RealtimeContext(100, name="hard")),
            ("process", "process"),
            ("thread", ThreadContext(100, name="thread2")),
            ("loop", loop_context),
        ]
        moves: list[tuple[str, int, int]] = []
        for name, to in stops:
            await sleep(0.2)
            began = time.monotonic_ns()
            with fail_after(30):
                ctrl = await kernel.move(ctrl, to)
            moves.append((name, began, time.monotonic_ns()))
            assert ctrl.state is ACTIVE
        await sleep(0.2)
        source.end()
        written = source.written
        await until(lambda: ctrl.count == written)
        cycles = places.inp.drain()
        assert len({one.data for one in cycles}) == 2
        for name, began, ended in moves:
            times = [one.tm for one in cycles if began - 20_000_000 < one.tm < ended + 20_000_000]
            gap = max(later - earlier for earlier, later in pairwise(times))
            print(f"to {name}: {(ended - began) / 1e6:.0f} ms, of which without a cycle {gap / 1e6:.1f} ms")
        assert ctrl.integral[0] == written * (written + 1) / 2
        await check_all_came(log, written)


@pytest.mark.slow
async def test_between_neighbours_in_threads_it_moves_and_loses_nothing() -> None:
    async with Kernel() as kernel:
        clockwork, log = await kernel.add(Clockwork("clockwork")), await kernel.add(Log("log"))
        last = await kernel.create(Controller, "last", gain=1)
        mid: Any = await kernel.create(Controller, "mid", gain=2)
        for out, inp in ((clockwork.out, mid.inp), (mid.out, last.inp), (last.out, log.inp)):
            await kernel.connect(out, inp, length=100_000)
        context = await kernel.start(PeriodicContext(100, name="loop"), mid, activate=True)
        await kernel.start(ThreadContext(100, name="after"), last, activate=True)
        before = await kernel.start(ThreadContext(200, name="before"), clockwork, activate=True)
        for place in ("process", context, "process", ThreadContext(100, name="thread")):
            await sleep(0.2)
            with fail_after(30):
                mid = await kernel.move(mid, place)
        await sleep(0.2)
        await before.deactivate(clockwork)
        written = clockwork.written
        assert written > 200
        await check_all_came(log, written)
        assert (mid.count, mid.integral[0]) == (written, written * (written + 1) / 2)


@pytest.mark.slow
async def test_what_cannot_go_over_is_refused_by_name_and_nothing_is_changed() -> None:
    async with Kernel() as kernel:
        holder, log = await kernel.add(Holder("holder")), await kernel.add(Log("log"))
        context = await kernel.start(PeriodicContext(100, name="loop"), holder, activate=True)
        with pytest.raises(StateError, match=r"holder.lock: a lock cannot go into another process: plain data"):
            await kernel.move(holder, "process")
        with pytest.raises(StateError, match="holder: is in loop already"):
            await kernel.move(holder, context)
        with pytest.raises(DeclarationError, match='expected a context, or "process"'):
            await kernel.move(holder, "prozess")  # type: ignore[arg-type]
        feed = await kernel.add(Feed("feed"))
        await kernel.connect(feed.out, log.inp)
        await kernel.start(RealtimeContext(100, name="hard"), feed, activate=True)
        with pytest.raises(StateError, match=r"log: feed.out -> log.inp: feed runs in a real-time thread, .* first"):
            await kernel.move(log, "process")
        echo = await kernel.add(Echo("echo"))
        outside = await kernel.start(ExternalContext(name="outside"), echo, activate=True)
        with pytest.raises(StateError, match="echo: outside is ticked by this program"):
            await kernel.move(echo, "process")
        await outside.stop()
        with pytest.raises(StateError, match="on_execute"):
            await kernel.move(echo, ThreadContext(100, name="thread"))
        states = {one.name: dict(one.states) for one in kernel.components.values()}
        assert states == {"holder": {"loop": ACTIVE}, "log": {}, "feed": {"hard": ACTIVE}, "echo": {}}


@pytest.mark.slow
async def test_on_reload_takes_over_what_can_go_over() -> None:
    async with Kernel() as kernel:
        careful = await kernel.add(Careful("careful"))
        careful.count = 7
        with fail_after(30):
            there = await kernel.move(careful, "process")
            back: Any = await kernel.move(there, PeriodicContext(100, name="loop"))
        assert (back.count, back.came, back.lock is None) == (7, os.getpid(), False)


@pytest.mark.slow
async def test_a_state_machine_goes_into_a_process_and_back_and_begins_in_its_initial_state() -> None:
    async with Kernel() as kernel:
        door: Any = await kernel.create(Door, "door")
        run = await kernel.start(EventContext(), door, activate=True)
        lamp = await kernel.create(Lamp, "lamp")
        lit = await kernel.start(PeriodicContext(100, name="lit"), lamp, activate=True)
        door.machine.send("button", {"by": 1})
        await until(lambda: door.machine.configuration == ("open",))
        for place in (("process", "process"), (lit, run)):
            lamp = await kernel.move(lamp, place[0])
            door = await kernel.move(door, place[1])
            assert door.state is ACTIVE
        await until(lambda: door.machine.configuration == ("closed",))
        door.machine.send("button", {"by": 2})
        await until(lambda: door.machine.configuration == ("open",))


async def test_one_that_cannot_start_there_stays_where_it_was() -> None:
    async with Kernel() as kernel:
        closed = await kernel.create(Closed, "closed", home=os.getpid())
        await kernel.start(PeriodicContext(100, name="loop"), closed, activate=True)
        with fail_after(30), pytest.raises(ComponentError, match="not at home"):
            await kernel.move(closed, "process")
        assert (kernel.components["closed"] is closed, dict(closed.states)) == (True, {"loop": ACTIVE})


@pytest.mark.slow
async def test_one_that_runs_on_data_goes_on_and_is_supervised_there() -> None:
    async with Kernel() as kernel:
        feed, log = await kernel.add(Feed("feed")), await kernel.add(Log("log"))
        echo: Any = await kernel.add(Echo("echo"))
        kernel.supervise(echo, Supervision(restart="reset", backoff=0.01))
        await kernel.connect(feed.out, echo.inp, length=1_000)
        await kernel.connect(echo.out, log.inp, length=1_000)
        context = await kernel.start(EventContext(name="data"), echo, activate=True)

        async def echoed(number: int) -> int:
            feed.out.write_nowait(TimedLong(0, number))
            return (await log.inp.read(timeout=10)).data

        assert await echoed(1) == 1
        with fail_after(30):
            there: Any = await kernel.move(echo, "process")
        assert await echoed(2) == 2
        os.kill(there.pid, 9)
        await until(lambda: there.state is LifecycleState.ERROR)
        await until(lambda: there.state is ACTIVE)
        assert await echoed(3) == 3
        with fail_after(30):
            back: Any = await kernel.move(there, context)
        assert await echoed(4) == 4
        assert back.heard == ["activated", "deactivated", "activated"]  # the process was another than before
        feed.out.write_nowait(TimedLong(0, -1))
        await until(lambda: back.state is LifecycleState.ERROR)
        await until(lambda: back.state is ACTIVE)
        assert await echoed(5) == 5


@pytest.mark.slow
async def test_one_that_was_active_is_nowhere_one_that_was_not_active_yet(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        feed, echo = await kernel.add(Feed("feed")), await kernel.add(Echo("echo"))
        await kernel.connect(feed.out, echo.inp, name="wire")
        context = await kernel.start(EventContext(name="loop"), echo, activate=True)
        await context.deactivate(echo)
        with fail_after(30):
            back = await kernel.move(await kernel.move(echo, "process"), context)
        assert back.state is LifecycleState.INACTIVE
        feed.out.write_nowait(TimedLong(0, 1))
        await sleep(0)
        await sleep(0)  # it is said in the turn after the write
        assert kernel.connectors["wire"].statistics.dropped == {"inactive": 1}
    assert [one.getMessage() for one in caplog.records] == []


@pytest.mark.slow
async def test_services_are_answered_and_called_wherever_it_is() -> None:
    async with Kernel() as kernel:
        one: Any = await kernel.add(Counter("one"))
        two: Any = await kernel.add(Counter("two"))
        await kernel.connect(one.other, two.mine)
        await kernel.connect(two.other, one.mine)
        context = await kernel.start(PeriodicContext(100, name="loop"), two, activate=True)
        with fail_after(30):
            assert (await one.other.proxy.add(1), await two.other.proxy.add(5)) == (1, 5)
            two = await kernel.move(two, "process")
            assert await one.other.proxy.add(2) == 3
            two = await kernel.move(two, context)
            assert (await one.other.proxy.add(4), await two.other.proxy.add(5)) == (7, 10)


def test_on_a_simulated_clock_it_stays_in_this_process() -> None:
    async def run() -> None:
        async with Kernel() as kernel:
            echo = await kernel.add(Echo("echo"))
            assert await kernel.move(echo, "process") is echo

    simulate(run())


@pytest.mark.slow
async def test_a_state_of_megabytes_goes_along() -> None:
    async with Kernel() as kernel:
        heavy = await kernel.create(Heavy, "heavy")
        context = await kernel.start(EventContext(), heavy, activate=True)
        heavy.map, heavy.text = np.arange(400_000.0), "x" * 3_000_000
        with fail_after(60):
            back: Any = await kernel.move(await kernel.move(heavy, "process"), context)
        assert (back.map.sum(), len(back.text)) == (np.arange(400_000.0).sum(), 3_000_000)
