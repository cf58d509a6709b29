"""One timer queue for each loop, in the order (deadline, creation), behind one timerfd that the loop reads.

The queue only waits: what is due, and on which clock, is decided by `aiorts.clock`. A timerfd is an ordinary reader to
any loop and wakes it within microseconds of an absolute deadline, where a loop's own timers are rounded to the
millisecond of its poll. Without timerfd (other systems, loops without readers) the loop's `call_later` serves, and so
it does on a loop that keeps its own time (`LoopClock`).
"""

from __future__ import annotations

import asyncio
import os
import struct
import sys
import time
import weakref
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from aiorts.clock import Clock, LoopClock, SimulatedClock, SystemClock, Timer, TimerHeap, clock_of, to_ns

if TYPE_CHECKING:
    from collections.abc import Callable

_LONGEST_NS = 2**62
"""About 146 years: what the kernel's own arithmetic can hold."""

_QUEUE, _OWN_QUEUE = "_aiorts_timers", "_aiorts_own_timers"
"""Attributes of a loop that hold its queues, of real time and of its own: loop and queue are collected together."""


class Cancellable(Protocol):
    """Something that happens later unless it is cancelled."""

    def cancel(self) -> None: ...


class TimerQueue(Protocol):
    """Timers of one clock on one loop. To be used in the loop's thread only."""

    def call_at(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        """Runs `callback` in the loop once `monotonic_ns()` of the clock has reached `deadline_ns`, never before.

        One in the past runs at the next turn. Timers that are due together run in the order (deadline, creation); a
        callback that raises goes to the loop's exception handler and the others still run. Callbacks may add and
        cancel timers; which `contextvars` context they run in is not defined.
        """
        ...

    def acquire(self) -> None:
        """One more user: the descriptor stays open between timers. Counted."""
        ...

    def release(self) -> None:
        """One user less: with the last user and the last timer gone the descriptor is closed."""
        ...


def timers_for(clock: Clock) -> TimerQueue:
    """The queue of the running loop, in terms of `clock`; real clocks share one, a simulated clock has its own.

    Raises RuntimeError outside of a running loop.
    """
    if isinstance(clock, SimulatedClock):
        return _SimulatedTimers(clock)
    loop = asyncio.get_running_loop()
    own = isinstance(clock, LoopClock) and clock is clock_of(loop)
    name = _OWN_QUEUE if own else _QUEUE
    queue: _LoopTimers | None = getattr(loop, name, None)
    if queue is None:
        queue = _LoopTimers(loop, clock if isinstance(clock, LoopClock) and own else None)
        setattr(loop, name, queue)
    return queue if own or type(clock) is SystemClock else _ClockTimers(queue, clock)


async def sleep(clock: Clock, seconds: float) -> None:
    """Waits `seconds` of `clock`; 0 and below give the loop one turn. Raises ValueError for NaN and infinities."""
    delay = to_ns(seconds)
    if delay <= 0:
        await asyncio.sleep(0)
        return
    await sleep_until(clock, clock.monotonic_ns() + delay)


async def sleep_until(clock: Clock, deadline_ns: int) -> None:
    """Waits until `clock.monotonic_ns()` is at least `deadline_ns`; a deadline in the past gives the loop one turn."""
    if deadline_ns <= clock.monotonic_ns():
        await asyncio.sleep(0)
        return
    future = asyncio.get_running_loop().create_future()

    def wake() -> None:
        # The sleeper may have been cancelled in this very turn and not have run yet.
        if not future.done():
            future.set_result(None)

    timer = timers_for(clock).call_at(deadline_ns, wake)
    try:
        await future
    finally:
        timer.cancel()


class _SimulatedTimers:
    """A simulated clock's own heap; the code that moves the clock fires it."""

    __slots__ = ("call_at",)

    def __init__(self, clock: SimulatedClock) -> None:
        self.call_at = clock.call_at

    def acquire(self) -> None:
        """There is nothing to keep open."""

    def release(self) -> None:
        """There is nothing to close."""


class _ClockTimers:
    """The loop's queue seen through a clock that runs at another speed."""

    __slots__ = ("_clock", "_queue", "acquire", "release")

    def __init__(self, queue: _LoopTimers, clock: Clock) -> None:
        self._queue = queue
        self._clock = clock
        self.acquire = queue.acquire
        self.release = queue.release

    def call_at(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        # On a fast clock many deadlines share one real nanosecond: the rank keeps their order.
        return self._queue.call_at(self._clock.real_deadline_ns(deadline_ns), callback, deadline_ns)


class _LoopTimers:
    """A queue of one loop, on CLOCK_MONOTONIC or, with a clock of the loop's own, on that."""

    def __init__(self, loop: asyncio.AbstractEventLoop, own: LoopClock | None = None) -> None:
        # Weak, so that a loop that was closed and dropped goes at once and takes the descriptor with it.
        self._loop = weakref.ref(loop)
        self._heap = TimerHeap(self._close_if_unused)
        self._own = own
        self._now_ns = time.monotonic_ns if own is None else own.monotonic_ns
        self._users = 0
        self._alarm: _Alarm | None = None
        self._armed: int | None = None
        self._firing = False

    def call_at(self, deadline_ns: int, callback: Callable[[], object], rank: int = 0) -> Timer:
        timer = self._heap.push(deadline_ns, callback, rank)
        if not self._firing and (self._armed is None or deadline_ns < self._armed):
            self._arm(deadline_ns)
        return timer

    def acquire(self) -> None:
        self._users += 1

    def release(self) -> None:
        self._users -= 1
        self._close_if_unused()

    def _arm(self, deadline_ns: int) -> None:
        if self._alarm is None:
            loop = self._loop()
            if loop is None:
                raise RuntimeError("timer queue: its event loop is gone")
            self._alarm = _open_alarm(loop, self._fire, self._own)
        self._armed = deadline_ns
        self._alarm.arm(deadline_ns)

    def _fire(self) -> None:
        self._armed = None
        loop = self._loop()
        if loop is None:
            return
        self._firing = True
        try:
            self._heap.run_due(self._now_ns(), loop)
        finally:
            self._firing = False
            deadline = self._heap.next_deadline()
            if deadline is not None:
                self._arm(deadline)
            else:
                self._close_if_unused()

    def _close_if_unused(self) -> None:
        if self._users <= 0 and not self._firing and not self._heap and self._alarm is not None:
            self._alarm.close()
            self._alarm = self._armed = None


class _Alarm(Protocol):
    """Calls its owner in the loop some time after an absolute moment of CLOCK_MONOTONIC; one moment at a time."""

    def arm(self, deadline_ns: int) -> None: ...

    def close(self) -> None: ...


def _open_alarm(loop: asyncio.AbstractEventLoop, fire: Callable[[], None], own: LoopClock | None) -> _Alarm:
    # A loop that keeps its own time may not watch descriptors; timers every loop has.
    timerfd = None if isinstance(clock_of(loop), LoopClock) else find_timerfd()
    if timerfd is not None:
        try:
            return _TimerfdAlarm(loop, fire, timerfd)
        except (OSError, NotImplementedError):
            # Blocked by a sandbox, no descriptor left, or a loop without readers: late is better than never.
            return _LoopAlarm(loop, fire, own)
    return _LoopAlarm(loop, fire, own)


class _LoopAlarm:
    """The loop's own timer, with its own precision. It may ring early: the queue then arms it again."""

    def __init__(self, loop: asyncio.AbstractEventLoop, fire: Callable[[], None], own: LoopClock | None) -> None:
        self._loop = weakref.ref(loop)
        self._fire = fire
        self._own = own
        self._now_ns = time.monotonic_ns if own is None else own.loop_ns
        self._handle: asyncio.TimerHandle | None = None

    def arm(self, deadline_ns: int) -> None:
        self.close()
        if (loop := self._loop()) is not None:
            now = self._now_ns()
            delay = min(max(deadline_ns - now, 0), 86_400 * 10**9)
            ring = self._fire if self._own is None else partial(self._ring, self._own, now + delay)
            self._handle = loop.call_later(delay / 1e9, ring)

    def _ring(self, own: LoopClock, moment_ns: int) -> None:
        own.come_to(moment_ns)
        self._fire()

    def close(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None


class _TimerfdAlarm:
    """A timerfd that the loop reads."""

    def __init__(self, loop: asyncio.AbstractEventLoop, fire: Callable[[], None], timerfd: _Timerfd) -> None:
        self._loop = weakref.ref(loop)
        self._fire = fire
        self._set = timerfd.set
        self._fd = fd = timerfd.create()
        try:
            loop.add_reader(fd, self._ring)
        except BaseException:
            os.close(fd)
            raise
        # For a loop that is closed and dropped while timers are pending.
        self._finalizer = weakref.finalize(self, os.close, fd)

    def arm(self, deadline_ns: int) -> None:
        # 0 would disarm it; a moment in the past makes it readable at once.
        self._set(self._fd, min(max(deadline_ns, 1), _LONGEST_NS))

    def _ring(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:
            return  # re-armed for later between the poll and this call
        self._fire()

    def close(self) -> None:
        loop = self._loop()
        if loop is not None and not loop.is_closed():
            loop.remove_reader(self._fd)
        self._finalizer()


class _Timerfd(Protocol):
    """The two system calls: create on CLOCK_MONOTONIC, set one absolute moment."""

    def create(self) -> int: ...

    def set(self, fd: int, deadline_ns: int) -> None: ...


class _OsTimerfd:
    """By the standard library, from Python 3.13."""

    def create(self) -> int:
        return os.timerfd_create(time.CLOCK_MONOTONIC, flags=os.TFD_NONBLOCK | os.TFD_CLOEXEC)  # type: ignore[attr-defined,no-any-return,unused-ignore]

    def set(self, fd: int, deadline_ns: int) -> None:
        os.timerfd_settime_ns(fd, flags=os.TFD_TIMER_ABSTIME, initial=deadline_ns)  # type: ignore[attr-defined,unused-ignore]


_ITIMERSPEC: Final = struct.Struct("@4l").pack
"""struct itimerspec: interval (s, ns), value (s, ns), each a long."""


class _LibcTimerfd:
    """By ctypes, before Python 3.13. Raises AttributeError, ImportError or OSError where there is none."""

    def __init__(self) -> None:
        import ctypes

        self._errno = ctypes.get_errno
        # PyDLL keeps the interpreter lock: giving it up and taking it again costs more than the call.
        libc = ctypes.PyDLL(None, use_errno=True)
        self._create = libc.timerfd_create
        self._settime = libc.timerfd_settime
        self._settime.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)

    def create(self) -> int:
        fd = int(self._create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
        if fd < 0:
            raise OSError(self._errno(), "timerfd_create failed")
        return fd

    def set(self, fd: int, deadline_ns: int) -> None:
        # A buffer for each call: one that is kept may be filled by two threads at once.
        spec = _ITIMERSPEC(0, 0, *divmod(deadline_ns, 1_000_000_000))
        if self._settime(fd, 1, spec, None) != 0:  # 1: TFD_TIMER_ABSTIME
            raise OSError(self._errno(), "timerfd_settime failed")


def find_timerfd() -> _Timerfd | None:
    """The system calls, for as many threads as there are."""
    if sys.platform != "linux":
        return None
    if hasattr(os, "timerfd_create"):
        return _OsTimerfd()
    try:
        return _LibcTimerfd()
    except (AttributeError, ImportError, OSError):
        return None
