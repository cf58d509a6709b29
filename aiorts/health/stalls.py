"""How long a thread was ready to run while the machine ran others, as the system counts it for each thread.

A hook that was running when the processor was taken away is blamed for the delay (`aiorts.diagnostics.blame`); by these
counts it is known what the delay would have been without. On a system that does not count it, nothing is known.
"""

from __future__ import annotations

import os
import time
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import asyncio

_COUNTS: Final = "/proc/thread-self/schedstat"
"""Of Linux: time on a processor, time in which it waited for one, in nanoseconds, and how often it had one."""
_EVERY: Final = 0.02
"""Seconds between two looks; beside them each late cycle is one."""
_KEPT: Final = 256


class Stalls:
    """What was counted of the loop's thread while this was open; made and used in that thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._looks: deque[tuple[int, int]] = deque(maxlen=_KEPT)
        """When, in real time, and how long it had been stalled by then."""
        self._timer: asyncio.TimerHandle | None = None
        try:
            self._file = os.open(_COUNTS, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
        except OSError:
            self._file = -1
        else:
            self._look_again()

    def close(self) -> None:
        """Look no more; idempotent."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def look(self) -> int:
        """How long this thread has been stalled up to now, in nanoseconds; 0 where that is not known."""
        if self._file < 0:
            return 0
        try:
            stalled_ns = int(os.pread(self._file, 128, 0).split()[1])
        except (OSError, ValueError, IndexError):
            return 0
        self._looks.append((time.monotonic_ns(), stalled_ns))
        return stalled_ns

    def since(self, real_ns: int) -> int:
        """How long it was stalled from this moment on, and from the look before it, in nanoseconds."""
        now = self.look()
        if not self._looks:
            return 0
        before = next((look for look in reversed(self._looks) if look[0] <= real_ns), self._looks[0])
        return now - before[1]

    def _look_again(self) -> None:
        self.look()
        self._timer = self._loop.call_later(_EVERY, self._look_again)
