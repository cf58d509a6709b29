"""Cancels a hook that is over its time, one grace step after the other, and gives up on it after the last."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.kernel.deadlines import CANCELLATIONS, GRACE

if TYPE_CHECKING:
    from aiorts.kernel.driver_state import DriverState
    from aiorts.kernel.host import Cancellable

__all__ = ("Watch",)


class Watch:
    """Cancels the hook that runs now, step by step, when its time is over."""

    __slots__ = ("cancels", "driver", "limit", "stopping", "timer")

    def __init__(self, driver: DriverState, limit: float | None = None) -> None:
        self.driver = driver
        self.limit = limit
        """Seconds that this hook may take; None is unlimited."""
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
            self.timer = self.driver.call_later(deadline, self._expire)

    def rearm(self) -> None:
        """A stop began while the hook runs: its countdown replaces the hook's own, once cancelling it goes on."""
        if self.cancels == 0:
            self.disarm()
            self.arm()

    def disarm(self) -> None:
        """The hook returned."""
        if self.timer is not None:
            self.timer.cancel()
            self.timer = None

    def _expire(self) -> None:
        if self.cancels < CANCELLATIONS:
            self.cancels += 1
            self.driver.task.cancel_hook()
            budget = self.driver.budget
            later = self.driver.loop.call_later if self.stopping else self.driver.call_later
            self.timer = later(GRACE if budget is None else budget.grace, self._expire)
        else:
            self.driver.abandon()
