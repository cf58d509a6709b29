"""Reports when calls wait for a thread of the pool: once, and again only after no call has waited.

The pools are checked once a second while a context runs; the check delays no call.
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
    """The regular check of one kernel's thread pools."""

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = weakref.proxy(kernel)
        self._limiter: CapacityLimiter | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._exhausted = False

    def look_out(self) -> None:
        """Check from now on while any context runs: a context was started. In a task of the kernel's loop."""
        if self._timer is None and not isinstance(self._kernel.clock, SimulatedClock):
            self._limiter = current_default_thread_limiter()
            self._timer = self._kernel.loop.call_later(_EVERY, self._look)

    def close(self) -> None:
        """Stop checking."""
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
        """Waiting calls and working threads of one pool, anyio's or the loop's own: that with more waiting calls."""
        found = (0, 0)
        if self._limiter is not None:
            statistics = self._limiter.statistics()
            found = statistics.tasks_waiting, statistics.borrowed_tokens
        executor: Any = getattr(self._kernel.loop, "_default_executor", None)
        queue = getattr(executor, "_work_queue", None)
        if queue is not None and queue.qsize() > found[0]:
            found = queue.qsize(), len(executor._threads)
        return found
