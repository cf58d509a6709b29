"""Measures how long threads were ready to run while the machine ran others, by the system's count for each thread.

A hook that was running when the processor was taken away is blamed for the delay (`aiorts.diagnostics.blame`); these
counts tell what the delay would have been otherwise. All threads of the process are counted: a thread that is stopped
while it has the interpreter lock stops the others. On a system without such counts nothing is known.
"""

from __future__ import annotations

import os
import time
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import asyncio

_THREADS: Final = "/proc/self/task"
"""The folder of Linux with a folder for each thread. The file `schedstat` in it has the time on a processor and the
time of waiting for a processor, both in nanoseconds, and how often the thread got a processor."""
_EVERY: Final = 0.02
"""Seconds between two looks; each late cycle is a look, too."""
_KEPT: Final = 256


class Stalls:
    """The stalls of this process's threads while this object is open; it looks on a loop, at intervals."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._per_thread: dict[str, tuple[int, int]] = {}
        """For each thread its file, and the last count in it."""
        self.total_ns = 0
        """Nanoseconds that all threads together were stalled since this object was made, by the last look."""
        self._looks: deque[tuple[int, int]] = deque(maxlen=_KEPT)
        """The last looks: the real time, and the total by then."""
        self._timer: asyncio.TimerHandle | None = None
        if os.path.isdir(_THREADS):
            self._look_again()

    def close(self) -> None:
        """End the looks. Idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for file, _ in self._per_thread.values():
            os.close(file)
        self._per_thread.clear()

    def look(self) -> int:
        """Read the counts now; return the total, 0 if the system has no such counts."""
        if self._timer is not None:
            self._count()
            self._looks.append((time.monotonic_ns(), self.total_ns))
        return self.total_ns

    def since(self, real_ns: int) -> int:
        """Nanoseconds that threads were stalled since the last look before this moment of real time."""
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
                continue  # the thread has ended meanwhile
            now = _stalled_ns(file)
            threads[name] = file, now
            if known is not None:
                self.total_ns += max(0, now - known[1])


def _stalled_ns(file: int) -> int:
    try:
        return int(os.pread(file, 128, 0).split()[1])
    except (OSError, ValueError, IndexError):
        return 0  # the thread has ended meanwhile, or the system does not count
