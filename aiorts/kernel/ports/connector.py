"""A connector: one out-port, one in-port, the options both agreed on, and the transport that carries its samples.

`Connector` is what users hold. `Transport` is what stands behind it: one bounded queue at the reader, and the ledger.
The transport is replaced, with what is in it, when a real-time thread or a listener comes or goes; the connector stays.
`OutPort` and `InPort` inline the common case (`out_port.py`, `in_port.py`) and come here for everything else.

Only `written` and drops are counted; what was delivered follows from them, so the ledger balances at any moment it is
read. What an out-port gives to all of its direct connectors alike it counts once, for all of them (`OutPort._sent`),
and what a full buffer displaces on that way in one number (`displaced`): both are put in their place when somebody
asks. `model/policy.py` and `model/buffer.py` decide; this file carries out.

Across threads the receiver has a lock, and every path here that touches its queues takes it: its fast path is off. A
method that has waited for the lock asks whether this is still the connector's transport (of a receiver: the port's).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Never, Protocol

from aiorts.errors import ClosedError
from aiorts.kernel.ports.figures import statistics_of
from aiorts.kernel.ports.last_sample import LastSample
from aiorts.kernel.ports.port import NOTHING, UNLOCKED
from aiorts.kernel.ports.queueing import Queueing
from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription, admits
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics
from aiorts.model.timing import ConnectorTimes

if TYPE_CHECKING:
    from aiorts.kernel.ports.features import TransportKind
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.kernel.ports.out_port import OutPort
    from aiorts.kernel.ports.port import Port
    from aiorts.kernel.ports.queueing import Waiting
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.model.timing import PublisherTiming


# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
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
_NO_DROPS: Final[Mapping[str, int]] = MappingProxyType({})


class Connector:
    """One live connection. Made by `Kernel.connect`, ended by `Kernel.disconnect`.

    Attributes:
        profile: the options in force, frozen.
        out: the out-port.
        in_: the in-port.
    """

    __slots__ = ("_since_ns", "_transport", "in_", "out", "profile")

    _transport: Transport
    _since_ns: int
    """When it was made, on the kernel's monotonic clock."""

    def __init__(self, profile: ConnectorProfile, out: OutPort[Any], in_: InPort[Any]) -> None:
        self.profile = profile
        self.out = out
        self.in_ = in_

    @property
    def name(self) -> str:
        """Unique in its kernel."""
        return self.profile.name

    @property
    def closed(self) -> bool:
        """True once disconnected."""
        return self._transport.closed

    @property
    def statistics(self) -> ConnectorStatistics:
        """The ledger at this moment.

        Raises:
            ThreadError: read in another thread than the loop's, where neither end belongs to a ThreadContext.
        """
        found = self._transport.statistics()
        kernel = None if self.profile.max_gap is None or self.out._host is None else self.out._host.kernel
        return found if kernel is None else kernel.connections.gaps.added(found, self)

    @property
    def timing(self) -> PublisherTiming | None:
        """When and how long this connector sent, over its last `measure` sends; None when `measure` was not given.

        `measure` is an option of `Kernel.connect`; OpenRTM's keys `measurement.*` are aliases.
        """
        transport = self._transport
        with transport.guard():
            return None if transport.times is None else transport.times.timing

    def close(self) -> None:
        """End this connector as `Kernel.disconnect` does, on the kernel's loop. Idempotent."""
        host = self.out._host
        if host is not None and host.kernel is not None and not self.closed:
            host.check_loop_thread(f"{self.name}: its end was")
            host.kernel.connections.end(self)

    def change(
        self,
        *,
        push_rate: float | None = None,
        length: int | None = None,
        full: Literal["overwrite", "reject", "block"] | FullPolicy | None = None,
        **others: Never,
    ) -> None:
        """Change options while connected: all that are given or, where one is refused, none. Nothing is lost by it.

        What is unread stays, though it be more than the new length: a write then meets a full buffer, which by `full`
        overwrites one, rejects, or waits until fewer than `length` are unread. Writers that wait for room go on as far
        as a larger `length` has room; where `full` is "block" no more, all of them do, in order, also beyond the
        length. A `push_rate` begins a period: the n-th after it ends n / push_rate seconds after the change.

        Args:
            push_rate: Hz, of a periodic connector.
            length: samples that the reader's buffer holds.
            full: "overwrite", "reject", "block".

        Raises:
            WiringError: names the option that is wrong or cannot be changed, or says that none was given.
            StateError: a real-time thread is at it.
            ClosedError: it was disconnected.
            ThreadError: called in another thread than the loop's.
        """
        host = self.out._host
        if host is None or host.kernel is None or self.closed:
            raise ClosedError(f"{self.name}: change: this connector was disconnected; connect anew with these options")
        host.check_loop_thread(f"{self.name}: a change was")
        given = {"push_rate": push_rate, "length": length, "full": full, **others}
        host.kernel.connections.change(self, {key: value for key, value in given.items() if value is not None})

    def __repr__(self) -> str:
        p = self.profile
        mark = " closed" if self.closed else ""
        options = f"{p.subscription}/{p.push} length={p.length} full={p.full}"
        return f"<Connector {self.out.path} -> {self.in_.path} {options}{mark}>"


def transport_of(connector: Connector) -> Transport:
    """What carries the samples of a connector now; ask each time, it may be replaced."""
    return connector._transport


def unread_of(connector: Connector) -> int:
    """Samples of this connector that the reader can read now."""
    transport = connector._transport
    transport.settle()
    return len(transport.queue)


def unread_at(port: Port[Any]) -> int:
    """Samples that can be read now, of all connectors of an in-port or out-port."""
    return sum(unread_of(connector) for connector in port.connectors)


class LossListener(Protocol):
    """Who hears of the first sample that a transport loses."""

    def begin(self, connector: Connector) -> None: ...


class Transport(Queueing, LastSample):
    """Carries the samples of one connector: a bounded queue, in which a sample is as soon as it is written.

    The classes of a `TransportKind` (`features.py`) derive from it. `replace` puts one of another kind in its place.
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

    listenable: ClassVar[bool] = True
    """Whether it may have listeners: no real-time thread uses it."""

    def __init__(self, connector: Connector, receiver: Receiver, kernel: KernelSide) -> None:
        profile = connector.profile
        self.connector = connector
        self.receiver = receiver
        self.closed = False
        self.queue: deque[Any] = deque()
        self.length = profile.length
        # Pull: the writer keeps its latest unread sample, the reader asks for it; nobody is woken by data.
        chosen = Push.ALL if profile.subscription is Subscription.FLUSH else profile.push
        self.push = _NEW if profile.dataflow is _PULL else chosen
        self.arrived_at = 0
        """When the newest sample arrived, counted at a receiver with several connectors."""
        self.dead = 0
        """Tokens that such a receiver still has for samples that were overwritten: `length` at the most, or as many as
        are unread."""
        self.waiting: deque[Waiting] | None = None
        """The writers that wait for room; the buffer is full as long as there is one. None before the first."""
        self.clock = kernel.clock
        connector._since_ns = kernel.clock.monotonic_ns()
        self.times = ConnectorTimes(profile.measure) if profile.measure else None
        self.losses: LossListener | Literal[False] | None = None
        """What is notified of the next sample that is overwritten, where `full` was not chosen; False: it has been."""
        self.last: Any = NOTHING
        """The sample of this connector that was read last, where reading takes the general path."""
        self.missed = 0
        """The `position` at which the newest sample is not to be had here: the out-port keeps it."""
        self.offered = 0
        """How many of the samples written are the writer's last, offered by `keep_last`: no push policy counts them."""
        self.extra: Any = None
        """What another kind of transport, or a feature, keeps besides."""
        self.listeners: Any = None
        """Who listens (`observe/listening.py`), even while a real-time thread is there and they cannot hear."""
        self.written = 0
        """Samples written, without those that the out-port counts for all of its direct connectors."""
        self.shared = False
        """Whether the out-port's count goes for this connector too."""
        self.displaced = 0
        """Samples that a full buffer displaced or refused and `dropped` does not have yet."""
        self.dropped: Mapping[str, int] = _NO_DROPS

    def replace(self, kind: TransportKind, receiver: Receiver) -> None:
        """Put a transport of another kind in the place of this one, with all that waits in it and its counts.

        On the loop; the caller holds the lock, and has the ports update their fast path afterwards.
        """
        # What the out-port counts for several connectors it cannot count for one that is not direct.
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
        """Be in the state of another transport, which carries nothing any more."""
        for name in Transport.__slots__:
            setattr(self, name, getattr(old, name))
        self.receiver = receiver
        self.extra = None

    def change(self, profile: ConnectorProfile) -> None:
        """Have other options in force: on the loop. Who waits for room and need not any more is let in before."""
        with self.guard():
            self.settle()
            self.count_displaced()
            if self.waiting and profile.full is not _BLOCK:
                self.length = len(self.queue) + len(self.waiting)
                self.admit_waiting()
            self.connector.profile = profile
            self.length = profile.length
            self.admit_waiting()
        self.connector.out._refresh()

    # -- the ledger ------------------------------------------------------------------------------------------------

    def statistics(self) -> ConnectorStatistics:
        """See `Connector.statistics`."""
        host = self.connector.in_._host
        if self.receiver.lock is None and host is not None:
            host.check_loop_thread(f"{self.connector.name}: statistics")
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.statistics()
            self.settle()
            delivered = self.delivered()
            return statistics_of(self, self.total(), delivered, self.buffered, self.dropped)

    def delivered(self) -> int:
        """Samples that were read: what was written, less what was dropped and what is still buffered."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.delivered()
            self.count_displaced()
            return self.total() - sum(self.dropped.values()) - self.buffered

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        """Written, buffered, and dropped by reason, from any thread, without a lock and without counting anything.

        For a look into a process that is stuck; torn when the connector is being used at this moment. `statistics` is
        exact.
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
        """From now on the out-port counts for this connector, or no longer: it has counted `sent`."""
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
        """Have what is queued be what may still be read: somebody looks."""

    def drop(self, reason: str, count: int = 1) -> None:
        """Count so many samples as dropped."""
        self.count_displaced()
        self._note_drop(reason, count)

    def _note_drop(self, reason: str, count: int) -> None:
        dropped = self.dropped
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
    def direct(self) -> bool:
        """Whether a write may go straight into the queue: nothing to choose, stamp or lock."""
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
        """How many unread samples fit."""
        return 1 if self.push is _NEW else self.length

    @property
    def keeps(self) -> bool:
        """Whether a full buffer keeps what it has."""
        return self.push is not _NEW and self.connector.profile.full is not FullPolicy.OVERWRITE

    @property
    def when_full(self) -> bool | LossListener:
        """Whether a full buffer keeps what it has; or who is to hear that it does not."""
        return self.keeps or self.losses or False

    @property
    def blocks(self) -> bool:
        """Whether a writer waits while the buffer is full."""
        return self.push is not _NEW and self.connector.profile.full is _BLOCK

    @property
    def retired(self) -> bool:
        """Whether no context runs the reader any more: what has no room is dropped{inactive}, and no writer waits."""
        host = self.connector.in_._host
        return host is not None and host.retired

    def must_wait(self) -> bool:
        """Whether a sample written now would have to wait for room."""
        if (
            self.connector.profile.full is not _BLOCK
            or self.push is _NEW
            or self.closed
            or not self.receiver.open
            or self.retired
        ):
            return False
        if len(self.queue) < self.length and not self.waiting:
            return False
        return self.admits_next()

    @property
    def is_awaited(self) -> bool:
        """Whether a write that must not wait may be made though `must_wait`: a read waits that will take the sample."""
        return False

    def admits_next(self) -> bool:
        """Whether the push policy sends the next sample that is written."""
        return admits(self.push, self.connector.profile.skip, self.written + 1 - self.offered)

    def offer(self, sample: Any) -> bool:
        """Take a sample that need not wait; False when it was rejected."""
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

    def time_out(self, sample: Any) -> None:
        """Count a sample that was written and had no room in time."""
        with self.guard():
            if (now := self.connector._transport) is not self:
                return now.time_out(sample)
            self.written += 1
            self.drop("timeout")

    def take(self) -> Any:
        """The oldest sample of the queue, which has one; the caller holds the lock."""
        sample = self.last = self.queue.popleft()
        if self.waiting:
            self.admit_waiting()
        # `stamp_out` in part, written out: this is the way of every sample that is not read directly.
        return sample if self.connector.profile.stamp is not _READ else self.stamp_out(sample)

    def take_newest(self) -> Any:
        """The newest sample of the queue, which has one, older ones superseded; the caller holds the lock."""
        sample = self.last = self.queue.pop()
        if self.queue:
            self.drop_these("superseded", self.queue)
            self.queue.clear()
        self.admit_waiting()
        return self.stamp_out(sample)

    def discard(self, reason: str) -> None:
        """Drop what is queued; the caller holds the lock."""
        newest = NOTHING
        if self.queue:
            newest = self.queue[-1]
            self.drop_these(reason, self.queue)
            self.queue.clear()
        self.admit_waiting()
        if newest is not NOTHING and not self.queue:
            self.lose(newest)

    def close(self) -> None:
        """Drop everything and let those who wait for room go on; idempotent."""
        with self.guard():
            if self.closed:
                return
            self.closed = True
            self.end_all("disconnected")

    def suspend(self) -> None:
        """The reader takes nothing any more: drop what is queued or waits; the caller holds the lock."""
        if self.offered:
            self.take_back()
        self.end_all("inactive")

    def end_all(self, reason: str) -> None:
        """Drop what is queued or waits; the caller holds the lock."""
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
        """Nobody can listen from now on."""

    def unmute(self) -> None:
        """Those who listened before hear again."""
        if self.listeners is not None:
            self.listeners.resume(self.connector)

    # -- storing ---------------------------------------------------------------------------------------------------

    def guard(self) -> AbstractContextManager[Any]:
        """The lock, where there is one."""
        return self.receiver.lock or UNLOCKED

    def discard_all(self, reason: str) -> None:
        """Count as dropped all that is buffered."""
        if self.queue:
            self.drop(reason, len(self.queue))
            self.queue.clear()

    def store(self, sample: Any) -> bool:
        """Take a sample that the push policy sends, as the policies say; False when it was rejected."""
        if self.push is _NEW and self.queue:
            self.drop_these("superseded", self.queue)
            self.queue.clear()
            self.push_in(self.stamp_in(sample), displaced=True)
            return True
        return self.store_bounded(sample)

    def store_bounded(self, sample: Any) -> bool:
        """Take a sample as the full policy says; False when it was rejected."""
        verdict = decide(len(self.queue), self.length, self.connector.profile.full)
        if verdict is _REFUSE:
            self.drop("rejected")
            self.lose(sample)
            return False
        if verdict is _WAIT and self.retired:
            self.drop("inactive")
            self.miss(sample)
            return True
        # Else the options changed since `must_wait` has said no, in the loop's thread: it is stored, nothing is lost.
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

    def push_in(self, sample: Any, *, displaced: bool = False) -> None:
        """Append; `displaced` when the oldest sample of this connector made room for it."""
        if self.times is None:
            self.queue.append(sample)
            self.receiver.arrived(self, displaced)
            return
        began_ns = self.clock.monotonic_ns()
        self.queue.append(sample)
        self.receiver.arrived(self, displaced)
        self.times.add(began_ns, self.clock.monotonic_ns())

    def on_loop(self, callback: Callable[[Any], object]) -> None:
        """Call back with what is the connector's transport then, on the kernel's loop: now if this is its thread."""
        connector = self.connector
        connector.out._on_loop(lambda: callback(connector._transport))


def stamped(sample: Any, tm: int) -> Any:
    """A copy of the sample with another time stamp."""
    from aiorts.types import with_tm

    return with_tm(sample, tm)
