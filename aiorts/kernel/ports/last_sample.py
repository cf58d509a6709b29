"""The sample that a writer wrote last: for a connector with `keep_last`, and for who looks at an out-port.

Nothing is stored when a sample is written and carried. It is the newest in a connector's queue, or what its reader took
last (`Transport.held`). Each write goes to every connector, so any of them has it, but for those where it was lost:
that transport gives it to the out-port (`Transport.miss`) and says so of itself (`missed`). An out-port without
connectors has a `NoReader` to keep it.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports.port import NOTHING

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import PortHost
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.kernel.ports.out_port import OutPort
    from aiorts.kernel.ports.queueing import Waiting
    from aiorts.kernel.ports.receiver import Receiver

_PATIENCE: Final = 1000
"""Looks at an out-port that a thread is in the middle of writing at."""
_OF_TRANSPORT: Final[tuple[str, ...]] = ()
"""The slots of the attributes below are those of `Transport`."""


class LastSample:
    """What a transport knows of the writer's last sample: a base of `Transport`, which has the rest."""

    __slots__ = _OF_TRANSPORT

    if TYPE_CHECKING:
        connector: Connector
        receiver: Receiver
        queue: deque[Any]
        waiting: deque[Waiting] | None
        written: int
        last: Any
        missed: int
        offered: int

        @property
        def buffered(self) -> int: ...
        def total(self) -> int: ...
        def guard(self) -> AbstractContextManager[Any]: ...
        def push_in(self, sample: Any, *, displaced: bool = False) -> None: ...
        def stamp_in(self, sample: Any) -> Any: ...

    @property
    def position(self) -> int:
        """Samples written, with those that wait for room."""
        return self.total() + (len(self.waiting) if self.waiting else 0)

    def held(self) -> Any:
        """The last sample that the writer wrote, if it is to be had here; else NOTHING."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.held()
            if self.missed == self.position:
                return NOTHING
            return self.waiting[-1].sample if self.waiting else self.newest_here()

    def newest_here(self) -> Any:
        """The newest sample that came in, read or unread; NOTHING if there was none."""
        if self.queue:
            return self.queue[-1]
        receiver = self.receiver
        if receiver.plain and receiver.last_source is self.connector:
            return receiver.last_read
        return self.last

    def lose(self, sample: Any) -> None:
        """This sample came in last, or was to come in now, and is not to be had here any more."""
        if not self.waiting and self.missed != self.position:
            self.miss(sample)

    def miss(self, sample: Any, coming: int = 0) -> None:
        """The writer's last sample is not to be had here: the out-port keeps it; so many are not counted yet."""
        self.connector.out._saved = sample
        self.missed = self.position + coming

    def put_last(self, sample: Any) -> None:
        """Take the sample that the writer wrote last, before this connector asked for it; the caller holds the lock."""
        self.written += 1
        self.offered += 1
        self.push_in(self.stamp_in(sample))

    def take_back(self) -> None:
        """What was offered and lies unread, with nothing taken or lost, was not written; the caller holds the lock."""
        if self.queue and self.total() == self.buffered:
            newest = self.held()
            self.queue.popleft()
            self.written -= 1
            self.offered -= 1
            if newest is not NOTHING and not self.position:
                self.miss(newest)


def last_written(out: OutPort[Any]) -> Any:
    """The sample that was written last; NOTHING before the first."""
    for connector in out._connectors:
        if (sample := connector._transport.held()) is not NOTHING:
            return sample
    return out._saved


def offer_last(connector: Connector, written: int) -> None:
    """Offer the writer's last sample to a connector from which nothing was read yet, if its reader takes samples.

    `written` were written when it began to take them: one that came since is the writer's last.
    """
    transport, out = connector._transport, connector.out
    if not transport.receiver.open or transport.delivered():
        return
    host = out._host
    for _ in range(_PATIENCE):
        if host is None or not host.writing:
            break
        time.sleep(50e-6)  # lets the thread end its write, which is at some connectors and not at others
    sample = last_written(out)
    if sample is NOTHING:
        return
    with transport.guard():
        now = connector._transport
        if now.receiver.open and not now.closed and now.total() == written:
            now.put_last(sample)


def to_be_offered(port: InPort[Any]) -> list[tuple[Connector, int]]:
    """The arguments for `offer_last` of an in-port that takes samples from now on; the caller holds the lock."""
    return [(one, one._transport.total()) for one in port._connectors if one.profile.keep_last]


class Beginning:
    """The first of the transports of an out-port that a thread writes at: says that a write is not everywhere yet.

    A connector that came while the way was chosen has the sample, too: who made it may have looked before.
    """

    __slots__ = ("_connectors", "_host", "_out")

    def __init__(self, out: OutPort[Any], host: PortHost) -> None:
        self._out, self._host = out, host
        self._connectors = out._connectors

    def must_wait(self) -> bool:
        """Nobody is to be waited for."""
        return False

    def offer(self, sample: Any) -> bool:
        """A write begins."""
        out = self._out
        self._host.writing = True
        if out._connectors is self._connectors:
            return True
        newcomers = [one for one in out._connectors if one not in self._connectors]
        return sum(not one._transport.offer(sample) for one in newcomers) == 0


class Ending:
    """The last of them."""

    __slots__ = ("_host",)

    def __init__(self, host: PortHost) -> None:
        self._host = host

    def must_wait(self) -> bool:
        """Nobody is to be waited for."""
        return False

    def offer(self, sample: Any) -> bool:
        """It is everywhere."""
        self._host.writing = False
        return True


class NoReader:
    """In the place of the transports of an out-port that has none."""

    __slots__ = ("_out",)

    def __init__(self, out: OutPort[Any]) -> None:
        self._out = out

    def must_wait(self) -> bool:
        """Nobody is to be waited for."""
        return False

    def offer(self, sample: Any) -> bool:
        """Keep it."""
        self._out._saved = sample
        return True
