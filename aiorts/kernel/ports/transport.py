"""The transport of a connector: one bounded queue at the reader, and the ledger.

`OutPort` and `InPort` inline the common case (`out_port.py`, `in_port.py`) and come here for everything else.

Only `written` and drops are counted; what was delivered follows from them, so the ledger balances at any moment. An
out-port counts the samples for all its direct connectors once, in `OutPort._sent`; each transport counts in `displaced`
what its full buffer lost. Reading the counts adds both. `model/` decides, this file carries out.

Across threads the receiver has a lock and no fast path; every method here that touches the receiver's queues takes the
lock. The transport may be replaced while a method waits for the lock: `at_current` runs the method on the current one.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Protocol

from aiorts.kernel.ports.current import at_current
from aiorts.kernel.ports.figures import statistics_of
from aiorts.kernel.ports.port import NOTHING, OFF, UNLOCKED
from aiorts.kernel.ports.port_types import stamped
from aiorts.late import dataclass
from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription, admits
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics
from aiorts.model.timing import ConnectorTimes

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.receiver import Receiver


# Enum members as globals: on CPython 3.11 a look-up in the Enum class costs eight times as much.
_NEW = Push.NEW
_SKIP = Push.SKIP
_BLOCK = FullPolicy.BLOCK
_PULL = Dataflow.PULL
_READ = Stamp.READ
_ON_THE_WAY = (Stamp.SEND, Stamp.RECEIVED)
_REFUSE = Verdict.REFUSE
_REPLACE_OLDEST = Verdict.REPLACE_OLDEST
_WAIT = Verdict.WAIT
_DISPLACED: Final = {FullPolicy.OVERWRITE: "overwritten", FullPolicy.REJECT: "rejected"}
_CARRIED_ON: Final = (
    "arrived_at", "dead", "dropped", "last", "listeners", "losses", "missed", "offered", "queue", "written",
)  # fmt: skip
"""The attributes that a connector keeps when it gets other options."""
_NO_DROPS: Final[Mapping[str, int]] = MappingProxyType({})


class Kind(Protocol):
    """A row of the table of transports, as transports and receivers use it: see `TransportKind` in `features.py`."""

    def of(self, profile: ConnectorProfile) -> type[Transport]: ...
    def receiver_of(self, connectors: Iterable[Connector]) -> type[Receiver]: ...


class LossListener(Protocol):
    """A listener for the first sample that a transport loses."""

    def begin(self, connector: Connector) -> None: ...


@dataclass(eq=False, slots=True)
class Waiting:
    """A sample whose writer waits for room: the reader that makes room moves the sample into the queue.

    A writer in a thread has no future and waits on the receiver's lock.
    """

    connector: Connector
    sample: Any
    future: asyncio.Future[None] | None
    done: bool = False
    refused: ClassVar[bool] = False
    """Whether the reader had no room for the sample after all, so that the write returns False."""
    late: ClassVar[bool] = False
    """Whether the write timed out, where the transport keeps the timeout (`send_now`)."""


class Transport:
    """Carries the samples of one connector in a bounded queue, which a sample enters as soon as it is written.

    The transport classes of each `TransportKind` (`features.py`) derive from this class. `replace` puts a transport of
    another kind in its place.
    """

    __slots__ = (
        "arrived_at",
        "clock",
        "closed",
        "connector",
        "dead",
        "displaced",
        "dropped",
        "extra",
        "last",
        "length",
        "listeners",
        "losses",
        "missed",
        "offered",
        "push",
        "queue",
        "receiver",
        "shared",
        "times",
        "waiting",
        "written",
    )

    kind: ClassVar[Kind]
    """The row of the table of transports that names this class."""
    admits_plainly: ClassVar[bool] = True
    """Whether samples that wait for room may be moved in without a call for each."""
    answers: ClassVar[bool] = False
    """Whether a write waits for an answer: `send_now` may send its sample."""
    listenable: ClassVar[bool] = True
    """Whether the transport may have listeners: no real-time thread uses it."""

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        profile = connector.profile
        self.connector = connector
        self.receiver = receiver
        self.closed = False
        self.queue: deque[Any] = deque()
        self.length = profile.length
        # Pull: the writer keeps its latest unread sample until the reader asks; data wake no reader.
        chosen = Push.ALL if profile.subscription is Subscription.FLUSH else profile.push
        if profile.far_end == "writer" and chosen is _SKIP:
            chosen = Push.ALL  # the writer's end leaves out what is skipped
        self.push = _NEW if profile.dataflow is _PULL else chosen
        self.arrived_at = 0
        """The number of the newest sample in the receiver's count of arrivals, while it has several connectors."""
        self.dead = 0
        """The number of dead tokens (`receiver.py`) of this transport: at most `length`, or as many as are unread."""
        self.waiting: OrderedDict[Waiting, None] | None = None  # no deque: thousands that give up would search it
        """The writers that wait for room; while any writer waits, the buffer is full. None before the first."""
        self.clock = kernel.clock
        self.times = ConnectorTimes(profile.measure, kernel.clock.monotonic_ns()) if profile.measure else None
        self.losses: LossListener | Literal[False] | None = None
        """The listener for the next overwritten sample; None: losses are not reported; False: it was notified."""
        self.last: Any = NOTHING
        """The sample of this connector that was last read on the general path."""
        self.missed = 0
        """The `position` of the last sample that was lost here and that the out-port keeps."""
        self.offered = 0
        """The number of samples in `written` that `keep_last` offered: the push policy does not count these."""
        self.extra: Any = None
        """Data that another kind of transport, or a feature, keeps in addition."""
        self.listeners: Any = None
        """The listeners (`observe/listening.py`); a real-time thread here keeps samples from them, but they stay."""
        self.written = 0
        """Samples written, without those that the out-port counts for all of its direct connectors."""
        self.shared = False
        """Whether the out-port's `_sent` counts samples for this connector, too."""
        self.displaced = 0
        """The number of samples that a full buffer displaced or refused, and that `dropped` does not include yet."""
        self.dropped: Mapping[str, int] = _NO_DROPS

    @property
    def current(self) -> Transport:
        """The transport that the connector has now."""
        return self.connector._transport

    def replace(self, kind: Kind, receiver: Receiver) -> None:
        """Put a transport of another kind, with this one's samples, waiting writers and counts, in its place.

        On the loop; the caller holds the lock, and has the ports update their fast path afterwards.
        """
        # The out-port's `_sent` counts for direct connectors only.
        self.share(False, self.connector.out._sent)
        self.count_displaced()
        self.hand_over()
        new_class = kind.of(self.connector.profile)
        new = new_class.__new__(new_class)
        new.take_over(self, receiver)
        self.connector._transport = new
        receiver.exchange(self, new)

    def hand_over(self) -> None:
        """Bring what this holds into the form that every kind takes over."""

    def take_over(self, old: Transport, receiver: Receiver) -> None:
        """Take the state of the transport `old`, which carries no more samples."""
        for name in Transport.__slots__:
            setattr(self, name, getattr(old, name))
        self.receiver = receiver
        self.extra = None

    def change(self, profile: ConnectorProfile) -> None:
        """Put other options in force, on the loop. Samples whose writers need not wait any more are moved in."""
        with self.guard():
            self.settle()
            self.count_displaced()
            if profile.full is not _BLOCK:
                self.admit_all()
            self.connector.profile = profile
            self.length = profile.length
            self.admit_waiting()
        self.connector.out._refresh()

    def carry_on(self, old: Transport) -> None:
        """Continue the work of `old`, which has other options and carries no more samples; the caller locks."""
        for name in _CARRIED_ON:
            setattr(self, name, getattr(old, name))
        if old.times is not None and self.times is not None and old.times.ages.maxlen == self.times.ages.maxlen:
            self.times = old.times
        for sample in old.leave_off():
            self.queue.append(sample)
            self.receiver.arrived(self, 0)

    def leave_off(self) -> Iterable[Any]:
        """Cancel later work, and return the samples that have not reached the reader's queue; the caller locks."""
        return ()

    # -- the ledger ------------------------------------------------------------------------------------------------

    @at_current
    def statistics(self) -> ConnectorStatistics:
        """See `Connector.statistics`."""
        host = self.connector.in_._host
        if self.receiver.lock is None and host is not None:
            host.check_loop_thread(f"{self.connector.name}: statistics")
        self.settle()
        delivered = self.delivered()
        return statistics_of(self, self.total(), delivered, self.buffered, self.dropped)

    @at_current
    def delivered(self) -> int:
        """Samples that were read: what was written, less what was dropped and what is still buffered."""
        self.count_displaced()
        return self.total() - sum(self.dropped.values()) - self.buffered

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        """The samples written, buffered, and dropped by reason; from any thread, without a lock, without a change.

        Made for diagnosing a process that is stuck; inexact while the connector is used, unlike `statistics`.
        """
        dropped = dict(self.dropped)
        if displaced := self.displaced:
            reason = "superseded" if self.push is _NEW else _DISPLACED[self.connector.profile.full]
            dropped[reason] = dropped.get(reason, 0) + displaced
        return self.total(), self.buffered, dropped

    @property
    def buffered(self) -> int:
        """Samples that are neither read nor dropped."""
        return len(self.queue)

    def total(self) -> int:
        """Samples written."""
        return self.written + self.connector.out._sent if self.shared else self.written

    def share(self, shared: bool, sent: int) -> None:
        """Let the out-port count for this connector from now on, or no longer; `sent`: the out-port's count so far."""
        if shared is not self.shared:
            self.shared = shared
            self.written += -sent if shared else sent

    def count_displaced(self) -> None:
        """Count what a full buffer has displaced since the last call."""
        if displaced := self.displaced:
            reason = "superseded" if self.push is _NEW else _DISPLACED[self.connector.profile.full]
            self.displaced = 0
            self._note_drop(reason, displaced)

    def settle(self) -> None:
        """Remove what may not be read any more from the queue, before the queue is read."""

    def drop(self, reason: str, count: int = 1) -> None:
        """Count `count` samples as dropped for `reason`."""
        self.count_displaced()
        self._note_drop(reason, count)

    def _note_drop(self, reason: str, count: int) -> None:
        dropped = self.dropped
        if reason == "inactive" and reason not in dropped and (host := self.connector.in_._host) is not None:
            host.dropped_first(self.connector)
        if not isinstance(dropped, dict):
            dropped = self.dropped = {}
        dropped[reason] = dropped.get(reason, 0) + count

    # -- what ports ask --------------------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """Whether the reader takes samples."""
        return self.receiver.open

    @property
    def pulls(self) -> bool:
        """Whether the reader asks for samples and is not woken by them."""
        return self.connector.profile.dataflow is _PULL

    @property
    def wakes(self) -> bool:
        """Whether a sample that is written now wakes the reader in the writer's thread."""
        receiver = self.receiver
        return receiver.notify_enabled and receiver.open and (receiver.waiter is not None or not self.pulls)

    @property
    def direct(self) -> bool:
        """Whether a write may go straight into the queue: there is nothing to choose, stamp or lock."""
        profile, receiver = self.connector.profile, self.receiver
        return (
            not self.closed
            and profile.dataflow is not _PULL
            and self.push is not _SKIP
            and profile.stamp is None
            and self.times is None
            and receiver.open
            and receiver.lock is None
            and not (self.blocks and self.retired)
        )

    @property
    def room(self) -> int:
        """How many unread samples the queue may hold."""
        return 1 if self.push is _NEW else self.length

    @property
    def keeps(self) -> bool:
        """Whether a full buffer keeps its samples, and no new one replaces them."""
        return self.push is not _NEW and self.connector.profile.full is not FullPolicy.OVERWRITE

    @property
    def when_full(self) -> bool | LossListener:
        """`keeps`, or, if a full buffer loses its samples, the listener to notify of the loss."""
        return self.keeps or self.losses or False

    @property
    def blocks(self) -> bool:
        """Whether a writer waits while the buffer is full."""
        return self.push is not _NEW and self.connector.profile.full is _BLOCK

    @property
    def retired(self) -> bool:
        """Whether no context runs the reader any more: samples without room are dropped{inactive}, no writer waits."""
        host = self.connector.in_._host
        return host is not None and host.retired

    def must_wait(self) -> bool:
        """Whether a sample written now would have to wait for room."""
        return self.blocks and self._lacks_room()

    def _lacks_room(self) -> bool:
        """Whether a sample written now is for the queue, and the queue is full."""
        if self.closed or not self.receiver.open or self.retired:
            return False
        if len(self.queue) < self.length and not self.waiting:
            return False
        return self.admits_next()

    @property
    def is_awaited(self) -> bool:
        """Whether `write_nowait` is possible although `must_wait` is true: a waiting read will take the sample."""
        return False

    def admits_next(self) -> bool:
        """Whether the push policy sends the next sample that is written."""
        return admits(self.push, self.connector.profile.skip, self.written + 1 - self.offered)

    def offer(self, sample: Any) -> bool:
        """Take a sample that need not wait for room; False: the sample was rejected."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.offer(sample)
            if self.closed:
                return True
            self.written += 1
            if not self.receiver.open:
                self.drop("inactive")
                self.miss(sample)
                return True
            if not admits(self.push, self.connector.profile.skip, self.written - self.offered):
                self.drop_these("skipped", (sample,))
                self.miss(sample)
                return True
            return self.store(sample)

    @at_current
    def time_out(self, entry: Waiting) -> None:
        """Count the sample of a write that timed out as written and dropped."""
        self.written += 1
        self.drop("timeout")

    def take(self) -> Any:
        """Take the oldest sample out of the queue, which is not empty; the caller holds the lock."""
        sample = self.last = self.queue.popleft()
        if self.waiting:
            self.admit_waiting()
        # A part of `stamp_out`, repeated here: every sample that is not read directly passes this line.
        return sample if self.connector.profile.stamp is not _READ else self.stamp_out(sample)

    def take_newest(self) -> Any:
        """Take the newest sample of the queue, which is not empty, and drop older ones; the caller holds the lock."""
        sample = self.last = self.queue.pop()
        if self.queue:
            self.drop_these("superseded", self.queue)
            self.queue.clear()
        self.admit_waiting()
        return self.stamp_out(sample)

    def discard(self, reason: str) -> None:
        """Drop the queued samples, not those of waiting writers; the caller holds the lock."""
        newest = NOTHING
        if self.queue:
            newest = self.queue[-1]
            self.drop_these(reason, self.queue)
            self.queue.clear()
        self.admit_waiting()
        if newest is not NOTHING and not self.queue:
            self.lose(newest)

    def close(self) -> None:
        """Drop all samples and let writers that wait for room go on; idempotent."""
        with self.guard():
            if self.closed:
                return
            self.closed = True
            self.end_all("disconnected")

    def suspend(self) -> None:
        """Drop queued and waiting samples, since the reader takes no more; the caller holds the lock."""
        if self.offered:
            self.take_back()
        self.end_all("inactive")

    def end_all(self, reason: str) -> None:
        """Drop queued and waiting samples for `reason`, and let the writers go on; the caller holds the lock."""
        newest = self.held()
        self.discard_all(reason)
        waiting, self.waiting = self.waiting, None
        for entry in waiting or ():
            self.written += 1
            self.drop(reason)
            self.resolve(entry)
        if newest is not NOTHING:
            self.miss(newest)
        self.receiver.room_made()

    # -- listeners -------------------------------------------------------------------------------------------------

    def mute(self) -> None:
        """Silence all listeners from now on."""

    def unmute(self) -> None:
        """Resume the listeners that were silenced."""
        if self.listeners is not None:
            self.listeners.resume(self.connector)

    # -- waiting for room ----------------------------------------------------------------------------------------------

    def wait_for_room(
        self, sample: Any, future: asyncio.Future[None] | None, *, patient: bool = False
    ) -> Waiting | None:
        """Queue up for room; None: a thread has made room meanwhile, and the sample was taken.

        With `patient` the write waits even where a full buffer would lose its oldest sample.
        """
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.wait_for_room(sample, future, patient=patient)
            if self.must_wait() or (patient and self._lacks_room()):
                return self.queue_up(sample, future)
            self.offer(sample)
            return None

    def send_now(self, sample: Any) -> Waiting | None:
        """Send a sample whose write waits for an answer, and keep its timeout; None: the write waits as others do."""
        return None

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        """Queue up for room at a buffer that is known to be full; across threads the caller holds the lock."""
        entry = Waiting(self.connector, sample, future)
        if self.waiting is None:
            self.waiting = OrderedDict()
        self.waiting[entry] = None
        self.connector.in_._fast = OFF
        return entry

    def moved(self, entry: Waiting) -> bool:
        """Whether the sample of a waiting thread was moved in; called in that thread."""
        return entry.done

    @at_current
    def give_up(self, entry: Waiting) -> bool:
        """End the waiting of `entry`; False: the sample was moved in meanwhile."""
        left = not entry.done and self.leave_line(entry)
        if left and not self.waiting:
            self.connector.in_._fast = self.receiver.direct
        return left

    def leave_line(self, entry: Waiting) -> bool:
        """Remove an entry from `waiting`; False: it is not there."""
        if self.waiting is None or entry not in self.waiting:
            return False
        del self.waiting[entry]
        return True

    def admit_waiting(self) -> None:
        """Move in the samples that wait, as far as there is room. A sample counts as written when it is moved in, not
        when it queues up: a sample whose writer gave up was never written."""
        waiting = self.waiting
        if not waiting:
            return
        receiver, queue = self.receiver, self.queue
        plain = (
            self.admits_plainly
            and self.times is None
            and self.connector.profile.stamp is None
            and self.push is not _SKIP
            and receiver.lock is None
        )
        if plain:
            while waiting and len(queue) < self.length:
                # `_admit_each` without its calls: with a full buffer this runs once for each sample.
                entry, _ = waiting.popitem(False)
                self.written += 1
                queue.append(entry.sample)
                receiver.arrived(self, 0)
                entry.done = True
                if entry.future is not None and not entry.future.done():
                    entry.future.set_result(None)
        else:
            self._admit_each(waiting)
        if not waiting:
            self.connector.in_._fast = receiver.direct
        receiver.room_made()

    def admit_all(self) -> None:
        """Move in all samples that wait, with or without room; the caller holds the lock."""
        if self.waiting:
            length, self.length = self.length, len(self.queue) + len(self.waiting)
            self.admit_waiting()
            self.length = length

    def _admit_each(self, waiting: OrderedDict[Waiting, None]) -> None:
        """Move in the samples that wait, as far as there is room, and drop those that the push policy leaves out."""
        while waiting:
            sent = self.admits_next()
            if sent and len(self.queue) >= self.length:
                break
            entry, _ = waiting.popitem(False)
            self.written += 1
            if sent:
                self.push_in(self.stamp_in(entry.sample))
            else:
                self.drop_these("skipped", (entry.sample,))
                self.lose(entry.sample)
            self.resolve(entry)

    def resolve(self, entry: Waiting) -> None:
        """Let the writer of `entry` go on; the caller holds the lock and calls `room_made` afterwards."""
        entry.done = True
        if entry.future is None:
            return  # a thread: the caller's `room_made` wakes it
        if self.receiver.lock is None:
            _set_done(entry.future)
        else:
            entry.future.get_loop().call_soon_threadsafe(_set_done, entry.future)

    # -- the writer's last sample --------------------------------------------------------------------------------------

    @property
    def position(self) -> int:
        """The number of samples written, including those that wait for room."""
        return self.total() + (len(self.waiting) if self.waiting else 0)

    @at_current
    def held(self) -> Any:
        """The last sample that the writer wrote, if this transport has it; else NOTHING."""
        if self.missed == self.position:
            return NOTHING
        return next(reversed(self.waiting)).sample if self.waiting else self.newest_here()

    def newest_here(self) -> Any:
        """The newest sample that was moved in, read or unread; NOTHING if there was none."""
        if self.queue:
            return self.queue[-1]
        receiver = self.receiver
        if receiver.plain and receiver.last_source is self.connector:
            return receiver.last_read
        return self.last

    def lose(self, sample: Any) -> None:
        """Note that `sample`, the newest here or the one just written, is lost here."""
        if not self.waiting and self.missed != self.position:
            self.miss(sample)

    def miss(self, sample: Any, coming: int = 0) -> None:
        """Give the writer's last sample, lost here, to the out-port; `position` still lacks `coming` samples."""
        self.connector.out._saved = sample
        self.missed = self.position + coming

    def put_last(self, sample: Any) -> None:
        """Take the writer's last sample, offered by `keep_last`; the caller holds the lock."""
        self.written += 1
        self.offered += 1
        self.push_in(self.stamp_in(sample))

    def spare_newest(self) -> None:
        """Send the newest waiting sample even against the push policy; the caller holds the lock."""

    def take_back(self) -> None:
        """Undo `put_last`, unless a sample was read or lost since; the caller holds the lock."""
        if self.queue and self.total() == self.buffered:
            newest = self.held()
            self.queue.popleft()
            self.written -= 1
            self.offered -= 1
            if newest is not NOTHING and not self.position:
                self.miss(newest)

    # -- storing ---------------------------------------------------------------------------------------------------

    def guard(self) -> AbstractContextManager[Any]:
        """The lock, where there is one."""
        return self.receiver.lock or UNLOCKED

    def discard_all(self, reason: str) -> None:
        """Drop all buffered samples for `reason`."""
        if self.queue:
            self.drop(reason, len(self.queue))
            self.queue.clear()

    def store(self, sample: Any) -> bool:
        """Store a sample that the push policy sends; False: the full policy rejected it."""
        if self.push is _NEW and (displaced := len(self.queue)):  # several where other options were in force before
            self.drop_these("superseded", self.queue)
            self.queue.clear()
            self.push_in(self.stamp_in(sample), displaced=displaced)
            return True
        return self.store_bounded(sample)

    def store_bounded(self, sample: Any) -> bool:
        """Store a sample as the full policy says; False: the sample was rejected."""
        verdict = decide(len(self.queue), self.length, self.connector.profile.full)
        if verdict is _REFUSE:
            self.drop("rejected")
            self.lose(sample)
            return False
        if verdict is _WAIT and self.retired:
            self.drop("inactive")
            self.miss(sample)
            return True
        # `_WAIT` here: the loop has changed the options since `must_wait` was False. The sample is stored all the same.
        replaces = verdict is _REPLACE_OLDEST
        if replaces:
            self.queue.popleft()
            self.drop("overwritten")
            if self.losses:
                self.losses.begin(self.connector)
        self.push_in(self.stamp_in(sample), displaced=replaces)
        return True

    def drop_these(self, reason: str, samples: Collection[Any]) -> None:
        """Count these samples as dropped."""
        self.drop(reason, len(samples))

    def stamp_in(self, sample: Any) -> Any:
        """The sample as it goes into the queue."""
        if self.connector.profile.stamp not in _ON_THE_WAY:
            return sample
        self.lose(sample)
        return stamped(sample, self.clock.time_ns())

    def stamp_out(self, sample: Any) -> Any:
        """The sample as the reader gets it."""
        return sample if self.connector.profile.stamp is not _READ else stamped(sample, self.clock.time_ns())

    def push_in(self, sample: Any, *, displaced: int = 0) -> None:
        """Append the sample to the queue; `displaced` of the connector's oldest samples were removed for it."""
        if self.times is None:
            self.queue.append(sample)
            self.receiver.arrived(self, displaced)
            return
        began_ns = self.clock.monotonic_ns()
        self.queue.append(sample)
        self.receiver.arrived(self, displaced)
        self.times.add(began_ns, self.clock.monotonic_ns())

    def on_loop(self, callback: Callable[[Any], object]) -> None:
        """Call `callback` on the loop, now if this is its thread, with the transport that the connector has by then."""
        connector = self.connector
        connector.out._on_loop(lambda: callback(connector._transport))


def _set_done(future: asyncio.Future[None]) -> None:
    """Wake the writer, unless it has given up."""
    if not future.done():
        future.set_result(None)
