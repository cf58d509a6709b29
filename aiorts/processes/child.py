"""The first act of a child's program: a thread that ends it and its descendants with the helper process.

The helper holds the only writing end of a pipe. When that reports end-of-file, a thread kills all that descends from
this process, then the process itself.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from typing import Final

from aiorts.errors import ProcessError
from aiorts.processes.tree import HAS_PROC, adopt_orphans, ask_at_parents_end, children, kill_trees

DESCRIPTOR: Final = 3
"""The number that the descriptor given to `Launcher.start` has in the child."""
_LIVENESS: Final = 4
PARENT: Final = "AIORTS_HELPER"
"""The environment variable with the process that started this one; `prepare` removes the variable."""
_KILLING: Final = 2.0
"""Seconds that are spent on descendants which go on starting others."""


def prepare() -> None:
    """Make this process end, with its descendants, when the helper does. The first call of a child's program.

    Raises:
        ProcessError: this process was not started by a `Launcher`.
    """
    parent = int(os.environ.pop(PARENT, "0"))
    if not parent:
        raise ProcessError(f"{PARENT} is not set: this program is started by aiorts alone")
    for inherited in (DESCRIPTOR, _LIVENESS):
        os.set_inheritable(inherited, False)
    adopt_orphans()
    # SIGKILL would be faster than the thread, and what this process has started would stay. SIGCONT, which does
    # nothing else, lets the thread of a process run that was stopped.
    ask_at_parents_end(signal.SIGCONT)
    if os.getppid() != parent:
        os._exit(1)  # it ended before it could be asked for
    threading.Thread(target=_end_with_parent, name="aiorts-liveness", daemon=True).start()


def _end_with_parent() -> None:
    os.read(_LIVENESS, 1)
    until = time.monotonic() + _KILLING
    while (found := list(children(os.getpid()))) and time.monotonic() < until:
        kill_trees(found)
        for pid in found:
            with contextlib.suppress(ChildProcessError):  # another thread waits for it
                os.waitpid(pid, os.WNOHANG)
        time.sleep(0.001)
    if HAS_PROC:
        os._exit(1)
    os.killpg(0, signal.SIGKILL)


def limit_memory(size: int) -> None:
    """Limit this process to `size` more bytes of address space than it has now; beyond that it gets MemoryError.

    Raises:
        ProcessError: the system refuses.
    """
    try:
        import resource  # late: not every system has it

        with open("/proc/self/statm", encoding="ascii") as file:
            now = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + size, now + size))
    except (ImportError, OSError, OverflowError, ValueError) as error:
        raise ProcessError(f"limits.memory = {size}: the system refuses: {error}") from None
