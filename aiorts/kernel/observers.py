"""What keeps an observer from harming anybody: faults and slowness are counted, told now and then, contained."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic_ns
from typing import Any, Final

from aiorts.clock import current_clock
from aiorts.errors import ConfigurationError
from aiorts.kernel.deadlines import CANCELLATIONS
from aiorts.kernel.tasks import kernel_task, leave_behind
from aiorts.model.values import shown

__all__ = ("AsyncObserver", "Observer", "ObserverStatistics", "check_length", "is_async")

_LOG = logging.getLogger("aiorts.kernel")
_SLOW_NS: Final = 50_000_000
"""A plain observer that takes longer is named."""
_TELL_EVERY_NS: Final = 5_000_000_000
_GRACE: Final = 0.02
"""Seconds between two cancellations of one that has not ended when its time is over."""


@dataclass(frozen=True, slots=True)
class ObserverStatistics:
    """What came of one subscription."""

    name: str
    kind: str
    calls: int = 0
    errors: int = 0
    """Calls that raised."""
    slow: int = 0
    """Calls that held the loop for more than 50 ms."""
    max_ns: int = 0
    """The longest call; of an asynchronous observer only what the kernel spent on it."""
    waiting: int = 0
    dropped: int = 0
    """Events that an asynchronous observer was too slow for."""


class Observer:
    """A plain function, called on the loop."""

    def __init__(self, kind: type[Any], call: Callable[[Any], object], length: int = 0) -> None:
        self.kind = kind
        self.ended = False
        """Whether it was unsubscribed: it hears nothing more, be it of what is being told."""
        self._call = call
        self._length = length
        self._calls = self._errors = self._slow = self._max_ns = self._dropped = 0
        self._told: dict[str, int] = {}
        self._queue: deque[Any] = deque()

    @property
    def statistics(self) -> ObserverStatistics:
        """The counts at this moment."""
        counts = (self._calls, self._errors, self._slow, self._max_ns, len(self._queue), self._dropped)
        return ObserverStatistics(self._name, self.kind.__name__, *counts)

    @property
    def _name(self) -> str:
        return str(getattr(self._call, "__qualname__", None) or repr(self._call))

    def tell(self, event: Any) -> None:
        """Call it; what it raises comes out."""
        self._calls += 1
        self._call(event)

    def failed(self, event: Any) -> None:
        """It raised; called where the exception is handled."""
        self._errors += 1
        if self._may_tell("error"):
            _LOG.exception("observer %s failed at %s (%s times so far)", self._name, shown(event), self._errors)

    def took(self, duration_ns: int, event: Any) -> None:
        """How long the loop was held."""
        if duration_ns > self._max_ns:
            self._max_ns = duration_ns
        if duration_ns > _SLOW_NS:
            self._slow += 1
            # Simulated time waited for it: nobody was late, and two runs log the same.
            if current_clock() is None and self._may_tell("slow"):
                told = (self._name, duration_ns / 1e6, type(event).__name__)
                _LOG.info("observer %s held the loop for %.0f ms at a %s; make it async def", *told)

    def end(self) -> None:
        """It was unsubscribed."""
        self.ended = True

    async def aclose(self, patience: float) -> None:
        """The kernel closes: `patience` s for what waits."""

    def _may_tell(self, what: str) -> bool:
        clock = current_clock()
        now = monotonic_ns() if clock is None else clock.monotonic_ns()
        if now - self._told.get(what, now - _TELL_EVERY_NS) < _TELL_EVERY_NS:
            return False
        self._told[what] = now
        return True


class AsyncObserver(Observer):
    """A coroutine function: awaited in a task of its own, which is there while something waits."""

    def __init__(self, kind: type[Any], call: Callable[[Any], Any], length: int) -> None:
        super().__init__(kind, call, length)
        self._task: asyncio.Task[None] | None = None

    def tell(self, event: Any) -> None:
        if len(self._queue) >= self._length:
            self._queue.popleft()
            self._dropped += 1
            if self._may_tell("dropped"):
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
                    if isinstance(error, KeyboardInterrupt) or _is_cancelled(error):
                        raise
                    self.failed(event)
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
            _LOG.error("observer %s ignored %s cancellations and was left behind", self._name, CANCELLATIONS)
            leave_behind(task)


def _is_cancelled(error: BaseException) -> bool:
    """Whether this task is to end; else it awaited what somebody has cancelled, which is an error of its own."""
    task = asyncio.current_task()
    return isinstance(error, asyncio.CancelledError) and task is not None and task.cancelling() > 0


def check_length(where: str, length: object) -> None:
    """Raise ConfigurationError unless so many events can wait."""
    if isinstance(length, bool) or not isinstance(length, int) or length < 1:
        raise ConfigurationError(f"{where}: length = {length!r}: expected a whole number from 1 on")


def is_async(call: object) -> bool:
    """Whether calling it gives something to await."""
    return inspect.iscoroutinefunction(call) or inspect.iscoroutinefunction(getattr(call, "__call__", None))  # noqa: B004
