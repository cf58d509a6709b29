"""How long threads were ready to run while the machine ran others, as the system counts it for each thread.

A hook that was running when the processor was taken away is blamed for the delay (`aiorts.diagnostics.blame`); by these
counts it is known what the delay would have been without. All threads of the process are counted: one that is stopped
while it has the interpreter lock stops the others. On a system that does not count it, nothing is known.
"""

from __future__ import annotations

import os
import time
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import asyncio

_THREADS: Final = "/proc/self/task"
"""Of Linux: a folder for each thread; in its file `schedstat` is the time that it was on a processor, the time that it
waited for one, in nanoseconds, and how often it had one."""
_EVERY: Final = 0.02
"""Seconds between two looks; beside them each late cycle is one."""
_KEPT: Final = 256


class Stalls:
    """What was counted of the threads of this process while this was open; on a loop, for which it looks."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._per_thread: dict[str, tuple[int, int]] = {}
        """For each its file, and what was counted there last."""
        self.total_ns = 0
        """How long they have been stalled since this was made, all together, in nanoseconds, by the last look."""
        self._looks: deque[tuple[int, int]] = deque(maxlen=_KEPT)
        """When, in real time, and how long they had been stalled by then."""
        self._timer: asyncio.TimerHandle | None = None
        if os.path.isdir(_THREADS):
            self._look_again()

    def close(self) -> None:
        """Look no more; idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for file, _ in self._per_thread.values():
            os.close(file)
        self._per_thread.clear()

    def look(self) -> int:
        """The total by now; 0 where nothing is known."""
        if self._timer is not None:
            self._count()
            self._looks.append((time.monotonic_ns(), self.total_ns))
        return self.total_ns

    def since(self, real_ns: int) -> int:
        """How long they were stalled from this moment on, and from the look before it, in nanoseconds."""
        now = self.look()
        if not self._looks:
            return 0
        before = next((look for look in reversed(self._looks) if look[0] <= real_ns), self._looks[0])
        return now - before[1]

    def _look_again(self) -> None:
        self._timer = self._loop.call_later(_EVERY, self._look_again)
        self.look()

    def _count(self) -> None:
        threads = self._per_thread
        try:
            there = os.listdir(_THREADS)
        except OSError:
            return  # no file can be opened at the moment
        for name in threads.keys() - set(there):
            os.close(threads.pop(name)[0])
        for name in there:
            known = threads.get(name)
            try:
                file = (
                    os.open(f"{_THREADS}/{name}/schedstat", os.O_RDONLY | os.O_CLOEXEC) if known is None else known[0]
                )
            except OSError:
                continue  # it has ended meanwhile
            now = _stalled_ns(file)
            threads[name] = file, now
            if known is not None:
                self.total_ns += max(0, now - known[1])


def _stalled_ns(file: int) -> int:
    try:
        return int(os.pread(file, 128, 0).split()[1])
    except (OSError, ValueError, IndexError):
        return 0  # it has ended meanwhile, or the system does not count
