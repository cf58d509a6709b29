"""Cancels a hook that is over its time, one grace step after the other, and gives up on it after the last.

Nothing can cancel one that keeps the thread: it is judged by the kernel's clock when it returns.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

from aiorts.clock import to_ns
from aiorts.errors import HookTimeout
from aiorts.kernel.loop.deadlines import CANCELLATIONS, GRACE

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.loop.timers import Cancellable


class Timed(Protocol):
    """The driver whose hook is timed."""

    loop: asyncio.AbstractEventLoop
    budget: StopBudget | None
    call_at: Callable[[int, Callable[[], None]], Cancellable]
    call_later: Callable[[float, Callable[[], None]], Cancellable]

    def now_ns(self) -> int:
        """The time on the kernel's clock."""
        ...

    def cancel_hook(self) -> None:
        """Cancel the hook that runs now."""

    def abandon(self) -> None:
        """Go on without the hook that runs now."""


class HookTimer:
    """Cancels the hook that runs now, step by step, when its time is over."""

    __slots__ = ("begun_ns", "cancels", "driver", "limit", "stopping", "timer")

    def __init__(self, driver: Timed, limit: float | None = None) -> None:
        self.driver = driver
        self.limit = limit
        """Seconds that this hook may take; None is unlimited."""
        self.begun_ns = driver.now_ns()
        """When its time began to count, on the kernel's clock."""
        self.cancels = 0
        self.stopping = False
        self.timer: Cancellable | None = None

    def arm(self) -> None:
        """Start the countdown that is in force: the stop's, else the hook's own deadline if it has one."""
        budget, deadline = self.driver.budget, self.limit
        if budget is not None:
            self.stopping = True
            self.timer = self.driver.loop.call_later(budget.limit, self._expire)
        elif deadline is not None:
            self.timer = self.driver.call_at(self.begun_ns + to_ns(deadline), self._expire)

    def rearm(self) -> None:
        """Give the running hook another countdown, a stop's or its own, unless its cancellation has begun."""
        if self.cancels == 0:
            self.disarm()
            self.arm()

    def disarm(self) -> None:
        """End the countdown."""
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None

    def returned(self, where: str) -> BaseException | None:
        """The error of a hook that returned by itself and too late. Once a stop began, only its countdown counts."""
        if self.stopping:
            return None
        took_ns = self.driver.now_ns() - self.begun_ns
        return too_late(where, took_ns, self.limit)

    def cancelled(self, where: str, error: BaseException | None) -> BaseException | None:
        """The error of a hook that this timer cancelled and that then ended with `error`, or returned."""
        if error is None and self.stopping:
            return None
        if error is not None and not is_cancellation(error):
            return error
        late = HookTimeout(
            f"{where}: still ran when the time its context had to stop was over; it was cancelled"
            if self.stopping
            else f"{where}: did not return within {self.limit} s; it was cancelled"
        )
        late.__cause__ = error
        return late

    def _expire(self) -> None:
        if self.cancels < CANCELLATIONS:
            self.cancels += 1
            self.driver.cancel_hook()
            budget = self.driver.budget
            later = self.driver.loop.call_later if self.stopping else self.driver.call_later
            self.timer = later(GRACE if budget is None else budget.grace, self._expire)
        else:
            self.driver.abandon()


def too_late(where: str, took_ns: int, limit: float | None) -> BaseException | None:
    """The error of a hook that has returned by itself, if it took longer than `limit` seconds of the kernel's clock."""
    if limit is None or took_ns <= to_ns(limit):
        return None
    return HookTimeout(
        f"{where}: returned after {took_ns / 1e9:.3g} s, its deadline is {limit:g} s; its "
        "thread was blocked, so that nothing could cancel it"
    )


def is_cancellation(error: BaseException | None) -> bool:
    """Whether this is asyncio's CancelledError."""
    # An application's exception says itself what its `__class__` is, and may raise: its type is asked.
    return issubclass(type(error), asyncio.CancelledError)
