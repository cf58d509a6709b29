"""Notices when an event loop does not turn, and names the code that holds it, with its line, while it still does.

The loop sets a timer forward ten times a second; the thread that waits for the timers of all contexts
(`monitor_thread.py`, without the interpreter lock) wakes when the loop did not, and samples what the loop's thread
runs. It reports nothing while a debugger holds the process; time in which the whole process did not run (stopped,
suspended, starved) does not count.
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Literal

from aiorts.clock import SimulatedClock, to_ns
from aiorts.diagnostics import monitor_thread
from aiorts.diagnostics.blame import Line, choose_line, cut_at_loop
from aiorts.diagnostics.rarely import Rarely
from aiorts.diagnostics.stack_sampler import _blame_hook, _stack, depth_beneath_task
from aiorts.exits import STALLED
from aiorts.kernel.loop import timers
from aiorts.kernel.loop.bus import ContextStarted, Event
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import owner_of
from aiorts.kernel.service import KernelService, check_settings, setting
from aiorts.late import dataclass
from aiorts.model.blame import Blame

if TYPE_CHECKING:
    from aiorts.kernel.loop.timers import _Timerfd as Timerfd
    from aiorts.kernel.microkernel import Microkernel

_LOG = KernelLog()
EXIT_STATUS: Final = STALLED
_BEAT: Final = 0.1
"""Seconds between two signs of life."""
_SILENCE_NS: Final = 200_000_000
"""Without a sign of life for so long the loop is sampled."""
_ABSENT_NS: Final = 50_000_000
"""If the thread wakes this much too late and no processor time was used meanwhile, the whole process did not run."""
_SHOWN: Final = 12
"""Frames in the line of the log."""
_DEBUGGERS: Final = frozenset(
    {"bdb", "pdb", "ipdb", "pudb", "debugpy", "pydevd", "_pydevd_bundle", "_pydevd_sys_monitoring"}
)


@dataclass(frozen=True, slots=True)
class LoopStall(Event):
    """Published when the event loop turns again after some code kept it from turning."""

    duration_ns: int
    """The time since the last sign of life before the stall, so that it is at most 0.1 s too long."""
    blame: Blame


@dataclass(frozen=True, slots=True)
class LoopStalls:
    """How often the event loop stood still for 0.2 s or more, and for how long; counted by `watch_loop`."""

    count: int = 0
    total_ns: int = 0
    max_ns: int = 0
    """The longest stall."""
    last: Blame | None = None
    """The code that held the loop last."""


@dataclass(frozen=True, slots=True)
class LoopLimit:
    """The settings of `aiorts run` for code that keeps the event loop from turning."""

    limit: float = setting(5.0, "Time until policy comes into force.", unit="s", above=0)
    policy: Literal["warn", "exit"] = setting("warn", "warn: say so; exit: end the process at once with status 70.")

    def __post_init__(self) -> None:
        check_settings(self)


class LoopMonitor(KernelService):
    """Monitors the loop of a kernel, once `Kernel.watch_loop` requests it; by its settings, once a context runs."""

    name = "watch_loop"
    settings = LoopLimit

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._loop_timer: LoopTimer | None = None

    @property
    def stalls(self) -> LoopStalls:
        """How often and how long the loop did not turn since monitoring began."""
        return LoopStalls() if self._loop_timer is None else self._loop_timer.stalls

    def configure(self, settings: LoopLimit) -> None:
        def monitor(_event: ContextStarted) -> None:
            unsubscribe()
            self.monitor(settings)

        # Monitoring begins when a context runs: while a system is made, its code may hold the loop.
        unsubscribe = self.kernel.bus.subscribe(ContextStarted, monitor)

    def report(self) -> Mapping[str, Any]:
        stalls = self.stalls
        if self._loop_timer is None:
            return {}
        return {name: getattr(stalls, name) for name in ("count", "total_ns", "max_ns")}

    def monitor(self, given: LoopLimit) -> bool:
        """See `Kernel.watch_loop`."""
        if self._loop_timer is not None:
            self._loop_timer.limit_ns, self._loop_timer.policy = to_ns(given.limit), given.policy
            return True
        monitor = LoopTimer(self.kernel, given.limit, given.policy)
        if not monitor.open():
            return False
        self._loop_timer = monitor
        return True

    def closed(self) -> None:
        if self._loop_timer is not None:
            self._loop_timer.close()


class LoopTimer:
    """The timer of one kernel's loop."""

    def __init__(self, kernel: Microkernel, limit: float, policy: str) -> None:
        self.stalls = LoopStalls()
        self.limit_ns = to_ns(limit)
        self.policy = policy
        self._kernel = kernel
        self._loop = kernel.loop
        self._thread_id = threading.get_ident()
        self._base = depth_beneath_task()
        self._lock = threading.Lock()
        self._beat_ns = time.monotonic_ns()
        self._due = (0, 0)
        """When the timer expires, and the processor time used when it was set."""
        self._traced = False
        self._stall: Blame | None = None
        self._logged = 0
        """0: nothing; 1: that it does not turn; 2: that the limit is over."""
        self._lines = Rarely()
        self._handle: asyncio.TimerHandle | None = None
        self._good_until_ns = 0
        self._fd = -1
        self._timer: Timerfd | None = None
        self._finalizer: weakref.finalize[..., LoopTimer] | None = None

    def open(self) -> bool:
        """Begin; False where nothing can be monitored: simulated time, or no timerfd."""
        timer = None if isinstance(self._kernel.clock, SimulatedClock) else timers.find_timerfd()
        if timer is None:
            return False
        try:
            self._fd = timer.create()
        except (OSError, NotImplementedError):
            return False
        self._timer = timer
        try:
            monitor_thread.join(self)
        except (OSError, RuntimeError):
            os.close(self._fd)
            self._timer, self._fd = None, -1
            return False
        self._finalizer = weakref.finalize(self, monitor_thread.leave, self._fd)
        self._beat()
        return True

    def close(self) -> None:
        """End monitoring."""
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
            stall, self._stall, self._logged = self._stall, None, 0
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
        with monitor_thread.lock():  # closed, its descriptor may be in other use
            if self._timer is not None:
                self._due = (deadline_ns, time.process_time_ns())
                timer.set(self._fd, deadline_ns)

    # -- in the monitor thread -------------------------------------------------------------------------------------

    def ring(self, timer: Timerfd) -> None:
        """Sample what holds the loop: there was no sign of life in time."""
        now = time.monotonic_ns()
        due, cpu = self._due
        absent = now - due - (time.process_time_ns() - cpu)
        with self._lock:
            began = self._beat_ns
            if absent > _ABSENT_NS:
                # The process was stopped or suspended: the time allowed to the loop begins again.
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
            logged, over = self._logged, now - began >= self.limit_ns
            blame = self._stall = replace(self._blame(lines, called), held_ns=now - began)
            self._logged = 2 if over else 1
        if not logged or (over and logged == 1):
            self._say(blame, called, now, over=over)
        self._set(timer, began + self.limit_ns if not over else now + _SILENCE_NS)

    def _say(self, blame: Blame, called: Sequence[Line], now: int, *, over: bool) -> None:
        """Log that the loop stands still; for the same cause again only at growing intervals."""
        ends = over and self.policy == "exit"
        held = (blame.component, blame.hook) if blame.hook else (blame.file, blame.function)
        left_out = self._lines.left_out((over, *held), now)
        if left_out is None and not ends:
            return
        stack = " < ".join(f"{line.file}:{line.line} in {line.function}" for line in called[:_SHOWN])
        what = "has not turned" if over else "does not turn"
        end = f"; the process ends with status {EXIT_STATUS}" if ends else ""
        more = f"; {left_out} such lines were left out before" if left_out else ""
        text = f"{self._kernel.name}: the event loop {what} for {blame.held_ns / 1e9:.2f} s"
        text = f"{text}: {blame}{end}{more}; stack: {stack}"
        if ends:
            _end_process(text)
        _log(text)

    def _blame(self, lines: list[Line], called: Sequence[Line]) -> Blame:
        task = asyncio.current_task(self._loop)
        driver = getattr(task, "_aiorts_driver", None)
        member = None if driver is None else driver.current
        if member is not None:
            return _blame_hook(member, lines, "loop", "the loop")
        line = choose_line(called, None) or called[0]
        component = owner_of(task)
        return Blame("loop", "" if component is None else component.name, "", line.file, line.line, line.function)


def _log(text: str) -> None:
    """Log from a thread of its own: a log handler may hold the loop, and its own lock."""
    speaker = threading.Thread(target=_LOG.warning, args=("%s", text), name="aiorts loop monitor", daemon=True)
    speaker.start()
    speaker.join(1.0)


def _end_process(text: str) -> None:
    """End the process at once, without exit handlers and locks that might prevent it."""
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
    """Whether a trace function is a debugger's; a coverage tool's is not."""
    if trace is None:
        return False
    modules = {str(getattr(trace, "__module__", "")), type(getattr(trace, "__self__", None)).__module__}
    return any(module.split(".")[0] in _DEBUGGERS for module in modules)
