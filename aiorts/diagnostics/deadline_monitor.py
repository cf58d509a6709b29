"""Finds out why contexts miss deadlines: each has a timer that expires in another thread when it is late.

A context that is on time pays one comparison in most cycles and one system call now and then. One thread for each
process waits for all the timers without the interpreter lock; it runs only when a context is late, and then samples
what holds it up (`stack_sampler.py`), again and again at growing intervals. The thread exists while a context is
monitored. Without timerfd, and on a simulated clock, there are no samples, and the kernel's times of hooks alone are
judged.
"""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from aiorts.clock import SimulatedClock, SystemClock
from aiorts.diagnostics import monitor_thread
from aiorts.diagnostics.blame import Entry, Glance, judge
from aiorts.diagnostics.gc_pauses import Pauses
from aiorts.diagnostics.stack_sampler import books, depth_beneath_task, look
from aiorts.kernel.loop import timers
from aiorts.kernel.service import KernelService
from aiorts.model.blame import Blame, GcPauses

if TYPE_CHECKING:
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.loop.timers import _Timerfd as Timerfd
    from aiorts.kernel.microkernel import Microkernel

_NEVER: Final = 2**62
_LEAST_NS: Final = 100_000
_MOST_NS: Final = 2_000_000
"""How late a context is at the first sample: an eighth of its period within these bounds."""
_FAST_NS: Final = 2_000_000
_LAZY_NS: Final = 1_000_000
"""A context with a period shorter than the first value sets its timer once in the second; that delays its samples."""
_MANY: Final = 50
_SHORT_NS: Final = 200_000
_REST: Final = 20
"""If reading the times of all hooks takes longer than the first value, the next waits the second times as long."""
_SOON_NS: Final = 1_000_000_000
"""From so many contexts on, the times of all hooks are read at most once a second."""
_MOST_TIMERS: Final = 64
"""Descriptors are scarce: contexts beyond this number are judged by the times of hooks alone."""
_NONE: Final[list[Glance]] = []  # of a context without a timer: it never gets one
_GLANCES: Final = 24
"""Samples of one delay; the intervals double."""


class _Findings:
    """Results shared by the contexts of one loop: code that delayed one of them delayed them all."""

    def __init__(self) -> None:
        self.seen: dict[tuple[int, str], Entry] = {}
        self.last: tuple[int, Blame] | None = None
        self.walked_ns = -_SOON_NS
        """When the times of all hooks were read last."""
        self.walk_ns = 0
        """The duration of that reading."""

    def may_walk(self, now_ns: int, *, few: bool) -> bool:
        """Whether the times of all hooks may be read again: a slow reading would make the next cycle late."""
        rest_ns = (_REST * self.walk_ns if self.walk_ns > _SHORT_NS else 0) if few else _SOON_NS
        return now_ns - self.walked_ns >= rest_ns


def _that_matters(entry: Entry, before: Entry | None, longest_ns: int) -> int | None:
    """The duration of the run of a hook that may have delayed a context; None: it has not run, or began too early."""
    if before is not None and before.runs == entry.runs:
        return None
    # The longest run of the hook so far may be the cause, although it was not the last run.
    longest = entry.last_ns if before is None or before.max_ns == entry.max_ns else entry.max_ns
    return next((took for took in (longest, entry.last_ns) if took <= longest_ns), None)


class ContextTimer:
    """The deadline timer of one context; `arm`, `disarm` and `blame` are called by its thread and take no lock."""

    __slots__ = (
        "__weakref__",
        "_base",
        "_context",
        "_cpu_at",
        "_fd",
        "_finalizer",
        "_findings",
        "_glance_cpu",
        "_glances",
        "_good_until_ns",
        "_kernel",
        "_last",
        "_lazy_ns",
        "_monitor",
        "_pauses",
        "_period_ns",
        "_plain",
        "_seen",
        "_thread_id",
        "_timer",
        "_tolerance_ns",
        "due_ns",
        "real",
    )

    def __init__(self, monitor: DeadlineMonitor, context: Context, pauses: Pauses, findings: _Findings) -> None:
        kernel, thread_id = monitor.kernel, threading.get_ident()
        self.due_ns = _NEVER
        """When the next cycle is due, on the kernel's clock."""
        self._monitor = monitor
        self._kernel = kernel
        self._context = context
        self._thread_id = thread_id
        self._pauses = pauses
        self._good_until_ns = _NEVER
        self._tolerance_ns = _LEAST_NS
        self._lazy_ns = 0
        self._glances: list[Glance] = _NONE
        self._findings = findings
        self._seen: dict[tuple[int, str], Entry] | None = None
        self._last: tuple[int, Blame] | None = None
        self._cpu_at = self._glance_cpu = (0, 0)
        self._period_ns = _NEVER
        self._plain = type(kernel.clock) is SystemClock
        self.real = not isinstance(kernel.clock, SimulatedClock)
        self._fd = -1
        self._timer: Timerfd | None = None
        self._base = depth_beneath_task() if kernel.on_loop_thread() else 0
        if self.real:
            self._open()

    def _open(self) -> None:
        timer = None if monitor_thread.timer_count() >= _MOST_TIMERS else timers.find_timerfd()
        if timer is None:
            return
        try:
            fd = timer.create()
        except (OSError, NotImplementedError):
            return  # none left, or blocked by a sandbox: times of hooks alone
        self._fd, self._timer, self._good_until_ns = fd, timer, -1
        self._glances = []
        try:
            monitor_thread.join(self)
        except (OSError, RuntimeError):  # no descriptor or thread left: times of hooks alone
            os.close(fd)
            self._fd, self._timer, self._good_until_ns, self._glances = -1, None, _NEVER, _NONE
            return
        self._finalizer = weakref.finalize(self, monitor_thread.leave, fd)

    # -- in the thread of the context ------------------------------------------------------------------------------

    def period(self, period_ns: int) -> None:
        """Set the period, in nanoseconds of the kernel's clock, which decides how soon a delay is sampled."""
        self._period_ns = period_ns
        self._tolerance_ns = min(max(period_ns // 8, _LEAST_NS), _MOST_NS)
        self._lazy_ns = _LAZY_NS if period_ns < _FAST_NS else 0

    def arm(self, due_ns: int) -> None:
        """Record that a cycle begins in time; the next is due at `due_ns` of the kernel's clock."""
        self.due_ns = due_ns
        if due_ns > self._good_until_ns:
            self._rearm(due_ns)

    def disarm(self) -> None:
        """Record that nothing is due."""
        self.due_ns = _NEVER
        self._glances = []

    def _rearm(self, due_ns: int) -> None:
        timer = self._timer
        if timer is None:
            return
        if self._glances:
            self._glances = []
        now, good = time.monotonic_ns(), due_ns + self._lazy_ns
        try:
            timer.set(self._fd, self._alarm_ns(good, now))
        except OSError:
            self._good_until_ns = _NEVER
            return
        self._good_until_ns = good
        self._cpu_at = (now, time.process_time_ns())

    def _alarm_ns(self, due_ns: int, now_ns: int) -> int:
        real = due_ns if self._plain else self._kernel.clock.real_deadline_ns(due_ns)
        return max(real, now_ns) + self._tolerance_ns

    def blame(self, now_ns: int, due_ns: int | None = None) -> Blame | None:
        """The cause that what was due at `due_ns` (as given to `arm`) had not begun at `now_ns`.

        Both on the kernel's clock, in nanoseconds; None when it is not late.
        """
        due = self.due_ns if due_ns is None else due_ns
        late = now_ns - due
        if late <= 0 and due_ns is None:
            return None
        for last in (self._last, self._findings.last):
            if last is not None and due < last[0]:
                # This cycle was due before the last blame was found: the same cause made both cycles late.
                return self._as_seen_here(last[1])
        blame = self._judge(due, now_ns)
        self._last = (now_ns, blame)
        if self._context.exclusive or blame.held != "its context":
            self._findings.last = (now_ns, blame)
        return blame

    def _as_seen_here(self, blame: Blame) -> Blame:
        """The blame as seen from this context: whether the hook that held the loop is its own, or another context's."""
        if blame.kind not in ("hook", "loop") or not blame.hook:
            return blame
        own = any(member.component.name == blame.component for member in self._context.runner.members)
        return replace(blame, kind="hook" if own else "loop")

    def _judge(self, due_ns: int, now_ns: int) -> Blame:
        kernel = self._kernel
        entries = self._fresh_entries(now_ns - due_ns)
        if not self.real:
            return judge(due_ns, now_ns, (), (), entries)
        now = time.monotonic_ns()
        speed = kernel.clock.speed
        late = int((now_ns - due_ns) / speed)
        began, used = self._cpu_at if self._timer is not None else (0, 0)
        absent = max(0, min(now - began, late) - (time.process_time_ns() - used)) if began else 0
        return judge(now - late, now, tuple(self._glances), tuple(self._pauses.recent), entries, absent)

    def _fresh_entries(self, late_ns: int) -> list[Entry]:
        """The times of hooks that have run since the last call."""
        findings, now = self._findings, time.monotonic_ns()
        few = self._context.exclusive or len(self._kernel.contexts) < _MANY
        whole = not self.real or findings.may_walk(now, few=few)
        if not whole and len(self._context.runner.members) > _MANY:
            return []
        # With few contexts each reads the times itself; with many, one reading is shared by all.
        known = (self._seen or {}) if few else findings.seen
        now_known = {} if whole else known  # hooks of removed members are dropped
        fresh = []
        for member, entry in books(self._kernel, self._context, whole=whole):
            key = id(member), entry.blame.hook
            before = known.get(key)
            now_known[key] = entry
            took = _that_matters(entry, before, late_ns + self._period_ns)
            if took is not None:
                fresh.append(entry._replace(last_ns=took))
        if few:
            self._seen = now_known
        else:
            findings.seen = now_known
        if whole:
            findings.walked_ns, findings.walk_ns = now, time.monotonic_ns() - now
        return fresh

    def close(self) -> None:
        """Close the timer: the context has stopped. In any thread."""
        self.due_ns = self._good_until_ns = _NEVER
        self._glances = []
        if self._timer is not None:
            self._timer = None
            self._finalizer()
        self._monitor.release(self)

    # -- in the monitor thread -------------------------------------------------------------------------------------

    def ring(self, timer: Timerfd) -> None:
        """Sample what holds the context up, unless it is in time: the timer has expired."""
        kernel, due = self._kernel, self.due_ns
        if self._timer is None or due >= _NEVER:
            return
        now, used = time.monotonic_ns(), time.process_time_ns()
        since = kernel.clock.real_deadline_ns(due)
        if now < since + self._tolerance_ns:
            self._set(timer, self._alarm_ns(due + self._lazy_ns, now))
            return
        glances = self._glances
        # On time it would have rung at the tolerance, or at twice the delay of the glance before.
        before = glances[-1].at_ns if glances else 0
        expected = before + max(before - since, _LEAST_NS) if glances else since + self._tolerance_ns + self._lazy_ns
        began, cpu = self._glance_cpu if glances else self._cpu_at
        glance = look(kernel, self._context, self._thread_id, self._base, now)
        if self.due_ns != due:
            return  # it has gone on meanwhile
        absent = max(0, now - max(expected, began) - (used - cpu))
        if len(glances) < _GLANCES:
            glances.append(glance._replace(absent_ns=absent))
            self._glance_cpu = (now, used)
            self._set(timer, now + max(now - since, _LEAST_NS))

    def _set(self, timer: Timerfd, deadline_ns: int) -> None:
        with monitor_thread.lock():  # closed, its descriptor may be in other use
            if self._timer is not None:
                timer.set(self._fd, deadline_ns)


class DeadlineMonitor(KernelService):
    """Finds the causes of late contexts of this kernel, and counts garbage collections meanwhile."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._pauses = Pauses()
        # Releases the callback of a kernel that was never closed.
        weakref.finalize(kernel, self._pauses.stop).atexit = False
        self._monitored = 0
        self._findings = _Findings()

    @property
    def gc_pauses(self) -> Mapping[int, GcPauses]:
        """Garbage collections by generation, while a context was monitored."""
        return self._pauses.statistics

    def monitor(self, context: Context) -> ContextTimer:
        """Monitor a context from the thread that runs it, until the result is closed."""
        findings = _Findings() if context.exclusive else self._findings
        timer = ContextTimer(self, context, self._pauses, findings)
        if timer.real:
            with monitor_thread.lock():
                self._monitored += 1
                self._pauses.listen()
        return timer

    def release(self, timer: ContextTimer) -> None:
        """End monitoring: the context has stopped. In any thread."""
        with monitor_thread.lock():
            self._monitored -= timer.real
            if not self._monitored:
                self._pauses.stop()
