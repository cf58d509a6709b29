"""The timer queue of real loops: order, early never, descriptors, other clocks, other loops."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import math
import os
import signal
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

import pytest

from aiorts.clock import ScaledClock, SimulatedClock, SystemClock
from aiorts.kernel.loop import timers
from aiorts.kernel.loop.timers import sleep, sleep_until, timers_for

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.anyio

MS = 1_000_000
CLOCK = SystemClock()
linux = pytest.mark.skipif(sys.platform != "linux", reason="descriptors are counted in /proc")


def timer_descriptors() -> int:
    count = 0
    for name in os.listdir("/proc/self/fd"):
        try:
            count += "timerfd" in os.readlink(f"/proc/self/fd/{name}")
        except OSError:
            continue
    return count


@pytest.fixture(params=["timerfd", "libc", "loop"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Each of the ways to be woken."""
    if request.param == "loop":
        monkeypatch.setattr(timers, "find_timerfd", lambda: None)
    elif sys.platform != "linux":
        pytest.skip("no timerfd on this system")
    elif request.param == "libc":
        libc = timers._LibcTimerfd()
        monkeypatch.setattr(timers, "find_timerfd", lambda: libc)
    return str(request.param)


async def test_timers_fire_in_order_of_deadline_then_creation_and_never_early(way: str) -> None:
    queue, seen, done = timers_for(CLOCK), [], asyncio.Event()
    start = CLOCK.monotonic_ns()

    def note(name: str, deadline: int) -> Callable[[], None]:
        return lambda: seen.append((name, CLOCK.monotonic_ns() >= deadline))

    for name, at in (("d", 6 * MS), ("a", 2 * MS), ("c", 4 * MS), ("b", 2 * MS)):
        queue.call_at(start + at, note(name, start + at))
    queue.call_at(start + 8 * MS, done.set)
    queue.call_at(start + 3 * MS, lambda: seen.append(("never", False))).cancel()
    await asyncio.wait_for(done.wait(), 10)
    assert seen == [("a", True), ("b", True), ("c", True), ("d", True)]


async def test_overdue_timers_fire_at_the_next_turns_in_order(way: str) -> None:
    queue, seen, done = timers_for(CLOCK), [], asyncio.Event()
    for deadline in (-5, 3, 0, 2):
        queue.call_at(deadline, lambda deadline=deadline: seen.append(deadline))  # type: ignore[misc]
    queue.call_at(4, done.set)
    assert seen == [], "never within the call"
    await asyncio.wait_for(done.wait(), 10)
    assert seen == [-5, 0, 2, 3]


async def test_callback_may_add_and_cancel_timers(way: str) -> None:
    queue, seen, done = timers_for(CLOCK), [], asyncio.Event()
    start = CLOCK.monotonic_ns() + MS

    def first() -> None:
        doomed.cancel()
        queue.call_at(start + MS, lambda: (seen.append("added"), done.set()))
        queue.call_at(0, lambda: seen.append("overdue"))

    queue.call_at(start, first)
    doomed = queue.call_at(start, lambda: seen.append("doomed"))
    await asyncio.wait_for(done.wait(), 10)
    assert seen == ["overdue", "added"]


async def test_failing_callback_is_reported_and_the_others_run() -> None:
    queue, reports, done = timers_for(CLOCK), [], asyncio.Event()
    loop = asyncio.get_running_loop()
    before = loop.get_exception_handler()
    loop.set_exception_handler(lambda _, context: reports.append(context["exception"]))
    queue.call_at(1, lambda: 1 // 0)
    queue.call_at(2, done.set)
    await asyncio.wait_for(done.wait(), 10)
    loop.set_exception_handler(before)
    assert [type(report) for report in reports] == [ZeroDivisionError]


@pytest.mark.slow(kept_by="first")
async def test_periods_do_not_drift(way: str) -> None:
    start = CLOCK.monotonic_ns()
    for n in range(1, 101):
        await sleep_until(CLOCK, start + n * MS)
    assert 100 * MS <= CLOCK.monotonic_ns() - start < 1000 * MS


async def test_scaled_and_system_clock_share_one_queue() -> None:
    fast = ScaledClock(1000.0)
    before = CLOCK.monotonic_ns()
    await asyncio.wait_for(asyncio.gather(sleep(fast, 20), sleep(CLOCK, 0.01)), 10)
    assert 20 * MS <= CLOCK.monotonic_ns() - before < 5000 * MS
    assert fast.monotonic_ns() - before >= 20_000 * MS


async def test_timers_of_a_fast_clock_keep_their_order_within_a_real_nanosecond() -> None:
    fast = ScaledClock(1e6)
    queue, seen, done = timers_for(fast), [], asyncio.Event()
    base = fast.monotonic_ns() + 10**12
    for offset in (30, 10, 20):
        queue.call_at(base + offset, lambda offset=offset: seen.append(offset))  # type: ignore[misc]
    queue.call_at(base + 10**7, done.set)
    await asyncio.wait_for(done.wait(), 10)
    assert seen == [10, 20, 30]


@linux
async def test_descriptor_is_one_and_goes_with_the_last_timer_and_user() -> None:
    before = timer_descriptors()
    queue, other = timers_for(CLOCK), timers_for(ScaledClock(2.0))
    queue.acquire()
    other.acquire()
    assert timer_descriptors() == before, "nothing is opened before it is needed"
    await asyncio.gather(sleep(CLOCK, 0.001), sleep(ScaledClock(2.0), 0.001))
    assert timer_descriptors() == before + 1
    queue.release()
    assert timer_descriptors() == before + 1
    pending = queue.call_at(CLOCK.monotonic_ns() + 10**12, lambda: None)
    other.release()
    assert timer_descriptors() == before + 1
    pending.cancel()
    assert timer_descriptors() == before
    await sleep(CLOCK, 0.001)
    assert timer_descriptors() == before, "a sleep without a kernel leaves nothing"


@pytest.mark.slow(kept_by="test_descriptor_is_one_and_goes_with_the_last_timer_and_user")
@linux
def test_descriptor_of_a_loop_that_was_closed_without_release_goes_with_it() -> None:
    before = timer_descriptors()

    async def forgetful() -> None:
        timers_for(CLOCK).acquire()
        timers_for(CLOCK).call_at(CLOCK.monotonic_ns() + 10**12, lambda: None)

    for _ in range(3):
        asyncio.run(forgetful())
    gc.collect()
    assert timer_descriptors() == before


async def test_loop_without_readers_uses_its_own_timers() -> None:
    class WithoutReaders(asyncio.SelectorEventLoop):
        def add_reader(self, fd: object, callback: object, *args: object) -> None:
            raise NotImplementedError

    before = timer_descriptors() if sys.platform == "linux" else 0
    loop = WithoutReaders()
    start = CLOCK.monotonic_ns()
    await asyncio.to_thread(loop.run_until_complete, sleep(CLOCK, 0.01))
    loop.close()
    await asyncio.get_running_loop().shutdown_default_executor()
    assert CLOCK.monotonic_ns() - start >= 10 * MS
    assert (timer_descriptors() if sys.platform == "linux" else 0) == before


@linux
async def test_blocked_timerfd_falls_back_to_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    class Blocked:
        def create(self) -> int:
            raise PermissionError

        def set(self, fd: int, deadline_ns: int) -> None:
            raise AssertionError

    monkeypatch.setattr(timers, "find_timerfd", Blocked)
    start = CLOCK.monotonic_ns()
    await sleep(CLOCK, 0.01)
    assert CLOCK.monotonic_ns() - start >= 10 * MS


async def test_cancelled_sleep_leaves_no_timer() -> None:
    clock = SimulatedClock()
    task = asyncio.ensure_future(sleep(clock, 1))
    await asyncio.sleep(0)
    assert clock.pending == 1
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert clock.pending == 0


async def test_timer_that_fires_in_the_turn_of_a_cancellation_harms_nobody() -> None:
    clock = SimulatedClock()
    task = asyncio.ensure_future(sleep(clock, 1))
    await asyncio.sleep(0)
    clock.call_at(10**9, lambda: None)
    task.cancel()
    clock.fire(asyncio.get_running_loop())
    with pytest.raises(asyncio.CancelledError):
        await task


@pytest.mark.fault("C14")
@pytest.mark.parametrize("seconds", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("clock", [CLOCK, ScaledClock(2.0), SimulatedClock()], ids=repr)
async def test_sleep_for_no_number_of_seconds_is_refused(clock: SystemClock, seconds: float) -> None:
    with pytest.raises(ValueError, match="seconds="):
        await sleep(clock, seconds)


@pytest.mark.fault("C14")
@pytest.mark.parametrize("seconds", [0, -1, -1e300])
async def test_sleep_for_less_than_nothing_gives_one_turn(seconds: float) -> None:
    turns = []
    asyncio.get_running_loop().call_soon(turns.append, 1)
    await asyncio.wait_for(sleep(SimulatedClock(), seconds), 10)
    assert turns == [1]


@pytest.mark.slow
@pytest.mark.fault("C14")
async def test_waiting_burns_no_processor() -> None:
    tasks = [asyncio.ensure_future(sleep(CLOCK, 10**5 + n)) for n in range(100)]
    tasks.append(asyncio.ensure_future(sleep(CLOCK, 10**15)))
    await sleep(CLOCK, 0.01)
    before = time.process_time()
    await sleep(CLOCK, 0.4)
    assert time.process_time() - before <= 0.05
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


@pytest.mark.slow
@pytest.mark.fault("C14")
async def test_queue_in_use_without_timers_burns_no_processor(way: str) -> None:
    queue = timers_for(CLOCK)
    queue.acquire()
    await sleep(CLOCK, 0.001)
    before = time.process_time()
    await asyncio.sleep(0.3)
    used = time.process_time() - before
    queue.release()
    assert used <= 0.05


STOPPED = """
import asyncio, os, time
from aiorts.clock import SystemClock
from aiorts.kernel.loop.timers import sleep_until, timers_for
async def main():
    clock, wakes = SystemClock(), []
    timers_for(clock).acquire()
    start = clock.monotonic_ns()
    timers_for(clock).call_at(start + 300_000_000, lambda: wakes.append(clock.monotonic_ns() - start))
    # Said once it sleeps: stopped before that, the deadline would be in the past and nothing would have to wake it.
    asyncio.get_running_loop().call_later(0.05, lambda: print("ready", flush=True))
    await sleep_until(clock, start + 400_000_000)
    print(len(wakes), flush=True)
    timers_for(clock).release()
asyncio.run(main())
"""


@pytest.mark.slow(kept_by="test_overdue_timers_fire_at_the_next_turns_in_order")
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="no SIGSTOP on this system")
def test_stopped_process_gets_one_late_wake_up() -> None:
    child = subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    child.send_signal(signal.SIGSTOP)
    time.sleep(0.6)
    child.send_signal(signal.SIGCONT)
    rest, _ = child.communicate(timeout=20)
    assert rest == "1\n"


@pytest.mark.slow(kept_by="test_loop_without_readers_uses_its_own_timers")
@linux
def test_two_threads_set_their_timers_by_the_same_system_call() -> None:
    """What one of them fills in must never be what the other's timer is set to."""
    libc = timers._LibcTimerfd()
    gettime = ctypes.PyDLL(None).timerfd_gettime
    wrong: list[tuple[int, int]] = []

    def set_and_look(seconds: int) -> None:
        fd, left = libc.create(), (ctypes.c_long * 4)()
        try:
            due = time.monotonic_ns() + seconds * 1_000_000_000
            for _ in range(20_000):
                libc.set(fd, due)
                gettime(fd, left)
                if abs(left[2] - seconds) > 500:
                    wrong.append((seconds, left[2]))
        finally:
            os.close(fd)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=set_and_look, args=(seconds,)) for seconds in (1_000, 100_000)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert wrong == []
