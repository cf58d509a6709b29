"""Who made a context late: every missed deadline names the component, hook and source line that held the loop."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from aiorts import Blame, Component, Context, EventContext, Kernel, PeriodicContext, SimulatedClock, ThreadContext
from aiorts.events import Overrun
from aiorts.kernel.loop import timers
from aiorts.testing import simulate
from contexts.parts import MS, Idle, Ticker

HERE = Path(__file__)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="nobody looks without a timerfd")


def line_of(mark: str) -> int:
    """The line of this file that ends in `# mark`."""
    lines = HERE.read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if line.endswith(f"# {mark}"))


class Busy(Component):
    """Each third execution takes long, in a function it calls."""

    def __init__(self, name: str = "", work: Callable[[], object] | None = None) -> None:
        super().__init__(name)
        self.work = work
        self.runs = 0

    def on_execute(self) -> None:
        self.runs += 1
        if self.runs % 3 == 0:
            self.grab()

    def grab(self) -> None:
        if self.work is not None:
            self.work()  # grab
        else:
            time.sleep(0.03)  # sleeps


async def held_by(
    kernel: Kernel, who: str, begin: Callable[[], object] = lambda: None, again: Callable[[], object] = lambda: None
) -> tuple[Blame, Context]:
    """The blame of one who disturbs a context of 200 Hz, and the context.

    On a busy machine the machine is to blame for much: they are given some seconds to be caught.
    """
    seen: list[Blame] = []
    ticker = await kernel.add(Ticker("ticker"))
    context = await kernel.start(PeriodicContext(200.0, name="loop"), ticker, activate=True)
    kernel.bus.subscribe(Overrun, lambda event: seen.append(event.blame) if event.context == "loop" else None)
    await asyncio.sleep(0.05)
    result = begin()
    if asyncio.iscoroutine(result):
        await result
    for _ in range(40):
        again()
        await asyncio.sleep(0.2)
        blames = [blame for blame in seen if who in (blame.component, blame.function, blame.kind)]
        if blames:
            return max(blames, key=lambda blame: blame.held_ns), context
    pytest.fail(f"{who} was never blamed, but {sorted(set(map(str, seen)))}")


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
@pytest.mark.row(202)
async def test_a_neighbour_that_sleeps_is_named_with_component_hook_and_line() -> None:
    async with Kernel() as kernel:
        busy = await kernel.add(Busy("camera0"))
        start = lambda: kernel.start(PeriodicContext(50.0), busy, activate=True)  # noqa: E731
        blame, context = await held_by(kernel, "camera0", start)
        line = line_of("sleeps")
        assert (blame.kind, blame.component, blame.hook) == ("loop", "camera0", "on_execute")
        assert (blame.file, blame.line, blame.function) == (str(HERE), line, "grab")
        assert 20 * MS < blame.held_ns < 5000 * MS
        place = f"camera0.on_execute (test_blame.py:{line} in grab)"
        assert str(blame).startswith(f"{place} held the loop for ")
        assert str(blame).endswith(" ms")
        statistics = context.statistics
        assert statistics.policy == "skip"
        assert statistics.missed[place] >= 1
        assert sum(statistics.missed.values()) == statistics.overruns
        assert statistics.last_blame is not None


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_call_that_holds_the_interpreter_lock_is_named() -> None:
    async with Kernel() as kernel:
        busy = await kernel.add(Busy("adder", lambda: sum(range(4_000_000))))
        blame, _ = await held_by(kernel, "adder", lambda: kernel.start(PeriodicContext(50.0), busy, activate=True))
        assert (blame.component, blame.hook) == ("adder", "on_execute")
        assert blame.file == str(HERE)
        assert blame.held_ns > 5 * MS


@pytest.mark.slow(kept_by="test_the_hook_of_a_thread_context_is_named_and_the_loop_is_not")
@pytest.mark.anyio
async def test_an_event_context_whose_times_nobody_takes_is_named() -> None:
    async with Kernel() as kernel:
        busy = await kernel.add(Busy("listener"))
        events = await kernel.start(EventContext(), busy, activate=True)

        blame, _ = await held_by(kernel, "listener", again=events.trigger)
        assert (blame.component, blame.hook, blame.line) == ("listener", "on_execute", line_of("sleeps"))


@pytest.mark.slow
@pytest.mark.anyio
async def test_code_of_the_application_is_named_by_function_and_line() -> None:
    def poll_the_disk() -> None:
        time.sleep(0.03)  # polls

    async with Kernel() as kernel:
        loop = asyncio.get_running_loop()
        blame, _ = await held_by(kernel, "poll_the_disk", again=lambda: loop.call_soon(poll_the_disk))
        assert (blame.kind, blame.component, blame.hook) == ("loop", "", "")
        assert (blame.function, blame.line, blame.file) == ("poll_the_disk", line_of("polls"), str(HERE))
        assert blame.place == f"poll_the_disk (test_blame.py:{line_of('polls')})"


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_task_of_a_component_is_named_with_its_component() -> None:
    class Starter(Component):
        async def on_activated(self) -> None:
            self.task = asyncio.ensure_future(self.worker())

        async def worker(self) -> None:
            while True:
                await asyncio.sleep(0.1)
                time.sleep(0.03)  # works

        def on_deactivated(self) -> None:
            self.task.cancel()

    async with Kernel() as kernel:
        starter = await kernel.add(Starter("starter"))
        blame, _ = await held_by(kernel, "starter", lambda: kernel.start(EventContext(), starter, activate=True))
        assert (blame.kind, blame.component, blame.hook) == ("loop", "starter", "")
        assert (blame.line, blame.function) == (line_of("works"), "worker")
        assert "starter, in a task of its own (test_blame.py:" in str(blame)


@pytest.mark.slow(kept_by="test_a_neighbour_that_sleeps_is_named_with_component_hook_and_line")
@pytest.mark.anyio
async def test_a_hook_of_its_own_that_waits_too_long_is_named_where_it_waits() -> None:
    class Waiter(Component):
        async def on_execute(self) -> None:
            await self.exchange()

        async def exchange(self) -> None:
            await asyncio.sleep(0.05)  # waits

    async with Kernel() as kernel:
        waiter = await kernel.add(Waiter("waiter"))
        context = await kernel.start(PeriodicContext(100.0), waiter, activate=True)
        await asyncio.sleep(0.3)
        missed = context.statistics.missed
    assert max(missed, key=lambda place: missed[place]) == (
        f"waiter.on_execute (test_blame.py:{line_of('waits')} in exchange)"
    )
    blame = context.statistics.last_blame
    assert blame is not None
    assert (blame.kind, blame.held) == ("hook", "its context")


@pytest.mark.anyio
async def test_the_hook_of_a_thread_context_is_named_and_the_loop_is_not() -> None:
    async with Kernel() as kernel:
        busy = await kernel.add(Busy("serial"))
        context = await kernel.start(ThreadContext(200.0), busy, activate=True)
        await asyncio.sleep(0.2)
        blames = context.statistics.missed
        assert f"serial.on_execute (test_blame.py:{line_of('sleeps')} in grab)" in blames


@pytest.mark.slow(kept_by="test_a_neighbour_that_sleeps_is_named_with_component_hook_and_line")
@pytest.mark.anyio
async def test_without_a_timerfd_component_and_hook_are_named_with_the_line_the_hook_begins_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(timers, "find_timerfd", lambda: None)
    async with Kernel() as kernel:
        busy = await kernel.add(Busy("camera0"))
        blame, _ = await held_by(kernel, "camera0", lambda: kernel.start(PeriodicContext(50.0), busy, activate=True))
        assert not [thread for thread in threading.enumerate() if thread.name == "aiorts monitor"]
    assert (blame.component, blame.hook, blame.function) == ("camera0", "on_execute", "on_execute")
    assert blame.line == Busy.on_execute.__code__.co_firstlineno


@pytest.mark.slow
@pytest.mark.anyio
@pytest.mark.fault("C07")
async def test_a_garbage_collection_is_named_and_counted() -> None:
    heap = [[number] for number in range(600_000)]
    async with Kernel() as kernel:
        blame, _ = await held_by(kernel, "gc", again=gc.collect)
        pauses = kernel.gc_pauses[2]
    assert blame.generation == 2
    assert str(blame).startswith("garbage collection of generation 2 held the loop for ")
    assert pauses.count >= 1
    assert pauses.max_ns >= 2 * MS
    assert pauses.total_ns >= pauses.max_ns >= pauses.last_ns > 0
    assert len(heap) == 600_000


STOPPED = """
import asyncio, sys
from aiorts import Component, Kernel, PeriodicContext
from aiorts.events import Overrun
class Tick(Component):
    async def on_execute(self): pass
async def main():
    async with Kernel() as kernel:
        seen = []
        kernel.bus.subscribe(Overrun, seen.append)
        await kernel.start(PeriodicContext(100.0), await kernel.add(Tick("t")), activate=True)
        await asyncio.sleep(0.2)
        print("ready", flush=True)
        await asyncio.sleep(1.0)
        worst = max(seen, key=lambda event: event.late_ns)
        print(worst.blame.kind, worst.blame.held_ns // 10**6)
asyncio.run(main())
"""


@pytest.mark.slow(kept_by="diagnostics/test_blame_judge.py::test_a_cycle_40_ms_late_is_blamed_on")
def test_a_process_that_was_stopped_blames_the_machine() -> None:
    with subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.4)
        os.kill(process.pid, signal.SIGCONT)
        kind, held = process.stdout.readline().split()
    assert kind == "machine"
    assert int(held) >= 200


def test_in_virtual_time_the_books_are_judged_alike_every_time_and_nobody_watches() -> None:
    async def main(clock: SimulatedClock) -> list[str]:
        texts: list[str] = []
        takes = iter([0.0, 0.035] + [0.0] * 100)
        async with Kernel() as kernel:
            kernel.bus.subscribe(Overrun, lambda event: texts.append(f"{event.policy} {event.blame}"))
            ticker = await kernel.add(Ticker("ticker", lambda: next(takes)))
            context = await kernel.start(PeriodicContext(100.0, overrun="catch_up"), ticker, activate=True)
            await asyncio.sleep(0.2)
            assert context.statistics.policy == "catch_up"
            assert not gc.callbacks or all("Pauses" not in repr(one) for one in gc.callbacks)
            assert all(thread.name != "aiorts monitor" for thread in threading.enumerate())
        return texts

    texts = simulate(main)
    line = Ticker.on_execute.__code__.co_firstlineno
    # What was missed before the hook returned is made up for; it is all the same hook's doing.
    assert texts == [f"catch_up ticker.on_execute (parts.py:{line}) held its context for 35 ms"] * len(texts)
    assert len(texts) == 3
    assert simulate(main) == texts


def test_a_hook_that_was_slow_long_ago_is_not_blamed_for_as_long_again() -> None:
    async def main(clock: SimulatedClock) -> list[int]:
        held: list[int] = []
        takes = iter([0.0, 0.055, *[0.0] * 10, 0.035, *[0.0] * 100])
        async with Kernel() as kernel:
            kernel.bus.subscribe(Overrun, lambda event: held.append(event.blame.held_ns // MS))
            ticker = await kernel.add(Ticker("ticker", lambda: next(takes)))
            await kernel.start(PeriodicContext(100.0), ticker, activate=True)
            await asyncio.sleep(0.3)
        return held

    assert simulate(main) == [55, 35]


def test_a_blame_is_logged_once_for_its_place_and_as_information(caplog: pytest.LogCaptureFixture) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            ticker = await kernel.add(Ticker("ticker", 0.035))
            await kernel.start(PeriodicContext(100.0, name="loop"), ticker, activate=True)
            await asyncio.sleep(4.0)

    with caplog.at_level("INFO", "aiorts.kernel"):
        simulate(main)
    lines = [record for record in caplog.records if "missed" in record.getMessage()]
    assert [record.levelname for record in lines] == ["INFO"]
    assert lines[0].getMessage().startswith("loop: 1 deadline missed: ticker.on_execute (parts.py:")


@pytest.mark.anyio
async def test_nothing_of_the_watching_is_left_when_the_last_context_has_stopped() -> None:
    def watchers() -> int:
        return sum(thread.name == "aiorts monitor" for thread in threading.enumerate())

    callbacks = list(gc.callbacks)
    async with Kernel("one") as one, Kernel("two") as two:
        assert watchers() == 0
        first = await one.start(PeriodicContext(100.0), await one.add(Idle("a")), activate=True)
        second = await two.start(PeriodicContext(100.0), await two.add(Idle("b")), activate=True)
        assert watchers() == 1
        assert len(gc.callbacks) == len(callbacks) + 2
        await first.stop()
        assert watchers() == 1
        assert len(gc.callbacks) == len(callbacks) + 1
        await second.stop()
        assert watchers() == 0
        assert gc.callbacks == callbacks
        await one.start(first)  # again
        assert watchers() == 1
    assert watchers() == 0
    assert gc.callbacks == callbacks


FORKING = """
import asyncio, os, sys, warnings
from aiorts import Component, Kernel, PeriodicContext
def is_open(fd):
    return os.path.lexists(f"/proc/self/fd/{fd}")
class Tick(Component):
    async def on_execute(self): pass
async def main():
    async with Kernel() as kernel:
        context = await kernel.start(PeriodicContext(200.0), await kernel.add(Tick("t")), activate=True)
        await asyncio.sleep(0.05)
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
        if child == 0:
            context._deadline_timer.arm(2**61)
            # The one that is left is the loop's own.
            kept = sum("timerfd" in os.readlink(f"/proc/self/fd/{fd}") for fd in range(64) if is_open(fd))
            os._exit(10 if kept == 1 and context._deadline_timer._timer is None else 11)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        before = context.ticks
        await asyncio.sleep(0.1)
        assert context.ticks > before
        import time
        time.sleep(0.05)
        await asyncio.sleep(0.05)
        print(status, any(place.startswith("main (") for place in context.statistics.missed))
asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_nothing_of_the_watching_is_left_when_the_last_context_has_stopped")
def test_the_child_of_a_fork_has_no_part_in_the_watching() -> None:
    done = subprocess.run([sys.executable, "-c", FORKING], capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stdout) == (0, "10 True\n"), done.stderr


LEAVING = """
import asyncio, threading
from aiorts import Component, Kernel, PeriodicContext
class Tick(Component):
    async def on_execute(self): pass
async def main():
    kernel = await Kernel().open()
    await kernel.start(PeriodicContext(1000.0), await kernel.add(Tick("t")), activate=True)
    await asyncio.sleep(0.02)
    assert any(thread.name == "aiorts monitor" for thread in threading.enumerate())
loop = asyncio.new_event_loop()
loop.run_until_complete(main())
import os
print("left", flush=True)
"""


@pytest.mark.slow
@pytest.mark.fault("G11")
def test_an_interpreter_that_ends_with_the_watcher_alive_does_not_hang() -> None:
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", LEAVING], capture_output=True, text=True, timeout=10, check=False)
        assert (done.returncode, done.stdout) == (0, "left\n"), done.stderr
        assert "Fatal" not in done.stderr
