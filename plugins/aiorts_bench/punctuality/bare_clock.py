"""Bare periodic loops: how late asyncio, a thread and the system call itself wake up.

Every loop keeps absolute deadlines, skips ticks that are missed, and does nothing but record when it ran.
"""

from __future__ import annotations

import asyncio
import ctypes
import errno
import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from time import monotonic_ns, process_time_ns
from typing import Any, Final

from aiorts_bench.punctuality.pacing import Ticks

_CLOCK_MONOTONIC: Final = 1
_TIMER_ABSTIME: Final = 1
_PR_SET_TIMERSLACK: Final = 29
_LEAD_NS: Final = 2_000_000
"""Nanoseconds from the beginning of a loop to its first deadline."""


class Marks:
    """Records the ticks of a loop, in lists of `count` places made before it runs; tick n is due at start + n * period.

    `next_ns` is when the next tick is due; a loop sleeps up to it and calls `ran_now`.
    """

    def __init__(self, period_ns: int, count: int) -> None:
        self.period_ns, self.count = period_ns, count
        self.due = [0] * count
        self.ran = [0] * count
        self.skipped = self.overruns = 0
        self.number = 0
        self.cpu = process_time_ns()
        self.start = self.next_ns = monotonic_ns() + _LEAD_NS
        self.tick = 0

    def ran_now(self, now: int) -> None:
        """Record that the next tick ran at `now`."""
        self.due[self.number] = self.next_ns
        self.ran[self.number] = now
        self.number += 1
        behind = max(0, now - self.next_ns) // self.period_ns  # max: coarse timers may wake a loop early
        if behind and self.number < self.count:
            # Ticks that are due already are left out, except the newest, as in a context with overrun="skip".
            self.overruns += 1
            self.skipped += behind - 1
            self.tick += behind - 1
        self.tick += 1
        self.next_ns = self.start + self.tick * self.period_ns

    def ticks(self) -> Ticks:
        """The ticks recorded."""
        return Ticks(self.period_ns, self.due, self.ran, self.skipped, self.overruns, process_time_ns() - self.cpu)


async def asyncio_sleep(period_ns: int, count: int) -> Ticks:
    """Wait for each deadline by `asyncio.sleep`."""
    marks = Marks(period_ns, count)
    sleep = asyncio.sleep
    for _ in range(count):
        await sleep(max(0, marks.next_ns - monotonic_ns()) / 1e9)
        marks.ran_now(monotonic_ns())
    return marks.ticks()


async def time_sleep(period_ns: int, count: int) -> Ticks:
    """Wait for each deadline by `time.sleep`, in a thread, while the event loop is idle."""

    def loop(marks: Marks) -> None:
        sleep = time.sleep
        for _ in range(count):
            ahead = marks.next_ns - monotonic_ns()
            if ahead > 0:
                sleep(ahead / 1e9)
            marks.ran_now(monotonic_ns())

    return await _in_thread(loop, period_ns, count, priority=None)


async def clock_nanosleep(period_ns: int, count: int, *, priority: int | None = None) -> Ticks:
    """Wait for each deadline by `clock_nanosleep(TIMER_ABSTIME)` in a thread, under SCHED_FIFO where `priority` asks.

    Raises:
        OSError: the system call failed.
        AttributeError: this system has no such call.
    """
    sleep_until = _absolute_sleep()

    def loop(marks: Marks) -> None:
        for _ in range(count):
            sleep_until(marks.next_ns)
            marks.ran_now(monotonic_ns())

    return await _in_thread(loop, period_ns, count, priority=priority)


def has_clock_nanosleep() -> bool:
    """Whether this system has the call."""
    try:
        _absolute_sleep()
    except (AttributeError, OSError):
        return False
    return True


def take_priority(priority: int) -> bool:
    """Put the calling thread under SCHED_FIFO, with 1 ns of timer slack; False where the system refuses."""
    if sys.platform != "linux":
        return False
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


async def _in_thread(loop: Callable[[Marks], None], period_ns: int, count: int, priority: int | None) -> Ticks:
    """Run a loop in its own thread, not of a pool: its priority ends with the thread, and no queue delays its start."""
    done: Future[Ticks] = Future()
    done.set_running_or_notify_cancel()  # so that cancelling the task does not cancel the future that the thread sets

    def run() -> None:
        try:
            if priority is not None:
                take_priority(priority)
            marks = Marks(period_ns, count)
            loop(marks)
            done.set_result(marks.ticks())
        except OSError as error:
            done.set_exception(error)

    thread = threading.Thread(target=run, name="bare loop", daemon=True)
    thread.start()
    try:
        return await asyncio.wrap_future(done)
    finally:
        thread.join(1.0)


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


def _absolute_sleep() -> Callable[[int], None]:
    """A function that sleeps up to a moment of CLOCK_MONOTONIC."""
    if sys.platform != "linux":
        raise AttributeError("clock_nanosleep is called by ctypes on Linux only")
    call: Any = ctypes.CDLL(None).clock_nanosleep
    moment = _Timespec()
    pointer = ctypes.byref(moment)

    def sleep_until(when_ns: int) -> None:
        moment.sec, moment.nsec = divmod(when_ns, 1_000_000_000)
        while (failed := call(_CLOCK_MONOTONIC, _TIMER_ABSTIME, pointer, None)) != 0:
            if failed != errno.EINTR:
                raise OSError(failed, os.strerror(failed))

    return sleep_until
