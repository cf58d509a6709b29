"""Samples expire: `lifespan` seconds after the write into the connector, on the kernel's clock, they may not be read.

Nobody is called when that happens. Whoever looks at a queue drops first what is too old; the oldest is in front, so a
look that finds nothing costs one look at the clock. Only while a writer waits for room a timer looks for it.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from operator import methodcaller
from threading import get_ident
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import to_ns
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.features import FeaturedTransport
from aiorts.kernel.ports.periodic_transport import PeriodicTransport

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.queueing import Waiting
    from aiorts.kernel.ports.receiver import Receiver

_KEY: Final = "lifespan"
_EXPIRED: Final = "expired"


class _Ages:
    """When the samples of one connector were written."""

    __slots__ = ("backlog", "call_at", "left_ns", "lifespan_ns", "now_ns", "queue", "timer")

    def __init__(self, lifespan: float, kernel: KernelSide) -> None:
        self.lifespan_ns = to_ns(lifespan)
        self.now_ns: Callable[[], int] = kernel.clock.monotonic_ns
        self.call_at = kernel.call_at
        self.timer: Any = None
        """While a writer waits for room."""
        self.queue: deque[int] = deque()
        """Of each sample in the reader's queue; of those that have left it in front, until somebody looks."""
        self.backlog: deque[int] = deque()
        """Of each sample in the backlog, as above."""
        self.left_ns = 0
        """Of the sample that left the backlog last."""


class Expiring(FeaturedTransport):
    """A transport whose samples expire. See `Transport`."""

    __slots__ = ()

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        super().__init__(connector, receiver, kernel)
        lifespan = connector.profile.lifespan
        assert lifespan is not None  # noqa: S101 - it is why this class was chosen
        self.extra[_KEY] = _Ages(lifespan, kernel)

    @property
    def ages(self) -> _Ages:
        """When the samples were written."""
        ages: _Ages = self.extra[_KEY]
        return ages

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
        """Drop what is too old in the reader's queue; how much that was."""
        ages, queue = self.ages, self.queue
        if not queue:
            return 0
        times = _times_of(ages.queue, queue)
        limit_ns = ages.now_ns() - ages.lifespan_ns
        expired = []
        while times and times[0] <= limit_ns:
            times.popleft()
            expired.append(queue.popleft())
        if expired:
            self.drop_these(_EXPIRED, expired)
            if not queue:
                self.lose(expired[-1])
        return len(expired)

    def written_ns(self) -> int:
        """When the sample was written that comes into the reader's queue now."""
        return self.ages.now_ns()

    def push_in(self, sample: Any, *, displaced: bool = False) -> None:
        _times_of(self.ages.queue, self.queue).append(self.written_ns())
        super().push_in(sample, displaced=displaced)

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

    def _tend_soon(self) -> None:
        if bool(self.waiting) is (self.ages.timer is None):
            self.on_loop(methodcaller("tend"))

    def tend(self) -> None:
        """Have a timer exactly while a writer waits for room; on the loop."""
        with self.guard():
            ages = self.ages
            if not self.waiting:
                if ages.timer is not None:
                    ages.timer.cancel()
                    ages.timer = None
            elif ages.timer is None and (times := _times_of(ages.queue, self.queue)):
                ages.timer = ages.call_at(times[0] + ages.lifespan_ns, partial(self.on_loop, _look_again))


class ExpiringPeriodic(Expiring, PeriodicTransport):
    """A periodic transport whose samples expire, in the backlog too. See `PeriodicTransport`."""

    __slots__ = ()

    def _expire(self) -> int:
        ages, backlog = self.ages, self.backlog
        if backlog:
            times = _times_of(ages.backlog, backlog)
            limit_ns = ages.now_ns() - ages.lifespan_ns
            while times and times[0] <= limit_ns:
                self.lose(self.leave(_EXPIRED))
        return super()._expire()

    def lay_by(self, sample: Any) -> None:
        _times_of(self.ages.backlog, self.backlog).append(self.ages.now_ns())
        super().lay_by(sample)

    def leave(self, reason: str | None = None) -> Any:
        ages = self.ages
        ages.left_ns = _times_of(ages.backlog, self.backlog).popleft()
        return super().leave(reason)

    def put_last(self, sample: Any) -> None:
        self.ages.left_ns = self.ages.now_ns()
        super().put_last(sample)

    def written_ns(self) -> int:
        return self.ages.left_ns

    def work_off(self) -> None:
        self.settle()
        super().work_off()

    def takes_all(self) -> bool:
        return False


def _times_of(times: deque[int], samples: deque[Any]) -> deque[int]:
    """The times of just these samples: what has left went in front."""
    while len(times) > len(samples):
        times.popleft()
    return times


def _look_again(transport: Any) -> None:
    """The timer is over: the oldest sample has expired, or was taken meanwhile."""
    transport.ages.timer = None
    transport.settle()
    transport.tend()
