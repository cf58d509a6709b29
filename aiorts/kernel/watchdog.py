"""Watches whether an event loop turns: one that code of somebody's keeps is named while it still does, with its line.

The loop sets a timer forward ten times a second; the thread that waits on the timers of all contexts (`watcher.py`,
without the interpreter lock) hears of it when the loop did not. Then it looks at what the loop's thread runs. It says
nothing while a debugger holds the process, and time in which the whole process did not run (stopped, suspended,
starved) counts for nothing.
"""

from __future__ import annotations

import asyncio
import logging
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from aiorts.clock import SimulatedClock
from aiorts.kernel import timers, watcher
from aiorts.kernel.blame import Line, choose_line, cut_at_loop
from aiorts.kernel.bus import Event
from aiorts.kernel.tasks import owner_of
from aiorts.kernel.witness import _blame_hook, _stack, depth_beneath_task
from aiorts.model.blame import Blame

if TYPE_CHECKING:
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.timers import _Timerfd as Timerfd

__all__ = ("EXIT_STATUS", "LoopStall", "LoopStalls", "LoopWatch")

_LOG = logging.getLogger("aiorts.kernel")
EXIT_STATUS: Final = 70
_BEAT: Final = 0.1
"""Seconds between two signs of life."""
_SILENCE_NS: Final = 200_000_000
"""Without one for so long the loop is looked at."""
_ABSENT_NS: Final = 50_000_000
"""Woken so much too late, with nobody using the processor meanwhile, the whole process did not run."""
_SHOWN: Final = 12
"""Frames in the line of the log."""
_DEBUGGERS: Final = frozenset(
    {"bdb", "pdb", "ipdb", "pudb", "debugpy", "pydevd", "_pydevd_bundle", "_pydevd_sys_monitoring"}
)


@dataclass(frozen=True, slots=True)
class LoopStall(Event):
    """The event loop turns again after something kept it from turning."""

    duration_ns: int
    """From the last sign of life before it, at most 0.1 s too long."""
    blame: Blame


@dataclass(frozen=True, slots=True)
class LoopStalls:
    """How often the loop of a kernel did not turn for 0.2 s, and for how long in nanoseconds; by `watch_loop`."""

    count: int = 0
    total_ns: int = 0
    max_ns: int = 0
    last: Blame | None = None


class LoopWatch:
    """The watchdog of one kernel's loop."""

    def __init__(self, kernel: Kernel, limit: float, policy: str) -> None:
        self.stalls = LoopStalls()
        self.limit_ns = round(limit * 1e9)
        self.policy = policy
        self._kernel = kernel
        self._loop = kernel.loop
        self._thread_id = threading.get_ident()
        self._base = depth_beneath_task()
        self._lock = threading.Lock()
        self._beat_ns = time.monotonic_ns()
        self._due = (0, 0)
        """When the timer rings, and the processor time used when it was set."""
        self._traced = False
        self._stall: Blame | None = None
        self._said = 0
        """0: nothing; 1: that it does not turn; 2: that the limit is over."""
        self._handle: asyncio.TimerHandle | None = None
        self._good_until_ns = 0
        self._fd = -1
        self._timer: Timerfd | None = None
        self._finalizer: weakref.finalize[..., LoopWatch] | None = None

    def open(self) -> bool:
        """Begin; False where nothing can be watched: simulated time, or no timerfd."""
        timer = None if isinstance(self._kernel.clock, SimulatedClock) else timers._find_timerfd()
        if timer is None:
            return False
        try:
            self._fd = timer.create()
        except (OSError, NotImplementedError):
            return False
        self._timer = timer
        try:
            watcher.join(self)
        except (OSError, RuntimeError):
            os.close(self._fd)
            self._timer, self._fd = None, -1
            return False
        self._finalizer = weakref.finalize(self, watcher.leave, self._fd)
        self._beat()
        return True

    def close(self) -> None:
        """Watch no longer."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        self._timer = None
        if self._finalizer is not None:
            self._finalizer()

    # -- in the loop's thread --------------------------------------------------------------------------------------

    def _beat(self) -> None:
        now = time.monotonic_ns()
        with self._lock:
            began, self._beat_ns = self._beat_ns, now
            stall, self._stall, self._said = self._stall, None, 0
            self._traced = _is_debugger(sys.gettrace())
        timer = self._timer
        if timer is None:
            return  # closed, or the child of a fork
        self._set(timer, now + _SILENCE_NS)
        self._handle = self._loop.call_later(_BEAT, self._beat)
        if stall is not None:
            lasted, old = now - began, self.stalls
            blame = replace(stall, held_ns=lasted)
            self.stalls = LoopStalls(old.count + 1, old.total_ns + lasted, max(old.max_ns, lasted), blame)
            self._kernel.bus.publish(LoopStall(lasted, blame))

    def _set(self, timer: Timerfd, deadline_ns: int) -> None:
        with watcher.lock():  # closed, its descriptor may be somebody else's
            if self._timer is not None:
                self._due = (deadline_ns, time.process_time_ns())
                timer.set(self._fd, deadline_ns)

    # -- in the watcher's thread -----------------------------------------------------------------------------------

    def ring(self, timer: Timerfd) -> None:
        """No sign of life in time: look whether something keeps the loop."""
        now = time.monotonic_ns()
        due, cpu = self._due
        absent = now - due - (time.process_time_ns() - cpu)
        with self._lock:
            began = self._beat_ns
            if absent > _ABSENT_NS:
                # Stopped or suspended: from now on it has as long as ever.
                self._beat_ns = began = min(began + absent, now)
        if now - began < _SILENCE_NS:
            self._set(timer, began + _SILENCE_NS)
            return
        lines = _stack(self._thread_id)
        called = cut_at_loop(lines, self._base)
        if not called or self._traced or _debugged(lines):
            if called:
                with self._lock:
                    self._beat_ns = now  # at a debugger's prompt time does not count
            self._set(timer, now + _SILENCE_NS)
            return
        self._look(timer, began, now, lines, called)

    def _look(self, timer: Timerfd, began: int, now: int, lines: list[Line], called: Sequence[Line]) -> None:
        with self._lock:
            if self._beat_ns != began:
                return  # it turns again
            said, over = self._said, now - began >= self.limit_ns
            blame = self._stall = replace(self._blame(lines, called), held_ns=now - began)
            self._said = 2 if over else 1
        if not said or (over and said == 1):
            stack = " < ".join(f"{line.file}:{line.line} in {line.function}" for line in called[:_SHOWN])
            ends = over and self.policy == "exit"
            what = "has not turned" if over else "does not turn"
            end = f"; the process ends with status {EXIT_STATUS}" if ends else ""
            text = f"{self._kernel.name}: the event loop {what} for {(now - began) / 1e9:.2f} s"
            text = f"{text}: {blame}{end}; stack: {stack}"
            if ends:
                _end_process(text)
            _say(text)
        self._set(timer, began + self.limit_ns if not over else now + _SILENCE_NS)

    def _blame(self, lines: list[Line], called: Sequence[Line]) -> Blame:
        task = asyncio.current_task(self._loop)
        driver = getattr(task, "_aiorts_driver", None)
        member = None if driver is None else driver.current
        if member is not None:
            return _blame_hook(member, lines, "loop", "the loop")
        line = choose_line(called, None) or called[0]
        component = owner_of(task)
        return Blame("loop", "" if component is None else component.name, "", line.file, line.line, line.function)


def _say(text: str) -> None:
    """From a thread of its own: what keeps the loop may be a log handler, and hold its lock."""
    speaker = threading.Thread(target=_LOG.warning, args=("%s", text), name="aiorts loop watch", daemon=True)
    speaker.start()
    speaker.join(1.0)


def _end_process(text: str) -> None:
    """At once: nothing that is registered to run at exit, and no lock, may keep it from that."""
    os.write(2, f"{text}\n".encode(errors="backslashreplace"))
    os._exit(EXIT_STATUS)


def _debugged(lines: Sequence[Line]) -> bool:
    """Whether a debugger holds the process: at its prompt in this stack, or attached from outside."""
    if any(os.path.basename(line.file).removesuffix(".py") in _DEBUGGERS for line in lines):
        return True
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as status:
            return any(text.startswith("TracerPid:") and text.split()[1] != "0" for text in status)
    except OSError:
        return False


def _is_debugger(trace: Callable[..., object] | None) -> bool:
    """Whether a trace function is a debugger's; that of a coverage tool is not."""
    if trace is None:
        return False
    modules = {str(getattr(trace, "__module__", "")), type(getattr(trace, "__self__", None)).__module__}
    return any(module.split(".")[0] in _DEBUGGERS for module in modules)
