"""Connectors of an in-port that a real-time thread reads or writes: no lock anywhere, so nobody there ever waits.

Each connector has one writing thread and one reading thread. Taking from and adding to a deque are single steps under
the interpreter lock; each thread counts on a side of its own; what was delivered follows. A step that is more than
one of these marks itself, and who reads the ledger looks again until no mark stands. Who waits is woken by the loop:
a real-time thread asks the loop for it, once until it was done, and goes on.

A port or connector becomes one of these, and an ordinary one again, by a change of its class: users hold the object.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Iterator, Mapping
from itertools import count
from types import MappingProxyType
from typing import Any, ClassVar, Final

from aiorts.kernel.connector import Connector, _stamped
from aiorts.kernel.port import UNLOCKED
from aiorts.kernel.waiting import Waiting
from aiorts.model.buffer import Verdict, decide
from aiorts.model.policy import Push, Stamp, admits
from aiorts.model.profile import ConnectorStatistics

__all__ = ("NOTHING", "Arrivals", "CrossingConnector", "Sides", "add", "take_one")

_NEW: Final = Push.NEW
_READ: Final = Stamp.READ
_REFUSE: Final = Verdict.REFUSE
_REPLACE_OLDEST: Final = Verdict.REPLACE_OLDEST
_PATIENCE: Final = 1000
"""Looks at a ledger until one is taken that a thread may have been in the middle of."""
_EAGER: Final = 50
"""Looks before who looks rests in between."""
NOTHING: Final = object()


class Sides:
    """What the threads at a connector count and mark; each field but the deque is written by one thread."""

    __slots__ = ("by_loop", "by_reader", "moving", "places", "reading", "wanted", "writing")

    def __init__(self) -> None:
        self.by_reader: dict[str, int] = {}
        self.by_loop: dict[str, int] = {}
        """What is dropped by a disconnection or at the end of a period."""
        self.writing = self.reading = self.moving = False
        """In the middle of a step: the writer, the reader, the loop."""
        self.places: deque[int] = deque()
        """One for each unread sample: its place in the order of arrival at the in-port. What overwrites takes over the
        place of what it overwrites."""
        self.wanted = False
        """A writer waits for room; set by it before it looks a last time, cleared by the reader who made room."""


class Arrivals:
    """What the connectors of one in-port share."""

    __slots__ = ("asked", "numbers", "threads")

    def __init__(self, first: int, threads: bool) -> None:
        self.numbers: Iterator[int] = count(first)
        self.threads = threads
        """Whether a thread may sleep at this port, in a blocking read or write."""
        self.asked = False
        """Whether the loop was asked to wake such threads and has not done it yet."""


class CrossingConnector(Connector):
    """A connector that a real-time thread reads or writes. See `Connector`."""

    __slots__ = ()
    # Made when it becomes one.
    _cross: Sides
    _waiting: Any
    _dropped: Any
    _crosses = True
    _times_each: ClassVar[bool] = True
    """Whether a send is a sample; of a periodic connector it is a period."""

    # -- the ledger ------------------------------------------------------------------------------------------------

    @property
    def statistics(self) -> ConnectorStatistics:
        """The ledger at one moment, from whatever thread."""
        sides = self._cross
        written, buffered, dropped = self._look()
        for look in range(_PATIENCE):
            marked = sides.writing or sides.reading or sides.moving
            written, buffered, dropped = seen = self._look()
            if not marked and self._look() == seen and not (sides.writing or sides.reading or sides.moving):
                break
            time.sleep(0 if look < _EAGER else 50e-6)  # lets who is in the middle of a step end it
        delivered = written - sum(dropped.values()) - buffered
        return ConnectorStatistics(written, delivered, buffered, MappingProxyType(dropped))

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        return self._look()

    def _look(self) -> tuple[int, int, dict[str, int]]:
        sides, dropped = self._cross, dict(self._dropped)
        for side in (sides.by_reader, sides.by_loop):
            for reason, number in dict(side).items():
                dropped[reason] = dropped.get(reason, 0) + number
        return self._written, self._buffered, dropped

    @property
    def delivered(self) -> int:
        return self.statistics.delivered

    @property
    def direct(self) -> bool:
        return False

    def _guard(self) -> Any:
        return UNLOCKED

    # -- the writer's thread ---------------------------------------------------------------------------------------

    def offer(self, sample: Any) -> bool:
        if self.closed:
            return True
        sides = self._cross
        sides.writing = True
        try:
            self._written += 1
            if not self.in_._open:
                self._drop("inactive")
                return True
            if not admits(self._push, self._skip, self._written):
                self._drop("skipped")
                return True
            return self._store(sample)
        finally:
            sides.writing = False

    def refuse(self, reason: str) -> None:
        self._cross.writing = True
        self._written += 1
        self._drop(reason)
        self._cross.writing = False

    def wait_for_room(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting | None:
        if not self.must_wait():
            self.offer(sample)
            return None
        entry = Waiting(self, sample, future)
        self._waiting.append(entry)
        if future is not None:
            self._admit_waiting()
        return entry

    def moved(self, entry: Waiting) -> bool:
        waiting = self._waiting
        while waiting and not entry.done:
            # Asked for before looked at: room that is made in between is told.
            self._cross.wanted = True
            if not self._move(waiting[0]):
                break
        return entry.done

    def _admit_waiting(self) -> None:
        """On the loop, which is where writers wait that are not in a thread."""
        waiting = self._waiting
        while waiting and waiting[0].future is not None:
            self._cross.wanted = True
            if not self._move(waiting[0]):
                break

    def _move(self, entry: Waiting) -> bool:
        """Move the sample that waits longest in, or drop it when nobody takes it any more; False: there is no room."""
        sides = self._cross
        sides.writing = True
        try:
            reason = self._refused()
            if not reason and not admits(self._push, self._skip, self._written + 1):
                reason = "skipped"
            if not reason and len(self._queue) >= self._length:
                return False
            self._waiting.popleft()
            self._written += 1
            if reason:
                self._drop(reason)
            else:
                self._append(self._stamp_in(entry.sample), False, self._dropped)
        finally:
            sides.writing = False
        entry.done = True
        if entry.future is not None and not entry.future.done():
            entry.future.set_result(None)
        return True

    def _refused(self) -> str:
        """Why nothing comes in any more, if that is so."""
        return "disconnected" if self.closed else "" if self.in_._open else "inactive"

    def _store(self, sample: Any) -> bool:
        if self._push is not _NEW:
            return self._put(sample, self._dropped)
        sample = self._stamp_in(sample)
        if not self._replace_newest(sample, "superseded", self._dropped):
            self._append(sample, False, self._dropped)
        return True

    def _store_bounded(self, sample: Any) -> bool:
        return self._put(sample, self._dropped)

    def _put(self, sample: Any, dropped: dict[str, int]) -> bool:
        """Store a sample as the full policy says, counting in `dropped` of the thread that does it."""
        queue, replaces = self._queue, False
        verdict = decide(len(queue), self._length, self._full)
        if verdict is _REFUSE:
            add(dropped, "rejected")
            return False
        sample = self._stamp_in(sample)
        if verdict is _REPLACE_OLDEST:
            if self._length == 1 and self._replace_newest(sample, "overwritten", dropped):
                return True
            replaces = take_one(queue) is not NOTHING  # the reader may have been faster
            if replaces:
                add(dropped, "overwritten")
        self._append(sample, replaces, dropped)
        return True

    def _replace_newest(self, sample: Any, reason: str, dropped: dict[str, int]) -> bool:
        """In one step, so that the reader never finds nothing; False when it has taken everything."""
        times = self._times if self._times_each else None
        began_ns = 0 if times is None else self._monotonic_ns()
        try:
            self._queue[-1] = sample
        except IndexError:
            return False
        add(dropped, reason)
        self._arrived_at = next(self.in_._cross.numbers)
        self._settle(dropped, True)
        if times is not None:
            times.add(began_ns, self._monotonic_ns())
        return True

    def _append(self, sample: Any, counted: bool, dropped: dict[str, int]) -> None:
        times = self._times if self._times_each else None
        began_ns = 0 if times is None else self._monotonic_ns()
        self._arrived_at = place = next(self.in_._cross.numbers)
        if not counted:
            self._cross.places.append(place)
        self._queue.append(sample)
        self._settle(dropped, counted)
        if times is not None:
            times.add(began_ns, self._monotonic_ns())

    def _settle(self, dropped: dict[str, int], counted: bool) -> None:
        """The sample is in: tell the reader, or take it back if the end came while it was put in."""
        reason = self._refused()
        if not reason:
            self.in_._arrived(self, counted)
        elif take_one(self._queue, newest=True) is not NOTHING:
            take_one(self._cross.places, newest=True)
            add(dropped, reason)

    # -- the reader's thread ---------------------------------------------------------------------------------------

    def take(self) -> Any:
        """The oldest sample; IndexError when it was overwritten or disconnected in this moment."""
        sample = self._queue.popleft()
        take_one(self._cross.places)
        self._room_made()
        return sample if self._stamp is not _READ else _stamped(sample, self._clock_ns())

    def take_all(self) -> tuple[Any, int]:
        """The newest sample and how many were taken; what is written meanwhile stays."""
        sample, number = None, 0
        for _ in range(len(self._queue)):
            taken = take_one(self._queue)
            if taken is NOTHING:
                break
            take_one(self._cross.places)
            sample, number = taken, number + 1
        return sample, number

    def take_newest(self) -> Any:
        self._cross.reading = True
        sample, number = self.take_all()
        self.superseded(number - 1)
        if not number:
            raise IndexError(self.name)
        return sample if self._stamp is not _READ else _stamped(sample, self._clock_ns())

    def superseded(self, number: int) -> None:
        """Of the samples that were taken so many are not read."""
        if number > 0:
            add(self._cross.by_reader, "superseded", number)
        self._cross.reading = False
        self._room_made()

    def discard(self, reason: str) -> None:
        sides = self._cross
        sides.reading = True
        number = self._empty()
        if number:
            add(sides.by_reader, reason, number)
        sides.reading = False
        self._room_made()

    def suspend(self) -> None:
        self.discard("inactive")

    def _room_made(self) -> None:
        sides = self._cross
        if sides.wanted:
            sides.wanted = False
            host = self.out._host
            if host is not None and host.threaded:
                self.in_._tell_threads()  # type: ignore[attr-defined] # it is a CrossingInPort
            else:
                self.in_._on_loop(self._admit_waiting)

    def _empty(self) -> int:
        """Take everything out; how much that was."""
        number = self.take_all()[1]
        return number

    # -- the loop --------------------------------------------------------------------------------------------------

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        sides = self._cross
        sides.moving = True
        number = self._empty()
        if number:
            add(sides.by_loop, "disconnected", number)
        sides.moving = False
        sides.wanted = True
        self._room_made()


def take_one(queue: deque[Any], *, newest: bool = False) -> Any:
    """One item, or NOTHING."""
    try:
        return queue.pop() if newest else queue.popleft()
    except IndexError:
        return NOTHING


def add(dropped: dict[str, int], reason: str, number: int = 1) -> None:
    dropped[reason] = dropped.get(reason, 0) + number
