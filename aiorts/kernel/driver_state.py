"""What the driver of a context is asked from outside: to wake up, to hurry, to stop, to take care; it never waits.

The task that listens to it is in `bulkhead.py`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from aiorts.kernel.bus import Bus
from aiorts.kernel.deadlines import StopBudget
from aiorts.kernel.driver_task import resolve
from aiorts.kernel.life import Batch, Steps
from aiorts.kernel.watch import Watch

if TYPE_CHECKING:
    from aiorts.kernel.context import Context
    from aiorts.kernel.driver_task import DriverTask
    from aiorts.kernel.host import Cancellable
    from aiorts.kernel.lanes import Lane
    from aiorts.kernel.member import Member

__all__ = ("DriverState",)

_LOG = logging.getLogger("aiorts.kernel")


class DriverState:
    """What is known of a driver, and what others may ask of it, all in the loop's thread."""

    __slots__ = (
        "__weakref__",
        "_batch",
        "_bus",
        "_call_at",
        "_careful",
        "_ended",
        "_joined",
        "_kicked",
        "_member",
        "_over",
        "_sleeper",
        "_steps",
        "_stopped_by_host",
        "_watch",
        "budget",
        "call_later",
        "cancelled_by_others",
        "context",
        "deadline",
        "hooks_run",
        "lanes",
        "loop",
        "task",
        "turn",
    )

    def __init__(
        self,
        context: Context,
        steps: Steps,
        loop: asyncio.AbstractEventLoop,
        call_at: Callable[[int, Callable[[], None]], Cancellable],
        call_later: Callable[[float, Callable[[], None]], Cancellable],
        bus: Bus,
    ) -> None:
        self.context = context
        self.loop = loop
        self.call_later = call_later
        self.deadline: float | None = context.deadline
        self.budget: StopBudget | None = None
        self.hooks_run = 0
        """Hooks that took the long way; see `run`."""
        self.lanes: tuple[Lane, ...] = ()
        """What runs groups side by side, where there are any."""
        self._stopped_by_host = self.cancelled_by_others = False
        self._careful = False
        """Whether hooks take the long way: they have a deadline or observers, a stop began, or somebody cancelled."""
        self._joined = False
        """Whether the component whose hook runs now came into a second context meanwhile."""
        self._bus = bus
        self._call_at = call_at
        self._steps = steps
        self._batch: Batch | None = None
        self._member: Member | None = None
        self._watch: Watch | None = None
        self._sleeper: asyncio.Future[None] | None = None
        self.turn: asyncio.Future[bool] | None = None
        self._kicked = False
        self._over = False
        self._ended: asyncio.Future[None] | None = None
        self.beware()
        self.task = self._begin()

    def _begin(self) -> DriverTask:
        """The task that carries out the steps, from now on."""
        raise NotImplementedError

    @property
    def ended(self) -> asyncio.Future[None]:
        """Done when the last step was carried out; made when somebody asks for it first."""
        if self._ended is None:
            self._ended = self.loop.create_future()
            if self._over:
                self._ended.set_result(None)
        return self._ended

    @property
    def current(self) -> Member | None:
        """The member whose hook runs now."""
        return self._member

    @property
    def run(self) -> tuple[int, int, Member | None]:
        """Which run of a hook this is: equal for two moments of one run, and for no others while a hook runs."""
        # In one cycle a member is executed once: what runs quickly need not be counted.
        return self.context.ticks, self.hooks_run, self._member

    def kick(self) -> None:
        """Somebody wants something: do not sleep on. In the loop's thread only."""
        sleeper = self._sleeper
        if sleeper is not None and not sleeper.done():
            sleeper.set_result(None)
        else:
            self._kicked = True

    def hurry(self, budget: StopBudget) -> None:
        """A stop began: hooks are limited from now on, the one that runs included."""
        for lane in self.lanes:
            lane.hurry(budget)
        if self.budget is None:
            self.budget = budget
            self._careful = True
            if self._watch is None and self._member is not None:
                self._watch = Watch(self)
                self._watch.arm()
            elif self._watch is not None:
                self._watch.rearm()
            elif self.turn is not None:
                self.loop.call_later(budget.limit, resolve, self.turn, False)

    def stop_for_host(self) -> None:
        """The application cancelled the context's task: an odd way to stop it, but a clear one."""
        context = self.context
        if not context._stopping:
            _LOG.warning("context %s: its task was cancelled by the application; it stops", context.name)
            context._stopping = self._stopped_by_host = True
            self.hurry(StopBudget(self.loop))
            self.kick()

    def beware_of_cancellation(self) -> None:
        """Somebody else cancels the hook that runs now."""
        self.cancelled_by_others = self._careful = True

    def beware(self) -> None:
        """Lay out anew whether hooks take the long way; also called when observers of hooks come and go."""
        self._careful = (
            self.deadline is not None
            or self.budget is not None
            or self._bus.hooks_wanted
            or self._joined
            or self.cancelled_by_others
        )

    def beware_of_sharing(self) -> None:
        """The component whose hook runs now is in a second context from now on."""
        self._joined = self._careful = True

    def abandon(self) -> None:
        """The hook ignored every cancellation: go on without it."""
        raise NotImplementedError
