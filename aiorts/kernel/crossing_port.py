"""The in-port of crossing connectors (`crossing.py`): read in the order of arrival by one thread, without a lock.

What a reader finds may be gone in the next step, overwritten or disconnected: then it looks again.
"""

from __future__ import annotations

from typing import Any, Final, TypeVar

from anyio import WouldBlock

from aiorts.errors import BusyError
from aiorts.kernel.connector import Connector, _stamped
from aiorts.kernel.crossing import Arrivals, CrossingConnector
from aiorts.kernel.in_port import InPort
from aiorts.kernel.port import NOTHING, OFF, UNLOCKED
from aiorts.model.policy import Stamp

__all__ = ("CrossingInPort",)

T = TypeVar("T")

_READ: Final = Stamp.READ


class CrossingInPort(InPort[T]):
    """An in-port whose connectors cross into or out of a real-time thread. See `InPort`."""

    __slots__ = ()
    _crosses = True
    _cross: Arrivals

    def peek(self) -> T | None:
        self._bound()
        while (connector := self._next()) is not None:
            try:
                sample: T = connector._queue[0]
            except IndexError:
                continue
            return sample
        return None

    def drain(self) -> list[T]:
        samples: list[T] = []
        try:
            # What is written meanwhile is for the next time: a fast writer must not keep the reader here.
            for _ in range(sum(len(connector._queue) for connector in self._connectors)):
                samples.append(self._read_general())  # noqa: PERF401 - what was read before an end counts
        except WouldBlock:
            pass
        return samples

    def _guard(self) -> Any:
        return UNLOCKED

    def _unread(self) -> bool:
        return any(connector._queue for connector in self._connectors)

    def _next(self) -> Connector | None:
        first, least = None, 0
        for connector in self._connectors:
            if connector._queue:
                places = connector._cross.places
                try:
                    place = places[0]
                except IndexError:
                    place = 0
                if first is None or place < least:
                    first, least = connector, place
        return first

    def _read_general(self) -> T:
        self._bound()
        while (connector := self._next()) is not None:
            try:
                sample: T = connector.take()
            except IndexError:
                continue  # overwritten or disconnected in this moment
            self._last, self._source = sample, connector
            return sample
        self._raise_if_removed()
        raise WouldBlock(f"{self.path}: no unread sample")

    def _latest_general(self) -> T | None:
        self._bound()
        taken: list[tuple[int, Any, CrossingConnector, int]] = []
        for connector in self._connectors:
            assert isinstance(connector, CrossingConnector)  # noqa: S101 - all of a crossing port are
            if connector._queue:
                connector._cross.reading = True
                sample, number = connector.take_all()
                taken.append((connector._arrived_at if number else -1, sample, connector, number))
        newest = max(taken, key=lambda one: one[0], default=None)
        for one in taken:
            one[2].superseded(one[3] - (one is newest))
        if newest is None or newest[0] < 0:
            return self._kept()
        chosen: T = newest[1]
        if newest[2]._stamp is _READ:
            chosen = _stamped(chosen, newest[2]._clock_ns())
        self._last, self._source = chosen, newest[2]
        return chosen

    async def _wait(self) -> None:
        self._raise_if_gone()
        host = self._bound()
        if host.realtime and not host.on_loop_thread():
            raise WouldBlock(f"{self.path}: no unread sample, and a hook of a real-time context cannot wait for one")
        if self._waiter is not None:
            raise BusyError(f"{self.path}: another task waits on this port; one at a time")
        self._waiter = waiter = host.loop.create_future()
        self._armed = True
        try:
            # Armed before looked at: what is written in between wakes this up.
            if not self._unread():
                await waiter
        finally:
            if self._waiter is waiter:
                self._waiter = None
                self._arm()

    def _arrived(self, connector: Connector, counted: bool) -> None:
        if self._cross.threads:
            self._tell_threads()
        if self._armed and (self._waiter is not None or not connector._quiet):
            self._notify_across()

    def _tell_threads(self) -> None:
        """Have the loop wake threads that sleep at this port: their lock is not for everybody."""
        if not self._cross.asked:
            self._cross.asked = True
            self._on_loop(self._wake_threads)

    def _wake_threads(self) -> None:
        self._cross.asked = False
        if self._lock is not None:
            with self._lock:
                self._lock.notify_all()

    def _make_locked(self) -> None:
        self._cross.threads = True

    def _room_made(self) -> None:
        self._tell_threads()

    def _settle_tokens(self) -> None:
        """There are none: each connector knows the places of its samples."""

    def _set_open(self, is_open: bool) -> None:
        if not is_open:
            self._open = False
        for connector in self._connectors:
            connector.suspend()
            if connector._waiting:
                connector._cross.wanted = True
                connector._room_made()  # type: ignore[attr-defined] # all of a crossing port are crossing
        if is_open:
            self._last, self._before = NOTHING, None
            self._source = None
            self._open = True

    def _refresh(self) -> None:
        self._sole = None
        self._choose_path()

    def _choose_path(self) -> None:
        self._fast = self._direct = OFF
        self._plain = False
