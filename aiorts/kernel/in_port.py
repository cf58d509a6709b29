"""The reading end of a stream: one bounded queue for each connector, read in the order of arrival.

`read` and `read_nowait` write the common case out in full: one connector, no lock, nobody who waits for room. With
several connectors the port keeps one token, the connector, for each unread sample, so that reading in order costs the
same at any number of them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

from anyio import WouldBlock

from aiorts.errors import BusyError, ClosedError, ReadTimeout, StateError
from aiorts.kernel.blocking import PortLock
from aiorts.kernel.port import NOTHING, OFF, UNLOCKED, UNSUSPENDED, Port, give_turn
from aiorts.kernel.samples import Samples

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.host import PortHost

__all__ = ("InPort",)

T = TypeVar("T")


class InPort(Port[T]):
    """The reading end of a stream: one bounded queue for each connector, read in the order of arrival.

    One task waits on an in-port at a time. Args: see `Port`.
    """

    __slots__ = (
        "_armed",
        "_arrivals",
        "_before",
        "_cross",
        "_direct",
        "_last",
        "_open",
        "_plain",
        "_read_stamps",
        "_sole",
        "_sole_delivered",
        "_source",
        "_tokens",
        "_waiter",
        "_wakes",
    )

    direction: ClassVar[str] = "in"
    _crosses: ClassVar[bool] = False  # asked with the lock held: it may have become a crossing one meanwhile

    def __init__(
        self,
        type: type[T],  # noqa: A002 - the word users expect
        *,
        unit: str | None = None,
        shape: tuple[int, ...] | None = None,
        doc: str = "",
        name: str | None = None,
        max_connectors: int | None = None,
    ) -> None:
        super().__init__(type, unit=unit, shape=shape, doc=doc, name=name, max_connectors=max_connectors)
        self._open = True
        self._last: T = NOTHING
        """The sample read last, in this cycle of an event context; it sets it aside when the next one begins."""
        self._before: T | None = None
        self._direct: deque[T] = OFF  # the queue that `_fast` is while nobody waits for room in it
        self._plain = False  # whether reading is the same at every connector: no lock, no stamp, no check
        self._read_stamps = 0  # connectors that stamp when a sample is read
        self._tokens: deque[Connector] | None = None
        self._arrivals = 0  # samples that came while there were several connectors
        self._source: Connector | None = None
        self._sole: Connector | None = None
        self._sole_delivered = 0
        self._waiter: asyncio.Future[None] | None = None
        self._wakes: tuple[Callable[[InPort[Any]], None], ...] = ()
        self._armed = False
        self._cross: Any = None  # what its connectors share while a real-time thread is at one (`crossing.py`)

    def bind(self, host: PortHost, name: str) -> InPort[T]:
        """A live port of `host` made after this declaration."""
        port = InPort(self.type, unit=self.unit, shape=self.shape, doc=self.doc, max_connectors=self.max_connectors)
        port._attach(host, name)
        return port

    # -- reading ---------------------------------------------------------------------------------------------------

    def read_nowait(self) -> T:
        """The oldest unread sample.

        Raises:
            WouldBlock: there is none.
        """
        try:
            sample = self._last = self._fast.popleft()
            return sample
        except IndexError:
            pass
        return self._read_general()

    async def read(self) -> T:
        """The oldest unread sample, waiting for one. A cancelled read takes nothing.

        Raises:
            BusyError: another task waits on this port.
            ClosedError: the port was removed.
        """
        turns = self._turns
        if turns.left:
            turns.left -= 1
        else:
            turns.left = UNSUSPENDED
            await give_turn()
        while True:
            if queue := self._fast:
                sample = self._last = queue.popleft()
                return sample
            if self._unread():
                try:
                    return self._read_general()
                except WouldBlock:
                    continue  # gone in this moment, as may be where threads cross without a lock
            await self._wait()

    @property
    def latest(self) -> T | None:
        """The newest unread sample, dropping older ones; asked again it is the same; None before the first."""
        queue = self._fast
        if len(queue) == 1:
            sample = self._last = queue.popleft()
            return sample
        if not queue and queue is not OFF:
            return self._kept()
        return self._latest_general()

    def peek(self) -> T | None:
        """The oldest unread sample, which stays unread; None when there is none."""
        self._bound()
        with self._guard():
            if self._crosses:
                return self.peek()
            connector = self._next()
            return None if connector is None else cast("T", connector._queue[0])

    def drain(self) -> list[T]:
        """Every unread sample, oldest first."""
        self._bound()
        if queue := self._fast:
            samples = list(queue)
            queue.clear()
            self._last = samples[-1]
            return samples
        samples = []
        with self._guard():
            if self._crosses:
                return self.drain()
            while self._unread():
                samples.append(self.read_nowait())
        return samples

    @property
    def is_new(self) -> bool:
        """Whether there is an unread sample; with a pull connector, whether the writer has one."""
        queue = self._fast
        if queue is not OFF:
            return bool(queue)
        self._bound()
        return self._unread()

    @property
    def last_source(self) -> Connector | None:
        """The connector that the sample read last came through; None before the first."""
        sole = self._sole
        # The fast path notes nothing; what it took from its one connector shows in that connector's ledger.
        return self._source if sole is None or sole.delivered == self._sole_delivered else sole

    def read_blocking(self, timeout: float | None = None) -> T:
        """`read` for the thread of a `ThreadContext`: blocks the thread, at most `timeout` seconds (None: for ever).

        Raises:
            ReadTimeout: no sample arrived in time.
            ClosedError: the port was removed or its context is stopping.
        """
        host = self._bound()
        if host.on_loop_thread():
            raise StateError(f"{self.path}: read_blocking would block the event loop; await read() here")
        lock = self._lock
        if lock is None or not host.threaded:
            raise StateError(f"{self.path}: read_blocking is for components of a ThreadContext")
        deadline_ns = host.deadline_ns(timeout)
        with lock:
            while host.wait_in_thread(lock, lambda: self._unread() or self._gone(), deadline_ns):
                try:
                    return self._read_general()
                except WouldBlock:
                    self._raise_if_gone()  # else as in `read`
            raise ReadTimeout(f"{self.path}: no sample within {timeout} s")

    def __aiter__(self) -> AsyncIterator[T]:
        return Samples(self)

    # -- the general path ------------------------------------------------------------------------------------------

    def _guard(self) -> Any:
        return self._lock or UNLOCKED

    def _unread(self) -> bool:
        tokens = self._tokens
        if tokens is not None:
            return bool(tokens)
        sole = self._sole
        return sole is not None and bool(sole._queue)

    def _next(self) -> Connector | None:
        """The connector whose sample is the oldest unread one; the caller holds the lock."""
        tokens = self._tokens
        if tokens is not None:
            return tokens[0] if tokens else None
        sole = self._sole
        return sole if sole is not None and sole._queue else None

    def _newest(self) -> Connector | None:
        """The connector whose sample arrived last of all that are unread; the caller holds the lock."""
        # What a connector still holds ends with its last arrival: reading takes the oldest.
        return max((one for one in self._connectors if one._queue), key=attrgetter("_arrived_at"), default=None)

    def _read_general(self) -> T:
        if self._plain:
            # Several connectors, or somebody waits for room: still no lock and nothing to stamp.
            connector = self._sole
            if tokens := self._tokens:
                connector = self._source = tokens.popleft()
            if connector is not None and (queue := connector._queue):
                sample = self._last = queue.popleft()
                if connector._waiting:
                    connector._admit_waiting()
                return cast("T", sample)
        self._bound()
        with self._guard():
            if self._crosses:
                return self._read_general()
            connector = self._next()
            if connector is None:
                self._raise_if_removed()
                raise WouldBlock(f"{self.path}: no unread sample")
            if self._tokens is not None:
                self._tokens.popleft()
            sample = cast("T", connector.take())
            self._last, self._source = sample, connector
            return sample

    def _latest_general(self) -> T | None:
        self._bound()
        with self._guard():
            if self._crosses:
                return self._latest_general()
            connector = self._newest()
            if connector is None:
                return self._kept()
            sample = cast("T", connector.take_newest())
            for other in self._connectors:
                if other is not connector:
                    other.discard("superseded")
            self._settle_tokens()
            self._last, self._source = sample, connector
            return sample

    def _kept(self) -> T | None:
        return self._before if self._last is NOTHING else self._last

    def _settle_tokens(self) -> None:
        """Rebuild the order of arrival after samples left the queues other than one by one from the front."""
        if self._tokens is None:
            return
        left = {id(connector): len(connector._queue) for connector in self._connectors}
        kept: deque[Connector] = deque()
        for token in reversed(self._tokens):
            if left.get(id(token), 0) > 0:
                left[id(token)] -= 1
                kept.appendleft(token)
        self._tokens = kept

    async def _wait(self) -> None:
        self._raise_if_gone()
        if self._waiter is not None:
            raise BusyError(f"{self.path}: another task waits on this port; one at a time")
        waiter = self._bound().loop.create_future()
        with self._guard():
            # A writer in another thread may have been here since we looked.
            if self._unread():
                return
            self._waiter = waiter
            self._armed = True
        try:
            await waiter
        finally:
            if self._waiter is waiter:
                self._waiter = None
                self._arm()

    def _gone(self) -> bool:
        return self._bound().stopping or self._removed()

    def _raise_if_gone(self) -> None:
        self._raise_if_removed()
        if self._bound().stopping:
            raise ClosedError(f"{self.path}: its context stops")

    # -- called by connectors, contexts and the kernel -----------------------------------------------------------------

    def _arrived(self, connector: Connector, counted: bool) -> None:
        """A sample of `connector` is in its queue; the writer holds the lock."""
        if self._tokens is not None:
            self._arrivals += 1
            connector._arrived_at = self._arrivals
            if not counted:
                self._tokens.append(connector)
        if self._lock is not None:
            self._lock.notify_all()
        if self._armed and (self._waiter is not None or not connector._quiet):
            self._notify_across() if self._lock is not None else self._notify()

    def _notify_across(self) -> None:
        # One wake-up for all that is written until the reader runs: it arms the port again.
        self._armed = False
        self._on_loop(self._notify)

    def _notify(self) -> None:
        """Wake who waits for data. Armed again by whoever reads on."""
        self._armed = False
        waiter, self._waiter = self._waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(None)
        for wake in self._wakes:
            wake(self)

    def _arm(self) -> None:
        self._armed = self._waiter is not None or bool(self._wakes)

    def _make_locked(self) -> None:
        """From now on more than one thread uses this port's queues."""
        if self._lock is None:
            self._lock = PortLock()
            self._refresh()
            for connector in self._connectors:
                connector.out._refresh()

    def _room_made(self) -> None:
        if self._lock is not None:
            self._lock.notify_all()

    def _set_open(self, is_open: bool) -> None:
        """Open with empty buffers, or close and drop what is unread as inactive."""
        with self._guard():
            self._open = is_open
            for connector in self._connectors:
                connector.suspend()
            if self._tokens is not None:
                self._tokens.clear()
            if is_open:
                self._last, self._before = NOTHING, None
                self._source = self._sole = None
            self._refresh()
        for connector in self._connectors:
            connector.out._refresh()

    def _wake_waiter(self) -> None:
        """Let a waiting read find out that the port is gone."""
        if self._lock is not None:
            with self._lock:
                self._lock.notify_all()
        waiter, self._waiter = self._waiter, None
        if waiter is not None and not waiter.done():
            waiter.set_result(None)

    def _refresh(self) -> None:
        connectors = self._connectors
        self._source = self.last_source
        self._sole = connectors[0] if len(connectors) == 1 else None
        self._sole_delivered = 0 if self._sole is None else self._sole.delivered
        if len(connectors) > 1 and self._tokens is None:
            self._tokens = deque(connector for connector in connectors for _ in connector._queue)
        elif len(connectors) <= 1 and self._tokens is not None:
            self._tokens = None
        self._choose_path()

    def _choose_path(self) -> None:
        self._fast = self._direct = OFF
        host, connectors = self._host, self._connectors
        self._plain = self._lock is None and host is not None and not host.debug and not self._read_stamps
        if self._plain and len(connectors) == 1:
            self._direct = connectors[0]._queue
            self._fast = OFF if connectors[0]._waiting else self._direct
