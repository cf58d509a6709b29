"""Notices that calls wait for a thread of the pool, and says so once until none waits any more.

Looked at once a second while a context runs; nothing is asked in between and no call is ever held up.
"""

from __future__ import annotations

import asyncio
import weakref
from typing import TYPE_CHECKING, Any, Final

from anyio.to_thread import current_default_thread_limiter

from aiorts.clock import SimulatedClock
from aiorts.kernel.loop.bus import ThreadsExhausted
from aiorts.kernel.loop.guarded import KernelLog

if TYPE_CHECKING:
    from anyio import CapacityLimiter

    from aiorts.kernel.execution.cell import KernelSide


_LOG = KernelLog()
_EVERY: Final = 1.0


class PoolMonitor:
    """The look of one kernel at the pools of its loop."""

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = weakref.proxy(kernel)
        self._limiter: CapacityLimiter | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._exhausted = False

    def look_out(self) -> None:
        """A context is started: look from now on while there is one. In a task of the kernel's loop."""
        if self._timer is None and not isinstance(self._kernel.clock, SimulatedClock):
            self._limiter = current_default_thread_limiter()
            self._timer = self._kernel.loop.call_later(_EVERY, self._look)

    def close(self) -> None:
        """Do not look any more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _look(self) -> None:
        self.close()
        kernel = self._kernel
        if not kernel.contexts:
            return
        self._timer = kernel.loop.call_later(_EVERY, self._look)
        waiting, threads = self._queue()
        if waiting and not self._exhausted:
            _LOG.warning(
                "%s: %s calls wait for a thread: all %s threads of the pool are busy; the loop goes on. Use a "
                "ThreadContext for hooks that block, or a larger limiter",
                kernel.name,
                waiting,
                threads,
            )
            kernel.bus.publish(ThreadsExhausted(waiting, threads))
        self._exhausted = waiting > 0

    def _queue(self) -> tuple[int, int]:
        """Calls that wait and threads that work, of the fuller of the two pools: anyio's and the loop's own."""
        found = (0, 0)
        if self._limiter is not None:
            statistics = self._limiter.statistics()
            found = statistics.tasks_waiting, statistics.borrowed_tokens
        executor: Any = getattr(self._kernel.loop, "_default_executor", None)
        queue = getattr(executor, "_work_queue", None)
        if queue is not None and queue.qsize() > found[0]:
            found = queue.qsize(), len(executor._threads)
        return found
