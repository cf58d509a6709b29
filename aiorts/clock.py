"""The only place that asks what time it is; all times are integers in nanoseconds.

A clock has two faces. `time_ns()` is the time since the epoch, for stamps; it goes where the wall clock goes.
`monotonic_ns()` never jumps and never goes back; every period and deadline is measured on it. Nothing here keeps a
wake-up of its own: real timers are `aiorts.kernel.loop.timers`, simulated ones lie in a heap until the clock is moved.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

from aiorts.errors import BusyError, StateError
from aiorts.timer_heap import Hold, Timer, TimerHeap

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

__all__ = (
    "Clock",
    "Hold",
    "LoopClock",
    "ScaledClock",
    "SimulatedClock",
    "SystemClock",
    "Timer",
    "TimerHeap",
    "clock_of",
    "current_clock",
    "to_ns",
)

NS_PER_S = 1_000_000_000

SETTLED_TURNS = 16
"""Turns of a foreign loop without any change of a probe after which a deadline counts as dealt with."""


def to_ns(seconds: float, what: str = "seconds") -> int:
    """Nearest nanosecond to `seconds`; whole numbers exactly, any time above 0 is at least 1 ns.

    Raises ValueError, naming `what`, for NaN and infinities.
    """
    if isinstance(seconds, int):
        return seconds * NS_PER_S
    if not math.isfinite(seconds):
        raise ValueError(f"{what}={seconds!r}: expected a finite number of seconds")
    nanoseconds = float(seconds) * NS_PER_S
    if math.isinf(nanoseconds):
        return int(seconds) * NS_PER_S
    # A delay rounded down to nothing would let a loop that halves its delays spin forever.
    return round(nanoseconds) or int(seconds > 0)


class Clock(ABC):
    """The time of one kernel, for periods, time-outs and stamps."""

    @property
    def speed(self) -> float:
        """Seconds of this clock that pass in one real second."""
        return 1.0

    @abstractmethod
    def time_ns(self) -> int:
        """Nanoseconds since the epoch, for stamps; may jump with the wall clock."""

    @abstractmethod
    def monotonic_ns(self) -> int:
        """Nanoseconds since some fixed moment; never jumps, never goes back."""

    def time(self) -> float:
        """Seconds since the epoch: `time_ns()` as a float."""
        return self.time_ns() / 1e9

    def real_deadline_ns(self, deadline_ns: int) -> int:
        """The first moment of `time.monotonic_ns()` at which `monotonic_ns()` has reached `deadline_ns`."""
        return deadline_ns


class SystemClock(Clock):
    """The machine's clocks: CLOCK_MONOTONIC for periods, the wall clock for stamps.

    `wall` replaces the source of stamps (nanoseconds since the epoch); periods cannot be affected by it.
    """

    __slots__ = ("_wall",)

    def __init__(self, wall: Callable[[], int] = time.time_ns) -> None:
        self._wall = wall

    def time_ns(self) -> int:
        return self._wall()

    # The function itself: every hook asks it, and a method round it would cost more than it does.
    monotonic_ns = staticmethod(time.monotonic_ns)  # pyright: ignore[reportAssignmentType] # called on instances only

    def __repr__(self) -> str:
        return "SystemClock()"


class ScaledClock(Clock):
    """Real time that passes `speed` times as fast, from the moment of construction.

    Both faces are scaled from CLOCK_MONOTONIC, so stamps and periods stay in step and a jump of the wall clock shows in
    neither. `start_ns` is the first stamp (default: now). `real` replaces the source, for tests. Raises ValueError
    unless `speed` is finite and above zero.
    """

    __slots__ = ("_base", "_denominator", "_epoch", "_numerator", "_real")

    def __init__(
        self, speed: float, *, start_ns: int | None = None, real: Callable[[], int] = time.monotonic_ns
    ) -> None:
        if not (math.isfinite(speed) and speed > 0):
            raise ValueError(f"speed={speed!r}: expected a finite number above 0 (1.0 is real time)")
        # An integer ratio: floats would lose nanoseconds after some days.
        self._numerator, self._denominator = float(speed).as_integer_ratio()
        self._real = real
        self._base = real()
        self._epoch = time.time_ns() if start_ns is None else start_ns

    @property
    def speed(self) -> float:
        return self._numerator / self._denominator

    def _elapsed_ns(self) -> int:
        return (self._real() - self._base) * self._numerator // self._denominator

    def time_ns(self) -> int:
        return self._epoch + self._elapsed_ns()

    def monotonic_ns(self) -> int:
        return self._base + self._elapsed_ns()

    def real_deadline_ns(self, deadline_ns: int) -> int:
        # Rounded up, so that the clock has always reached the deadline when its timer fires.
        return self._base - (self._base - deadline_ns) * self._denominator // self._numerator

    def __repr__(self) -> str:
        return f"ScaledClock({self.speed:g})"


class LoopClock(Clock):
    """The time of an event loop that keeps its own, a simulator's or a browser's.

    Stamps begin at the wall clock's and go on with the loop. `come_to(deadline_ns)` notes that the loop has fired for a
    deadline: it is reached, whatever the loop's `time()`, a float, was rounded to.
    """

    __slots__ = ("_base", "_epoch", "_loop", "_reached")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._reached = 0
        self._base = self.monotonic_ns()
        self._epoch = time.time_ns()

    def time_ns(self) -> int:
        return self._epoch + self.monotonic_ns() - self._base

    def monotonic_ns(self) -> int:
        return max(self._reached, self.loop_ns())

    def loop_ns(self) -> int:
        """The loop's own time, which may be a little less: a timer for this clock is set by it."""
        return round(self._loop.time() * NS_PER_S)

    def come_to(self, deadline_ns: int) -> None:
        """Note that the loop has fired for this moment."""
        self._reached = max(self._reached, deadline_ns)

    def real_deadline_ns(self, deadline_ns: int) -> int:
        # An estimate: the loop may jump there.
        return time.monotonic_ns() + deadline_ns - self.monotonic_ns()

    def __repr__(self) -> str:
        return f"LoopClock({self._loop!r})"


class SimulatedClock(Clock):
    """Time that passes only when it is moved: by a `SimulatedLoop`, or on any other loop by `advance()`.

    `monotonic_ns()` starts at 0 and `time_ns()` at `start_ns`. All timers of one deadline fire together, in the order
    of their creation; what they made ready finishes; then the next deadline comes, which may be the same moment again.
    Timers belong to the thread of the loop; `hold()` may be used in any.
    """

    def __init__(self, start_ns: int = 0) -> None:
        self.now_ns = 0
        """The value of `monotonic_ns()`; `move_to` sets it."""
        self._epoch = start_ns
        self._timers = TimerHeap()
        self._probes: dict[object, Callable[[], int]] = {}
        self._holds = 0
        self._lock = threading.Lock()
        self._on_release: dict[object, Callable[[], object]] = {}
        self._driver: Callable[[int], Awaitable[None]] | None = None
        self._advancing = False

    def time_ns(self) -> int:
        return self._epoch + self.now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def set_time_ns(self, epoch_ns: int) -> None:
        """Set the wall clock alone, as an operator would: stamps jump, periods and deadlines do not."""
        self._epoch = epoch_ns - self.now_ns

    def real_deadline_ns(self, deadline_ns: int) -> int:
        """Raise StateError: a simulated deadline has no real time."""
        raise StateError(f"{self!r}: a simulated deadline has no real time; wait for it with timers_for(clock).call_at")

    def __repr__(self) -> str:
        return f"<SimulatedClock at {self.now_ns / 1e9:.9f} s>"

    # -- timers ---------------------------------------------------------------------------------------------------

    def call_at(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        """Run `callback` when `monotonic_ns()` has come to `deadline_ns`; for one in the past, at the next step."""
        return self._timers.push(deadline_ns, callback)

    def next_deadline(self) -> int | None:
        """The earliest pending deadline on `monotonic_ns()`."""
        return self._timers.next_deadline()

    @property
    def pending(self) -> int:
        """Pending timers."""
        return len(self._timers)

    def move_to(self, now_ns: int) -> None:
        """Set the time, and fire nothing; a moment in the past is ignored. For the code that drives the clock."""
        self.now_ns = max(now_ns, self.now_ns)

    def fire(self, loop: asyncio.AbstractEventLoop) -> None:
        """Move to the earliest deadline and run all its timers (and overdue ones) once. For the clock's driver."""
        deadline = self._timers.next_deadline()
        if deadline is not None:
            self.move_to(deadline)
            self._timers.run_due(self.now_ns, loop)

    # -- moving by hand -------------------------------------------------------------------------------------------

    async def advance(self, seconds: float) -> None:
        """Let `seconds` pass: every timer due by then fires, and what it woke finishes before the next deadline.

        Raises:
            ValueError: a negative number, NaN or an infinity.
            BusyError: the clock is being advanced already, or moved by another loop.
        """
        step = to_ns(seconds)
        if step < 0:
            raise ValueError(f"seconds={seconds!r}: expected 0 or more, time does not go back")
        await self.advance_to(self.now_ns + step)

    async def advance_to(self, monotonic_ns: int) -> None:
        """`advance()` to a moment of `monotonic_ns()`.

        Raises:
            ValueError: the moment has passed.
            BusyError: the clock is being advanced already, or moved by another loop.
        """
        if monotonic_ns < self.now_ns:
            raise ValueError(f"{self!r}: cannot go back to {monotonic_ns} ns")
        loop = asyncio.get_running_loop()
        if self._driver is not None:
            if getattr(loop, "aiorts_clock", None) is not self:
                raise BusyError(f"{self!r}: moved by its own simulated loop; await advance() there")
            await self._driver(monotonic_ns)
            return
        if self._advancing:
            raise BusyError(f"{self!r}: is being advanced already; one task at a time moves the clock")
        self._advancing = True
        try:
            await self._settle(loop)
            while (deadline := self._timers.next_deadline()) is not None and deadline <= monotonic_ns:
                self.fire(loop)
                await self._settle(loop)
            self.move_to(monotonic_ns)
        finally:
            self._advancing = False

    async def _settle(self, loop: asyncio.AbstractEventLoop) -> None:
        """Give the loop turns until kernel activity has stopped and the clock is not held."""
        quiet, before = 0, self._activity()
        while quiet < SETTLED_TURNS:
            if self._holds:
                await self._released(loop)
                quiet = 0
            await asyncio.sleep(0)
            now = self._activity()
            quiet = quiet + 1 if now == before else 0
            before = now

    async def _released(self, loop: asyncio.AbstractEventLoop) -> None:
        event = asyncio.Event()
        remove = self.on_release(lambda: loop.call_soon_threadsafe(event.set))
        try:
            # Looked at again: the last hold may have gone before the listener was added.
            if self._holds:
                await event.wait()
        finally:
            remove()

    # -- who else matters -----------------------------------------------------------------------------------------

    def _activity(self) -> int:
        return sum(probe() for probe in self._probes.values())

    def add_probe(self, probe: Callable[[], int]) -> Callable[[], None]:
        """Register a counter of activity that `advance()` watches to see the loop settle; return its remover."""
        key = object()
        self._probes[key] = probe
        return lambda: _discard(self._probes, key)

    @property
    def held(self) -> bool:
        """Whether the clock is held."""
        return self._holds > 0

    def hold(self) -> Hold:
        """Stop time until the hold is released (a context manager, counted), while a thread works for instance."""
        with self._lock:
            self._holds += 1
        return Hold(self._release_hold)

    def _release_hold(self) -> None:
        with self._lock:
            self._holds -= 1
            listeners = () if self._holds else tuple(self._on_release.values())
        for listener in listeners:
            listener()

    def on_release(self, listener: Callable[[], object]) -> Callable[[], None]:
        """Call `listener`, in the thread that releases, whenever the last hold goes; return its remover."""
        key = object()
        with self._lock:
            self._on_release[key] = listener
        return lambda: _discard(self._on_release, key)

    def attach(self, driver: Callable[[int], Awaitable[None]]) -> Callable[[], None]:
        """Give the clock to a loop: `driver(monotonic_ns)` waits for a moment. Return a function that takes it back.

        Raises BusyError when a loop has it already.
        """
        if self._driver is not None or self._advancing:
            raise BusyError(f"{self!r}: is moved by another loop; one simulated loop for each clock")
        self._driver = driver

        def detach() -> None:
            self._driver = None

        return detach


def _discard(table: dict[object, Any], key: object) -> None:
    table.pop(key, None)


_OF_THE_MACHINE = ("asyncio", "uvloop")
"""The packages that make loops whose `time()` is CLOCK_MONOTONIC."""

_CLOCK = "_aiorts_loop_clock"
"""Attribute of a loop that keeps its own time: all kernels on it share one clock."""


def clock_of(loop: asyncio.AbstractEventLoop) -> Clock:
    """The clock of a kernel on this loop that is given none: the machine's, or the loop's where it keeps its own."""
    simulated = getattr(loop, "aiorts_clock", None)
    if isinstance(simulated, SimulatedClock):
        return simulated
    keeper = next((base for base in type(loop).__mro__ if "time" in vars(base)), type(loop))
    if keeper.__module__.partition(".")[0] in _OF_THE_MACHINE:
        return SystemClock()
    clock = getattr(loop, _CLOCK, None)
    if not isinstance(clock, LoopClock):
        clock = LoopClock(loop)
        setattr(loop, _CLOCK, clock)
    return clock


def current_clock() -> SimulatedClock | None:
    """The clock of the simulated loop this code runs on; None on any other loop and outside of loops."""
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return None
    clock = getattr(loop, "aiorts_clock", None)
    return clock if isinstance(clock, SimulatedClock) else None
