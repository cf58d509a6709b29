"""Watches contexts for missed deadlines: a deadman timer for each, which rings in another thread when one is late.

A context that is on time pays one comparison in most cycles and one system call now and then. One thread for each
process waits on all the timers without the interpreter lock; it runs only when a context is late, and then looks at
what keeps it (`witness.py`), again and again at growing intervals. It is there while a context is watched. Where there
is no timerfd, and on a simulated clock, nobody looks and the kernel's books alone are judged.
"""

from __future__ import annotations

import logging
import os
import time
import weakref
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from aiorts.clock import SimulatedClock, SystemClock
from aiorts.kernel import timers, watcher
from aiorts.kernel.blame import Entry, Glance, judge
from aiorts.kernel.pauses import Pauses
from aiorts.kernel.witness import books, depth_beneath_task, look
from aiorts.model.blame import Blame, GcPauses

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.timers import _Timerfd as Timerfd

__all__ = ("Deadman", "DeadlineWatch")

_LOG = logging.getLogger("aiorts.kernel")
_NEVER: Final = 2**62
_LEAST_NS: Final = 100_000
_MOST_NS: Final = 2_000_000
"""How late a context is when it is first looked at: an eighth of its period within these bounds."""
_FAST_NS: Final = 2_000_000
_LAZY_NS: Final = 1_000_000
"""A context with a shorter period than the first re-arms its timer once in the second; it is looked at later by it."""
_MANY: Final = 50
_SHORT_NS: Final = 200_000
_REST: Final = 20
"""A walk through the books that was longer than the first is followed by a rest of so many times its length."""
_SOON_NS: Final = 1_000_000_000
"""With so many contexts all books are gone through once in a second at the most."""
_MOST_TIMERS: Final = 64
"""Descriptors are scarce: the contexts beyond are judged by the books alone."""
_NONE: Final[list[Glance]] = []  # of a watch without a timer: nobody adds one
_GLANCES: Final = 24
"""Of one delay; the intervals double."""


class _Findings:
    """What was found out already, shared by the contexts of one loop: what held one of them held them all."""

    def __init__(self) -> None:
        self.seen: dict[tuple[int, str], Entry] = {}
        self.last: tuple[int, Blame] | None = None
        self.walked_ns = -_SOON_NS
        """When all books were gone through last."""
        self.walk_ns = 0
        """How long that took."""

    def may_walk(self, now_ns: int, *, few: bool) -> bool:
        """Whether all books may be gone through again: if that took long it would make the next cycle late."""
        rest_ns = (_REST * self.walk_ns if self.walk_ns > _SHORT_NS else 0) if few else _SOON_NS
        return now_ns - self.walked_ns >= rest_ns


def _that_matters(entry: Entry, before: Entry | None, longest_ns: int) -> int | None:
    """How long the run of a hook took that may have held somebody up; None: it has not run, or began too early."""
    if before is not None and before.runs == entry.runs:
        return None
    # The longest run there ever was may have been the one that did it, though it was not the last.
    longest = entry.last_ns if before is None or before.max_ns == entry.max_ns else entry.max_ns
    return next((took for took in (longest, entry.last_ns) if took <= longest_ns), None)


class DeadlineWatch:
    """The deadman of one context; `arm`, `disarm` and `blame` are for the thread that runs it, and take no lock."""

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
        "_pauses",
        "_period_ns",
        "_plain",
        "_real",
        "_seen",
        "_thread_id",
        "_timer",
        "_tolerance_ns",
        "due_ns",
    )

    def __init__(self, kernel: Kernel, context: Context, thread_id: int, pauses: Pauses, findings: _Findings) -> None:
        self.due_ns = _NEVER
        """When the next cycle is due, on the kernel's clock."""
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
        self._real = not isinstance(kernel.clock, SimulatedClock)
        self._fd = -1
        self._timer: Timerfd | None = None
        self._base = depth_beneath_task() if thread_id == kernel._thread_id else 0
        if self._real:
            self._open()

    def _open(self) -> None:
        timer = None if watcher.watched() >= _MOST_TIMERS else timers._find_timerfd()
        if timer is None:
            return
        try:
            fd = timer.create()
        except (OSError, NotImplementedError):
            return  # none left, or blocked by a sandbox: the books alone
        self._fd, self._timer, self._good_until_ns = fd, timer, -1
        self._glances = []
        try:
            watcher.join(self)
        except (OSError, RuntimeError):  # no descriptor or thread left: the books alone
            os.close(fd)
            self._fd, self._timer, self._good_until_ns, self._glances = -1, None, _NEVER, _NONE
            return
        self._finalizer = weakref.finalize(self, watcher.leave, fd)

    # -- in the thread of the context ------------------------------------------------------------------------------

    def period(self, period_ns: int) -> None:
        """How long a period is, in nanoseconds of the kernel's clock: it says how soon a delay is looked at."""
        self._period_ns = period_ns
        self._tolerance_ns = min(max(period_ns // 8, _LEAST_NS), _MOST_NS)
        self._lazy_ns = _LAZY_NS if period_ns < _FAST_NS else 0

    def arm(self, due_ns: int) -> None:
        """A cycle begins in time; the next is due at `due_ns` of the kernel's clock, whatever happens in between."""
        self.due_ns = due_ns
        if due_ns > self._good_until_ns:
            self._rearm(due_ns)

    def disarm(self) -> None:
        """Nothing is due."""
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
        """Who is to blame that what was due at `due_ns` (what it was armed for) had not begun at `now_ns`.

        Both on the kernel's clock, in nanoseconds; None when it is not late.
        """
        due = self.due_ns if due_ns is None else due_ns
        late = now_ns - due
        if late <= 0 and due_ns is None:
            return None
        for last in (self._last, self._findings.last):
            if last is not None and due < last[0]:
                # Due before the last blame was found: what made that cycle late made this one late as well.
                return self._as_seen_here(last[1])
        blame = self._judge(due, now_ns)
        self._last = (now_ns, blame)
        if self._context.exclusive or blame.held != "its context":
            self._findings.last = (now_ns, blame)
        return blame

    def _as_seen_here(self, blame: Blame) -> Blame:
        """A hook that held the loop is one of this context's own, or another's."""
        if blame.kind not in ("hook", "loop") or not blame.hook:
            return blame
        own = any(member.component.name == blame.component for member in self._context._members)
        return replace(blame, kind="hook" if own else "loop")

    def _judge(self, due_ns: int, now_ns: int) -> Blame:
        kernel = self._kernel
        entries = self._fresh_entries(now_ns - due_ns)
        if not self._real:
            return judge(due_ns, now_ns, (), (), entries)
        now = time.monotonic_ns()
        speed = kernel.clock.speed
        late = int((now_ns - due_ns) / speed)
        began, used = self._cpu_at if self._timer is not None else (0, 0)
        absent = max(0, min(now - began, late) - (time.process_time_ns() - used)) if began else 0
        return judge(now - late, now, tuple(self._glances), tuple(self._pauses.recent), entries, absent)

    def _fresh_entries(self, late_ns: int) -> list[Entry]:
        """The books of hooks that have run since they were last asked for."""
        findings, now = self._findings, time.monotonic_ns()
        few = self._context.exclusive or len(self._kernel._contexts) < _MANY
        whole = not self._real or findings.may_walk(now, few=few)
        if not whole and len(self._context._members) > _MANY:
            return []
        # With few contexts each has read the books for itself; with many, what one has read is old news to all.
        known = (self._seen or {}) if few else findings.seen
        now_known = {} if whole else known  # who has left is forgotten
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
        """The context has stopped. In any thread."""
        self.due_ns = self._good_until_ns = _NEVER
        self._glances = []
        if self._timer is not None:
            self._timer = None
            self._finalizer()

    # -- in the watcher's thread -----------------------------------------------------------------------------------

    def ring(self, timer: Timerfd) -> None:
        """The timer has expired: look at what keeps the context, unless it is in time."""
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
        with watcher.lock():  # closed, its descriptor may be somebody else's
            if self._timer is not None:
                timer.set(self._fd, deadline_ns)


class Deadman:
    """What a kernel has to watch its contexts with."""

    def __init__(self, kernel: Kernel) -> None:
        self._pauses = Pauses()
        # For a kernel that nobody closed.
        weakref.finalize(kernel, self._pauses.stop).atexit = False
        self._watching = 0
        self._findings = _Findings()

    @property
    def gc_pauses(self) -> Mapping[int, GcPauses]:
        """Garbage collections by generation, while a context was watched."""
        return self._pauses.statistics

    def watch(self, context: Context, thread_id: int) -> DeadlineWatch:
        """Watch a context that is run by this thread; called there. Ends with `unwatch`, which any thread may call."""
        findings = _Findings() if context.exclusive else self._findings
        watch = DeadlineWatch(context._require_kernel(), context, thread_id, self._pauses, findings)
        if watch._real:
            with watcher.lock():
                self._watching += 1
                self._pauses.listen()
        return watch

    def unwatch(self, watch: DeadlineWatch) -> None:
        """The context has stopped."""
        watch.close()
        with watcher.lock():
            self._watching -= watch._real
            if not self._watching:
                self._pauses.stop()
