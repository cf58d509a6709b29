"""Finds the descendants of a process, and sets what Linux does with processes that lose their parent.

Where there is no /proc, as on macOS, only the group of a process is known: what has left it is not found.
"""

from __future__ import annotations

import contextlib
import os
import signal

from aiorts.late import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36
_ROUNDS = 1000
"""After so many rounds a process that starts others counts as another user's, which cannot be stopped."""
HAS_PROC = os.path.exists("/proc/self/task")


def adopt_orphans() -> None:
    """Become the parent of each descendant whose own parent ends, if the system can. For the whole process."""
    _prctl(_SET_CHILD_SUBREAPER, 1)


def ask_at_parents_end(number: int) -> None:
    """Ask for a signal at the end of the thread that started this process, if the system supports that."""
    _prctl(_SET_PDEATHSIG, number)


def _prctl(option: int, value: int) -> None:
    if not HAS_PROC:
        return
    import ctypes  # late: 3 ms

    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def children(pid: int) -> Iterator[int]:
    """The children of a process, also those that have ended and were not waited for.

    While children come and go, one may be missing: ask again until there are none.
    """
    try:
        threads = os.listdir(f"/proc/{pid}/task")
    except OSError:
        return
    for thread in threads:
        try:
            with open(f"/proc/{pid}/task/{thread}/children", encoding="ascii") as file:
                yield from map(int, file.read().split())
        except OSError:
            continue  # the thread has ended; its children are another thread's


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    """Send a signal; a process that has ended, or belongs to another user by now, is left alone."""
    try:
        os.kill(pid, number)
    except (ProcessLookupError, PermissionError):
        return


def kill_trees(roots: Iterable[int]) -> None:
    """Kill processes and all that descend from them.

    All are stopped before the first is killed: killing alone never caught up with 400 processes that started one
    another. A stopped process starts none, and leaves the processor to this one.
    """
    found: dict[int, None] = {}  # in the order in which they were found
    roots = new = before = [*roots]
    for _ in range(_ROUNDS):
        for pid in new:
            kill(pid, signal.SIGSTOP)
            found[pid] = None
        # Where one that was just stopped had begun to start another, that is seen in the next round; and what has lost
        # its parent is a child of a root. To look at all of them in each round took longer than they to start others.
        before, looked_at = new, {*roots, *before, *new}
        new = [child for pid in looked_at for child in children(pid) if child not in found]
        new = new or [child for pid in found for child in children(pid) if child not in found]
        if not new:
            break
    for pid in found:
        if not HAS_PROC:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)
        kill(pid)


@contextlib.contextmanager
def first_in_line() -> Iterator[None]:
    """A block in which this process has priority over all others, where the system allows it, as it does to root.

    The process competes with up to 200 that start others all the time: without priority its share is a hundredth.
    """
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except (AttributeError, OSError):
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def started(pid: int) -> int:
    """When a process began, in ticks since the machine started; 0: there is none. Tells it from a later one."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            return int(file.read().rpartition(")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return 0
