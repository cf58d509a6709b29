"""The times at which the samples of a connector were written, for samples that expire and samples that are measured."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import repeat
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports.features import FeaturedTransport
from aiorts.kernel.ports.periodic_transport import PeriodicTransport

if TYPE_CHECKING:
    from aiorts.kernel.ports.transport import Transport

_KEY: Final = "dated"


class Moments:
    """When the samples of one connector were written, on the kernel's monotonic clock."""

    __slots__ = ("backlog", "given_ns", "left_ns", "now_ns", "queue")

    def __init__(self, transport: Transport) -> None:
        self.now_ns: Callable[[], int] = transport.clock.monotonic_ns
        # No time was kept for samples that came while a real-time thread used the connector: now stands for it.
        self.queue: deque[int] = deque(repeat(self.now_ns(), len(transport.queue)))
        """The time of each sample in the reader's queue; in front, times of samples that have left it since."""
        self.backlog: deque[int] = deque(repeat(self.now_ns(), transport.buffered - len(transport.queue)))
        """The time of each sample in the backlog; in front, times of samples that have left it since."""
        self.left_ns = 0
        """The time of the sample that left the backlog last."""
        self.given_ns: int | None = None
        """The time at which the next sample was written in another kernel; None: it is written here, now."""


class Dated(FeaturedTransport):
    """A transport that knows when its samples were written. See `Transport`."""

    __slots__ = ()

    @property
    def moments(self) -> Moments:
        """When the samples were written."""
        found: Moments | None = self.extra.get(_KEY)
        if found is None:
            found = self.extra[_KEY] = Moments(self)
        return found

    def written_ns(self) -> int:
        """The time at which the sample now entering the reader's queue was written."""
        moments = self.moments
        return moments.now_ns() if moments.given_ns is None else moments.given_ns

    def carry_on(self, old: Transport) -> None:
        moments = old.moments if isinstance(old, Dated) else None
        if moments is not None:
            times_of(moments.queue, old.queue)
        super().carry_on(old)
        if moments is not None:
            self.extra[_KEY] = moments
            moments.queue.extend(repeat(moments.now_ns(), len(self.queue) - len(moments.queue)))

    def push_in(self, sample: Any, *, displaced: int = 0) -> None:
        times_of(self.moments.queue, self.queue).append(self.written_ns())
        super().push_in(sample, displaced=displaced)

    def take_out(self, place: int) -> None:
        del times_of(self.moments.queue, self.queue)[place]
        super().take_out(place)


class DatedPeriodic(Dated, PeriodicTransport):
    """A periodic transport that knows when its samples were written. See `PeriodicTransport`."""

    __slots__ = ()

    def lay_by(self, sample: Any) -> None:
        moments = self.moments
        times_of(moments.backlog, self.backlog).append(moments.now_ns())
        super().lay_by(sample)

    def leave(self, reason: str | None = None) -> Any:
        moments = self.moments
        moments.left_ns = times_of(moments.backlog, self.backlog).popleft()
        return super().leave(reason)

    def put_last(self, sample: Any) -> None:
        self.moments.left_ns = self.moments.now_ns()
        super().put_last(sample)

    def written_ns(self) -> int:
        return self.moments.left_ns

    def takes_all(self) -> bool:
        return False


def times_of(times: deque[int], samples: deque[Any]) -> deque[int]:
    """Remove, from the front of `times`, the times of samples that have left `samples`; return `times`."""
    while len(times) > len(samples):
        times.popleft()
    return times
