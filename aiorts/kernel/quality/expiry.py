"""Samples expire: `lifespan` seconds after the write into the connector, on the kernel's clock, they may not be read.

Nothing runs at that moment. A reader drops first what is too old; the oldest is in front, so a look that finds nothing
costs one reading of the clock. Only while a writer waits for room, a timer looks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from functools import partial
from threading import get_ident
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import to_ns
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.quality.dated import Dated, DatedPeriodic, times_of

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.kernel.ports.transport import Waiting

_KEY: Final = "lifespan"
_EXPIRED: Final = "expired"


class _Life:
    """The lifespan of a connector's samples, and the timer that drops expired ones."""

    __slots__ = ("call_at", "lifespan_ns", "timer")

    def __init__(self, lifespan: float, kernel: KernelSide) -> None:
        self.lifespan_ns = to_ns(lifespan)
        self.call_at = kernel.call_at
        self.timer: Any = None
        """The timer, while a writer waits for room; else None."""


class Expiring(Dated):
    """A transport whose samples expire. See `Transport`."""

    __slots__ = ()

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        super().__init__(connector, receiver, kernel)
        lifespan = connector.profile.lifespan
        assert lifespan is not None  # noqa: S101 - it is why this class was chosen
        self.extra[_KEY] = _Life(lifespan, kernel)

    @property
    def life(self) -> _Life:
        """The lifespan of the samples, with its timer."""
        life: _Life = self.extra[_KEY]
        return life

    def settle(self) -> None:
        super().settle()
        with self.guard():
            if transport_of(self.connector) is not self:
                return
            if count := self._expire():
                if self.receiver.tokens is not None:
                    self.dead += count
                    if self.dead > self.length:
                        self.receiver.bury(self)
                if self.waiting and (self.receiver.lock is not None or get_ident() == self.receiver.thread):
                    self.admit_waiting()

    def _expire(self) -> int:
        """Drop expired samples of the reader's queue; return how many."""
        moments, queue = self.moments, self.queue
        if not queue:
            return 0
        times = times_of(moments.queue, queue)
        limit_ns = moments.now_ns() - self.life.lifespan_ns
        expired = []
        while times and times[0] <= limit_ns:
            times.popleft()
            expired.append(queue.popleft())
        if expired:
            self.drop_these(_EXPIRED, expired)
            if not queue:
                self.lose(expired[-1])
        return len(expired)

    # -- a timer while a writer waits for room ---------------------------------------------------------------------

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        entry = super().queue_up(sample, future)
        self._tend_soon()
        return entry

    def give_up(self, entry: Waiting) -> bool:
        given_up = super().give_up(entry)
        self._tend_soon()
        return given_up

    def admit_waiting(self) -> None:
        super().admit_waiting()
        self._tend_soon()

    def end_all(self, reason: str) -> None:
        self._expire()
        super().end_all(reason)
        self._tend_soon()

    def leave_off(self) -> Iterable[Any]:
        if self.life.timer is not None:
            self.life.timer.cancel()
            self.life.timer = None
        return super().leave_off()

    def _tend_soon(self) -> None:
        if bool(self.waiting) is (self.life.timer is None):
            self.on_loop(_tend)

    def tend(self) -> None:
        """Set a timer while a writer waits for room, and none otherwise; on the loop."""
        with self.guard():
            life = self.life
            if not self.waiting:
                if life.timer is not None:
                    life.timer.cancel()
                    life.timer = None
            elif life.timer is None and (times := times_of(self.moments.queue, self.queue)):
                life.timer = life.call_at(times[0] + life.lifespan_ns, partial(self.on_loop, _look_again))


class ExpiringPeriodic(Expiring, DatedPeriodic):
    """A periodic transport whose samples expire, in the backlog too. See `PeriodicTransport`."""

    __slots__ = ()

    def _expire(self) -> int:
        moments, backlog = self.moments, self.backlog
        if backlog:
            times = times_of(moments.backlog, backlog)
            limit_ns = moments.now_ns() - self.life.lifespan_ns
            while times and times[0] <= limit_ns:
                self.lose(self.leave(_EXPIRED))
        return super()._expire()

    def work_off(self) -> None:
        self.settle()
        super().work_off()


def _look_again(transport: Any) -> None:
    """Drop expired samples and set the timer again: the oldest sample has expired, or was taken meanwhile."""
    transport.life.timer = None
    transport.settle()
    transport.tend()


def _tend(transport: Any) -> None:
    """Set or end the timer, on the loop, unless the connector's samples do not expire any more."""
    if isinstance(transport, Expiring):
        transport.tend()
