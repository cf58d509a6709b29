"""Transports to an in-port that a real-time thread reads or writes: no lock anywhere, so that thread never waits.

Each transport has one writing thread and one reading thread. Taking from and adding to a deque are single steps under
the interpreter lock; each thread counts on a side of its own; what was delivered follows. A step that is more than
one of these marks itself, and a reader of the ledger looks again until no mark stands. Waiting threads are woken by
the loop: a real-time thread asks the loop for it, once until it was done, and goes on.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Iterator, Mapping
from itertools import count
from operator import methodcaller
from typing import TYPE_CHECKING, Any, ClassVar, Final

from aiorts.errors import StateError
from aiorts.kernel.ports.figures import statistics_of
from aiorts.kernel.ports.port import NOTHING, UNLOCKED, host_of
from aiorts.kernel.ports.transport import Transport, Waiting
from aiorts.model.buffer import Verdict, decide
from aiorts.model.policy import Push
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics

if TYPE_CHECKING:
    from aiorts.kernel.ports.receiver import Receiver


_NEW: Final = Push.NEW
_REFUSE: Final = Verdict.REFUSE
_REPLACE_OLDEST: Final = Verdict.REPLACE_OLDEST
_PATIENCE: Final = 1000
"""Looks at a ledger until one is taken during which a thread may have been in the middle of a step."""
_EAGER: Final = 50
"""Looks at a ledger after which the thread rests between two looks."""
EMPTY: Final = object()
"""The result of `take_one` for an empty queue."""


class _Sides:
    """The counts and marks of the threads at a transport; each field but the deque is written by one thread."""

    __slots__ = ("by_loop", "by_reader", "moving", "places", "reading", "wanted", "writing")

    def __init__(self) -> None:
        self.by_reader: dict[str, int] = {}
        self.by_loop: dict[str, int] = {}
        """Samples dropped by a disconnection or at the end of a period, by reason."""
        self.writing = self.reading = self.moving = False
        """Whether the writer, the reader, the loop is in the middle of a step."""
        self.places: deque[int] = deque()
        """The place of each unread sample in the order of arrival at the in-port."""
        self.wanted = False
        """Whether a writer waits for room: set by it before its last look, cleared by the reader that makes room."""


class Numbers:
    """The numbers and marks that the transports to one in-port share."""

    __slots__ = ("numbers", "requested", "threads", "transports", "unread")

    def __init__(self, first: int, threads: bool) -> None:
        self.numbers: Iterator[int] = count(first)
        self.transports: tuple[Any, ...] = ()
        """All of the transports, laid out for the reader."""
        self.unread: dict[Transport, list[int]] = {}
        """The places of earlier samples, by transports that are not lock-free yet."""
        self.threads = threads
        """Whether a thread may sleep at this port, in a blocking read or write."""
        self.requested = False
        """Whether the loop was asked to wake such threads and has not done it yet."""


class LockFreeTransport(Transport):
    """A transport that a real-time thread reads or writes. See `Transport`."""

    __slots__ = ()
    extra: _Sides
    waiting: Any
    dropped: Any
    listenable = False
    times_each: ClassVar[bool] = True
    """Whether a send is one sample; in a periodic transport it is a period."""

    def take_over(self, old: Transport, receiver: Receiver) -> None:
        super().take_over(old, receiver)
        self.dropped = dict(self.dropped)
        self.waiting = deque(self.waiting or ())
        self.extra = _Sides()
        self.extra.wanted = bool(self.waiting)
        self.extra.places.extend(receiver.extra.unread.pop(old, ()))
        if (newest := old.held()) is not NOTHING:
            self.miss(newest)

    def held(self) -> Any:
        """NOTHING: a sample in the queue may be gone in the next step. The out-port keeps each that is written."""
        return NOTHING

    def hand_over(self) -> None:
        self.missed = self.position
        sides = self.extra
        for side in (sides.by_reader, sides.by_loop):
            for reason, number in side.items():
                self.drop(reason, number)
        self.waiting = OrderedDict.fromkeys(self.waiting)

    def leave_line(self, entry: Waiting) -> bool:
        try:
            self.waiting.remove(entry)  # a deque: both sides use it without a lock
        except ValueError:
            return False
        return True

    def change(self, profile: ConnectorProfile) -> None:
        raise StateError(
            f"{self.connector.name}: change: a real-time thread is at one of its ends, which takes no other options "
            "while it runs; take that component out of its context first, or disconnect and connect anew"
        )

    # -- the ledger ------------------------------------------------------------------------------------------------

    def statistics(self) -> ConnectorStatistics:
        """The ledger at one moment; for any thread."""
        sides = self.extra
        written, buffered, dropped = self._look()
        for look in range(_PATIENCE):
            marked = sides.writing or sides.reading or sides.moving
            written, buffered, dropped = seen = self._look()
            if not marked and self._look() == seen and not (sides.writing or sides.reading or sides.moving):
                break
            time.sleep(0 if look < _EAGER else 50e-6)  # lets a thread in the middle of a step end it
        delivered = written - sum(dropped.values()) - buffered
        return statistics_of(self, written, delivered, buffered, dropped)

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        return self._look()

    def _look(self) -> tuple[int, int, dict[str, int]]:
        sides, dropped = self.extra, dict(self.dropped)
        for side in (sides.by_reader, sides.by_loop):
            for reason, number in dict(side).items():
                dropped[reason] = dropped.get(reason, 0) + number
        return self.written, self.buffered, dropped

    def delivered(self) -> int:
        return self.statistics().arrived

    @property
    def direct(self) -> bool:
        return False

    def guard(self) -> Any:
        return UNLOCKED

    # -- the writer's thread ---------------------------------------------------------------------------------------

    def offer(self, sample: Any) -> bool:
        if self.closed:
            return True
        self.miss(sample)
        sides = self.extra
        sides.writing = True
        try:
            admitted = self.admits_next()
            self.written += 1
            if not self.receiver.open:
                self.drop("inactive")
                return True
            if not admitted:
                self.drop("skipped")
                return True
            return self.store(sample)
        finally:
            sides.writing = False

    def time_out(self, entry: Waiting) -> None:
        self.extra.writing = True
        self.written += 1
        self.drop("timeout")
        self.extra.writing = False

    def wait_for_room(
        self, sample: Any, future: asyncio.Future[None] | None, *, patient: bool = False
    ) -> Waiting | None:
        if not self.must_wait():
            self.offer(sample)
            return None
        entry = Waiting(self.connector, sample, future)
        self.waiting.append(entry)
        self.miss(sample)
        if future is not None:
            self.admit_waiting()
        return entry

    def moved(self, entry: Waiting) -> bool:
        waiting = self.waiting
        while waiting and not entry.done:
            # Set before the look: room that is made in between is noticed.
            self.extra.wanted = True
            if not self._move(waiting[0]):
                break
        return entry.done

    def admit_waiting(self) -> None:
        """Move in the samples of tasks that wait, on the loop; threads move in theirs themselves."""
        waiting = self.waiting
        while waiting and waiting[0].future is not None:
            self.extra.wanted = True
            if not self._move(waiting[0]):
                break

    def _move(self, entry: Waiting) -> bool:
        """Move in the sample that waits longest, or drop it if the reader is closed; False: there is no room."""
        sides = self.extra
        sides.writing = True
        try:
            reason = self.refused()
            if not reason and not self.admits_next():
                reason = "skipped"
            if not reason and len(self.queue) >= self.length:
                return False
            self.waiting.popleft()
            self.written += 1
            if reason:
                self.drop(reason)
            else:
                self.append(self.stamp_in(entry.sample), self.dropped)
        finally:
            sides.writing = False
        entry.done = True
        if entry.future is not None and not entry.future.done():
            entry.future.set_result(None)
        return True

    def refused(self) -> str:
        """The reason why no sample comes in any more; "" where samples do."""
        return "disconnected" if self.closed else "" if self.receiver.open else "inactive"

    def store(self, sample: Any) -> bool:
        if self.push is not _NEW:
            return self.put(sample, self.dropped)
        sample = self.stamp_in(sample)
        if not self.replace_newest(sample, "superseded", self.dropped):
            self.append(sample, self.dropped)
        return True

    def store_bounded(self, sample: Any) -> bool:
        return self.put(sample, self.dropped)

    def put(self, sample: Any, dropped: dict[str, int]) -> bool:
        """Store a sample as the full policy says, counting in `dropped` of the thread that does it."""
        queue = self.queue
        verdict = decide(len(queue), self.length, self.connector.profile.full)
        if verdict is _REFUSE:
            add(dropped, "rejected")
            return False
        sample = self.stamp_in(sample)
        if verdict is _REPLACE_OLDEST:
            if self.length == 1 >= len(queue) and self.replace_newest(sample, "overwritten", dropped):
                return True
            if take_one(queue) is not EMPTY:  # else the reader was faster
                take_one(self.extra.places)
                add(dropped, "overwritten")
        self.append(sample, dropped)
        return True

    def replace_newest(self, sample: Any, reason: str, dropped: dict[str, int]) -> bool:
        """Replace the newest sample in one step, so that the reader never finds none; False: it has taken all."""
        times = self.times if self.times_each else None
        began_ns = 0 if times is None else self.clock.monotonic_ns()
        try:
            self.queue[-1] = sample
        except IndexError:
            return False
        add(dropped, reason)
        self.arrived_at = place = next(self.receiver.extra.numbers)
        try:  # noqa: SIM105 - one step of a real-time thread, without a call
            self.extra.places[-1] = place
        except IndexError:
            pass  # the reader has taken the sample meanwhile, and its place
        self._settle(dropped)
        if times is not None:
            times.add(began_ns, self.clock.monotonic_ns())
        return True

    def append(self, sample: Any, dropped: dict[str, int]) -> None:
        times = self.times if self.times_each else None
        began_ns = 0 if times is None else self.clock.monotonic_ns()
        self.arrived_at = place = next(self.receiver.extra.numbers)
        self.extra.places.append(place)
        self.queue.append(sample)
        self._settle(dropped)
        if times is not None:
            times.add(began_ns, self.clock.monotonic_ns())

    def _settle(self, dropped: dict[str, int]) -> None:
        """Notify the reader of a stored sample, or remove the sample if the connector ended while it was stored."""
        reason = self.refused()
        if not reason:
            self.receiver.arrived(self, False)
        elif take_one(self.queue, newest=True) is not EMPTY:
            take_one(self.extra.places, newest=True)
            add(dropped, reason)

    # -- the reader's thread ---------------------------------------------------------------------------------------

    def take(self) -> Any:
        """Take the oldest sample. IndexError: it was overwritten or disconnected in this moment."""
        sample = self.queue.popleft()
        take_one(self.extra.places)
        self.room_made()
        return self.stamp_out(sample)

    def take_all(self) -> tuple[Any, int]:
        """Take all samples; the newest one and their number. Samples written meanwhile stay."""
        sample, number = None, 0
        for _ in range(len(self.queue)):
            taken = take_one(self.queue)
            if taken is EMPTY:
                break
            take_one(self.extra.places)
            sample, number = taken, number + 1
        return sample, number

    def take_newest(self) -> Any:
        self.extra.reading = True
        sample, number = self.take_all()
        self.superseded(number - 1)
        if not number:
            raise IndexError(self.connector.name)
        return self.stamp_out(sample)

    def superseded(self, number: int) -> None:
        """Count so many of the taken samples as superseded: they are not read."""
        if number > 0:
            add(self.extra.by_reader, "superseded", number)
        self.extra.reading = False
        self.room_made()

    def discard(self, reason: str) -> None:
        sides = self.extra
        sides.reading = True
        number = self.empty()
        if number:
            add(sides.by_reader, reason, number)
        sides.reading = False
        self.room_made()

    def suspend(self) -> None:
        self.discard("inactive")

    def room_made(self) -> None:
        """A queue has room again: move in the samples that wait for it."""
        sides = self.extra
        if sides.wanted:
            sides.wanted = False
            host = host_of(self.connector.out)
            if host is not None and host.threaded:
                self.receiver.room_made()
            else:
                self.on_loop(methodcaller("admit_waiting"))

    def empty(self) -> int:
        """Remove all samples; return their number."""
        number = self.take_all()[1]
        return number

    # -- the loop --------------------------------------------------------------------------------------------------

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        sides = self.extra
        sides.moving = True
        number = self.empty()
        if number:
            add(sides.by_loop, "disconnected", number)
        sides.moving = False
        sides.wanted = True
        self.room_made()


def take_one(queue: deque[Any], *, newest: bool = False) -> Any:
    """Take one item of a queue; EMPTY if it has none."""
    try:
        return queue.pop() if newest else queue.popleft()
    except IndexError:
        return EMPTY


def add(dropped: dict[str, int], reason: str, number: int = 1) -> None:
    dropped[reason] = dropped.get(reason, 0) + number
