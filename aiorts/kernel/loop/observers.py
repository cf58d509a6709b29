"""Keeps an observer from harming others: faults and slowness are counted, logged now and then, and contained."""

from __future__ import annotations

import asyncio
import inspect
from collections import deque
from collections.abc import Callable
from time import monotonic_ns
from typing import Any, Final

from aiorts.clock import current_clock
from aiorts.errors import ConfigurationError
from aiorts.kernel.loop.deadlines import CANCELLATIONS
from aiorts.kernel.loop.guarded import KernelLog, guarded, interrupts
from aiorts.kernel.loop.tasks import abandon_task, kernel_task
from aiorts.late import dataclass
from aiorts.model.values import shown

_LOG = KernelLog()
_SLOW_NS: Final = 50_000_000
"""A plain observer that takes longer is named."""
_LOG_EVERY_NS: Final = 5_000_000_000
_GRACE: Final = 0.02
"""Seconds between two cancellations of one that has not ended when its time is over."""


@dataclass(frozen=True, slots=True)
class ObserverStatistics:
    """The counts of one subscription to the bus."""

    name: str
    """The name of the observer's function."""
    kind: str
    """The class of events."""
    calls: int = 0
    errors: int = 0
    """Calls that raised."""
    slow: int = 0
    """Calls that held the loop for more than 50 ms."""
    max_ns: int = 0
    """The longest call; of an asynchronous observer only what the kernel spent on it."""
    waiting: int = 0
    """Events that an asynchronous observer has not had yet."""
    dropped: int = 0
    """Events that an asynchronous observer was too slow for."""


class Observer:
    """A plain function, called on the loop."""

    def __init__(self, kind: type[Any], call: Callable[[Any], object], length: int = 0) -> None:
        self.kind = kind
        self.ended = False
        """Whether it was unsubscribed: it gets nothing more, the event that is being published included."""
        self._call = call
        self._length = length
        self._calls = self._errors = self._slow = self._max_ns = self._dropped = 0
        self._logged: dict[str, int] = {}
        self._queue: deque[Any] = deque()

    @property
    def statistics(self) -> ObserverStatistics:
        """The counts at this moment."""
        counts = (self._calls, self._errors, self._slow, self._max_ns, len(self._queue), self._dropped)
        return ObserverStatistics(self._name, self.kind.__name__, *counts)

    @property
    def _name(self) -> str:
        return str(getattr(self._call, "__qualname__", None) or shown(self._call))

    def notify(self, event: Any) -> None:
        """Call it; what it raises comes out."""
        self._calls += 1
        self._call(event)

    def failed(self, event: Any, error: BaseException) -> None:
        """It raised. A KeyboardInterrupt is for the code that runs the loop."""
        self._errors += 1
        if interrupts(error):
            return
        if self._may_report("error"):
            what_failed = (self._name, shown(event), self._errors)
            _LOG.error("observer %s failed at %s (%s times so far)", *what_failed, exc_info=error)

    def took(self, duration_ns: int, event: Any) -> None:
        """How long the loop was held."""
        if duration_ns > self._max_ns:
            self._max_ns = duration_ns
        if duration_ns > _SLOW_NS:
            self._slow += 1
            # Simulated time waited for it: no cycle was late, and two runs log the same.
            if current_clock() is None and self._may_report("slow"):
                what_failed = (self._name, duration_ns / 1e6, type(event).__name__)
                _LOG.info("observer %s held the loop for %.0f ms at a %s; make it async def", *what_failed)

    def end(self) -> None:
        """It was unsubscribed."""
        self.ended = True

    async def aclose(self, patience: float) -> None:
        """The kernel closes: `patience` s for what waits."""

    def _may_report(self, what: str) -> bool:
        clock = current_clock()
        now = monotonic_ns() if clock is None else clock.monotonic_ns()
        if now - self._logged.get(what, now - _LOG_EVERY_NS) < _LOG_EVERY_NS:
            return False
        self._logged[what] = now
        return True


class AsyncObserver(Observer):
    """A coroutine function: awaited in a task of its own, which is there while something waits."""

    def __init__(self, kind: type[Any], call: Callable[[Any], Any], length: int) -> None:
        super().__init__(kind, call, length)
        self._task: asyncio.Task[None] | None = None

    def notify(self, event: Any) -> None:
        if len(self._queue) >= self._length:
            self._queue.popleft()
            self._dropped += 1
            if self._may_report("dropped"):
                _LOG.warning("observer %s is too slow: %s events dropped so far", self._name, self._dropped)
        self._queue.append(event)
        if self._task is None:
            self._task = kernel_task(asyncio.get_running_loop(), self._work(), f"aiorts observer {self._name}")

    async def _work(self) -> None:
        try:
            while self._queue:
                event = self._queue.popleft()
                self._calls += 1
                try:
                    await self._call(event)  # type: ignore[misc] # a coroutine function
                except BaseException as error:
                    if _is_cancelled(error):
                        raise
                    guarded(f"could not tell of observer {self._name}", self.failed, event, error)
        finally:
            self._task = None

    def end(self) -> None:
        super().end()
        self._queue.clear()
        if self._task is not None and self._task is not asyncio.current_task():
            self._task.cancel()

    async def aclose(self, patience: float) -> None:
        task = self._task
        if task is not None:
            await asyncio.wait([task], timeout=patience)
        self.end()
        for _ in range(CANCELLATIONS):
            if task is None or task.done():
                return
            task.cancel()
            await asyncio.wait([task], timeout=_GRACE)
        if task is not None and not task.done():
            _LOG.error("observer %s ignored %s cancellations and was abandoned", self._name, CANCELLATIONS)
            abandon_task(task)


def _is_cancelled(error: BaseException) -> bool:
    """Whether this task is to end; else it awaited something that was cancelled, which is an error of its own."""
    task = asyncio.current_task()
    return issubclass(type(error), asyncio.CancelledError) and task is not None and task.cancelling() > 0


def check_length(where: str, length: object) -> None:
    """Raise ConfigurationError unless so many events can wait."""
    if isinstance(length, bool) or not isinstance(length, int) or length < 1:
        raise ConfigurationError(f"{where}: length = {length!r}: expected a whole number from 1 on")


def is_async(call: object) -> bool:
    """Whether calling it gives something to await."""
    return inspect.iscoroutinefunction(call) or inspect.iscoroutinefunction(getattr(call, "__call__", None))  # noqa: B004
