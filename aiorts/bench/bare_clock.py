"""Bare periodic loops: the least that asyncio, a thread and the system call itself need to wake up on time.

Every loop keeps absolute deadlines, leaves out ticks that are missed, and only notes when it ran.
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
from time import monotonic_ns, process_time_ns
from typing import Any, Final

from aiorts.bench.pacing import Ticks

__all__ = ("Marks", "asyncio_sleep", "clock_nanosleep", "has_clock_nanosleep", "take_priority", "time_sleep")

_CLOCK_MONOTONIC: Final = 1
_TIMER_ABSTIME: Final = 1
_PR_SET_TIMERSLACK: Final = 29
_LEAD_NS: Final = 2_000_000
"""How long before the first deadline a loop begins."""


class Marks:
    """Ticks noted while a loop runs, with room for `count` of them made before; tick n is due at start + n * period.

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
        """One tick ran."""
        self.due[self.number] = self.next_ns
        self.ran[self.number] = now
        self.number += 1
        behind = max(0, now - self.next_ns) // self.period_ns  # a loop of coarse timers wakes early, too
        if behind and self.number < self.count:
            # What is due already is left out, except the newest: as a context with overrun="skip" does.
            self.overruns += 1
            self.skipped += behind - 1
            self.tick += behind - 1
        self.tick += 1
        self.next_ns = self.start + self.tick * self.period_ns

    def ticks(self) -> Ticks:
        """What there is at the end."""
        return Ticks(self.period_ns, self.due, self.ran, self.skipped, self.overruns, process_time_ns() - self.cpu)


async def asyncio_sleep(period_ns: int, count: int) -> Ticks:
    """`asyncio.sleep` up to each deadline."""
    marks = Marks(period_ns, count)
    sleep = asyncio.sleep
    for _ in range(count):
        await sleep(max(0, marks.next_ns - monotonic_ns()) / 1e9)
        marks.ran_now(monotonic_ns())
    return marks.ticks()


async def time_sleep(period_ns: int, count: int) -> Ticks:
    """`time.sleep` up to each deadline, in a thread beside an idle loop."""

    def loop(marks: Marks) -> None:
        sleep = time.sleep
        for _ in range(count):
            ahead = marks.next_ns - monotonic_ns()
            if ahead > 0:
                sleep(ahead / 1e9)
            marks.ran_now(monotonic_ns())

    return await _in_thread(loop, period_ns, count, priority=None)


async def clock_nanosleep(period_ns: int, count: int, *, priority: int | None = None) -> Ticks:
    """`clock_nanosleep(TIMER_ABSTIME)` by ctypes, in a thread; with `priority` under SCHED_FIFO where it is granted.

    Raises:
        OSError: the system call failed. AttributeError: there is none here.
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
    """SCHED_FIFO for the calling thread, 1 ns of timer slack; False when it was not granted."""
    if sys.platform != "linux":
        return False
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


async def _in_thread(loop: Callable[[Marks], None], period_ns: int, count: int, priority: int | None) -> Ticks:
    """In a thread of its own: what it changes of itself ends with it, and no pool adds a queue."""
    running = asyncio.get_running_loop()
    done: asyncio.Future[Ticks] = running.create_future()

    def finish(ticks: Ticks | None, error: OSError | None) -> None:
        if done.done():
            return
        if error is None and ticks is not None:
            done.set_result(ticks)
        else:
            done.set_exception(error or OSError("no ticks"))

    def run() -> None:
        try:
            if priority is not None:
                take_priority(priority)
            marks = Marks(period_ns, count)
            loop(marks)
            running.call_soon_threadsafe(finish, marks.ticks(), None)
        except OSError as error:
            running.call_soon_threadsafe(finish, None, error)

    thread = threading.Thread(target=run, name="bare loop", daemon=True)
    thread.start()
    try:
        return await done
    finally:
        thread.join(1.0)


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


def _absolute_sleep() -> Callable[[int], None]:
    """What sleeps up to a moment of CLOCK_MONOTONIC."""
    if sys.platform != "linux":
        raise AttributeError("clock_nanosleep is asked for by ctypes on Linux only")
    call: Any = ctypes.CDLL(None).clock_nanosleep
    moment = _Timespec()
    pointer = ctypes.byref(moment)

    def sleep_until(when_ns: int) -> None:
        moment.sec, moment.nsec = divmod(when_ns, 1_000_000_000)
        while (failed := call(_CLOCK_MONOTONIC, _TIMER_ABSTIME, pointer, None)) != 0:
            if failed != errno.EINTR:
                raise OSError(failed, os.strerror(failed))

    return sleep_until
