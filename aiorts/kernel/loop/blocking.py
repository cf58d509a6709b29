"""The waits of a thread, for a port, for its next tick, for a request: it blocks, and so may simulated time.

A simulated clock stands still while such a thread works. Before the thread blocks it lets go of the clock, once the
timer that would wake it is set; the code that wakes it holds the clock again on its behalf, in the same step. So the
clock stands still between the wake-up and the next act of the thread.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from aiorts.clock import Clock, Hold, SimulatedClock

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import Cancellable

CallAt = Callable[[int, Callable[[], None]], "Cancellable"]


class PortLock(threading.Condition):
    """A condition that first calls what waiting threads left with it, with the lock held, and then wakes them."""

    def __init__(self) -> None:
        super().__init__()
        self.deputies: list[Callable[[], None]] = []

    def notify_all(self) -> None:
        for deputy in tuple(self.deputies):
            deputy()
        super().notify_all()


class Blocking(Protocol):
    """The way in which one thread blocks."""

    def until(self, lock: PortLock, ready: Callable[[], bool], deadline_ns: int | None) -> bool:
        """Block until `ready()` or until the clock has come to the deadline; says which. The caller holds `lock`."""
        ...

    def end(self) -> None:
        """The thread waits no more."""
        ...


def blocking_for(clock: Clock, loop: asyncio.AbstractEventLoop, call_at: CallAt) -> Blocking:
    """The way to block for a thread that is about to start."""
    return _Simulated(clock, loop, call_at) if isinstance(clock, SimulatedClock) else _Real(clock)


class _Real:
    """Real time goes on by itself."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def until(self, lock: PortLock, ready: Callable[[], bool], deadline_ns: int | None) -> bool:
        if deadline_ns is None:
            return lock.wait_for(ready)
        clock = self._clock
        while not ready():
            rest = deadline_ns - clock.monotonic_ns()
            if rest <= 0:
                return False
            lock.wait(min(rest / 1e9 / clock.speed, threading.TIMEOUT_MAX))
        return True

    def end(self) -> None:
        """Nothing is held."""


class _Simulated:
    """The clock is held while the thread works, and let go while it blocks."""

    def __init__(self, clock: SimulatedClock, loop: asyncio.AbstractEventLoop, call_at: CallAt) -> None:
        self._clock = clock
        self._loop = loop
        self._call_at = call_at
        self._guard = threading.Lock()
        self._held: Hold | None = clock.hold()
        self._ended = False

    def until(self, lock: PortLock, ready: Callable[[], bool], deadline_ns: int | None) -> bool:
        if ready():
            return True
        if deadline_ns is not None and deadline_ns <= self._clock.monotonic_ns():
            return False
        alarm = _Alarm(self, lock, deadline_ns)
        lock.deputies.append(self.hold)
        try:
            self._set(alarm)
            while not ready() and not alarm.rung:
                lock.wait()
                if alarm.armed and not ready() and not alarm.rung:
                    self.let_go()
        finally:
            lock.deputies.remove(self.hold)
            self.hold()
            alarm.over = True
            if alarm.timer is not None:
                self._loop.call_soon_threadsafe(alarm.timer.cancel)
        return ready()

    def _set(self, alarm: _Alarm) -> None:
        if alarm.deadline_ns is None:
            alarm.armed = True
            self.let_go()
        else:
            # Timers belong to the loop; the clock is let go there, once this one is set.
            self._loop.call_soon_threadsafe(alarm.set)

    def hold(self) -> None:
        """Time stands still from now on."""
        with self._guard:
            if self._held is None and not self._ended:
                self._held = self._clock.hold()

    def let_go(self) -> None:
        """Time may pass."""
        with self._guard:
            held, self._held = self._held, None
        if held is not None:
            held.release()

    def end(self) -> None:
        with self._guard:
            self._ended = True
        self.let_go()

    def arm(self, deadline_ns: int, callback: Callable[[], None]) -> Cancellable:
        """A timer of the loop, set in its thread; the clock is let go."""
        timer = self._call_at(deadline_ns, callback)
        self.let_go()
        return timer


class _Alarm:
    """The end of one wait in simulated time. Its state changes with the lock held."""

    def __init__(self, blocking: _Simulated, lock: PortLock, deadline_ns: int | None) -> None:
        self.deadline_ns = deadline_ns
        self.armed = self.rung = self.over = False
        self.timer: Cancellable | None = None
        self._blocking = blocking
        self._lock = lock

    def set(self) -> None:
        """In the loop's thread: from now on the deadline counts, unless the wait is over already."""
        with self._lock:
            if not self.over and self.deadline_ns is not None:
                self.armed = True
                self.timer = self._blocking.arm(self.deadline_ns, self.ring)

    def ring(self) -> None:
        """The deadline has come."""
        with self._lock:
            if not self.over:
                self.rung = True
                self._lock.notify_all()
