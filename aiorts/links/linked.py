"""Transports at the writer's end of a link: the samples that the link has taken stay in their ledger.

A link drains the queue of such a connector while its window has room. With subscription flush a write waits until the
reader's end has acknowledged its sample; these samples bypass the queue, but leave after the samples in it.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from threading import get_ident
from types import MappingProxyType
from typing import Any, Final, Protocol

from aiorts.kernel.ports.current import at_current
from aiorts.kernel.ports.features import Feature, FeaturedTransport, features_of, offer
from aiorts.kernel.ports.transport import Waiting
from aiorts.kernel.quality.dated import Dated, times_of
from aiorts.late import dataclass
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Dataflow, Stamp, Subscription
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics

LINK: Final = "on_link_lost"
"""The option that makes a connector one of a link, and the key of the link in `extra`."""
PULL: Final = "dataflow = pull"
"""The option by which the reader's end of a link asks for samples, and the key of that end in `extra`."""
_TAKEN: Final = "taken"


class Drain(Protocol):
    """The link, as far as its transport needs it."""

    def drained(self) -> tuple[int, int, Mapping[str, int]]:
        """The counts of samples taken from the queue: acknowledged, in flight, dropped by reason."""
        ...

    @property
    def round_trip_ns(self) -> int | None:
        """The time from sending to acknowledgement, smoothed; None: not measured yet."""
        ...

    def pump(self) -> None:
        """Take the samples that the window has room for, and send them."""
        ...

    def make_room(self) -> None:
        """Take the samples that the window has room for; they are sent soon."""
        ...

    def confirm(self, transport: Confirmed, sample: Any) -> Confirmation | None:
        """Send a sample ahead of which none waits, and watch its write's deadline; None: it was not sent."""
        ...


@dataclass(eq=False, slots=True)
class Confirmation(Waiting):
    """A sample whose writer waits until the reader's end has acknowledged it."""

    refused: bool = False  # type: ignore[misc] # the kind that a reader far away may refuse later
    late: bool = False  # type: ignore[misc] # as above
    number: int = 0
    """The number under which the sample was sent; 0: it was not sent."""
    until_ns: int = 0
    """The deadline of the sample's write, if the link watches it; 0: the link watches none."""


class Linked(FeaturedTransport):
    """A transport whose reader is a link. See `Transport`."""

    __slots__ = ()

    @property
    def direct(self) -> bool:
        """Whether a write goes straight into the queue: the link hears of each, and makes room in a full queue."""
        return len(features_of(self.connector.profile)) == 1 and super(FeaturedTransport, self).direct

    def must_wait(self) -> bool:
        if not super().must_wait():
            return False
        receiver, link = self.receiver, self._link
        if link is not None and receiver.lock is None and get_ident() == receiver.thread:
            link.make_room()
        return super().must_wait()

    def statistics(self) -> ConnectorStatistics:
        found = super().statistics()
        link = self._link
        acknowledged, in_flight, dropped = link.drained() if link is not None else (0, 0, {})
        return replace(
            found,
            delivered=None,
            acknowledged=acknowledged,
            in_flight=in_flight,
            dropped=MappingProxyType(added(found.dropped, dropped)),
            round_trip_ns=None if link is None else link.round_trip_ns,
        )

    def glance(self) -> tuple[int, int, Mapping[str, int]]:
        written, buffered, dropped = super().glance()
        link = self._link
        return written, buffered, dropped if link is None else added(dropped, link.drained()[2])

    def _pump(self) -> None:
        if self._link is not None:
            self._link.pump()

    @property
    def _link(self) -> Drain | None:
        link: Drain | None = self.extra.get(LINK)
        return link


class Confirmed(Linked):
    """A transport whose writes wait until the reader's end has acknowledged the sample. See `Transport`."""

    __slots__ = ()
    answers = True

    @property
    def direct(self) -> bool:
        return False

    def must_wait(self) -> bool:
        return not self.closed and self.receiver.open and not self.retired

    @property
    def is_awaited(self) -> bool:
        """Whether a write that must not wait may go on: always, unless a full queue keeps its samples."""
        return self.connector.profile.full is not FullPolicy.BLOCK or len(self.queue) < self.length

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        entry = Confirmation(self.connector, self.stamp_in(sample), future)
        if self.waiting is None:
            self.waiting = OrderedDict()
        self.waiting[entry] = None
        self.receiver.on_loop(self._pump)
        return entry

    def send_now(self, sample: Any) -> Waiting | None:
        link: Drain | None = self.extra.get(LINK)
        if link is None or self.queue or self.waiting or self.receiver.lock is not None or not self.must_wait():
            return None
        return link.confirm(self, self.stamp_in(sample))

    def taken(self, sample: Any) -> None:
        """Count a sample that the link has taken and that never was in the queue."""
        self.written += 1
        if not self.waiting:
            self.miss(sample)  # the out-port has it for `keep_last`

    def next_waiting(self) -> Confirmation | None:
        """Take the oldest sample that waits to be sent; None: none waits, or the queue has samples before it."""
        if self.queue or not self.waiting:
            return None
        entry, _ = self.waiting.popitem(last=False)
        assert isinstance(entry, Confirmation)  # noqa: S101 - `queue_up` makes no others
        self.taken(entry.sample)
        return entry

    def settle_fate(self, entry: Confirmation, *, refused: bool) -> None:
        """Let the writer of a sample go on: the reader's end has said what became of the sample."""
        if self.receiver.lock is None:  # `resolve` of an entry that waits in no queue, written out: once for each flush
            entry.refused, entry.done = refused, True
            if entry.future is not None and not entry.future.done():
                entry.future.set_result(None)
            return
        with self.guard():
            entry.refused = refused
            self.resolve(entry)
            self.receiver.room_made()

    @at_current
    def give_up(self, entry: Waiting) -> bool:
        if entry.done:
            return False
        self.leave_line(entry)
        return True  # sent: it stays in flight, and no write waits for it any more

    def time_out(self, entry: Waiting) -> None:
        if isinstance(entry, Confirmation) and entry.number:
            return  # sent: it is written already, and in flight
        super().time_out(entry)

    def admit_waiting(self) -> None:
        """Let waiting writes go to the link, not into the queue."""
        self.receiver.room_made()


class Pulled(Linked):
    """A transport from which the link takes a sample when the reader's end asks for one. See `Transport`."""

    __slots__ = ()

    def push_in(self, sample: Any, *, displaced: int = 0) -> None:
        super().push_in(sample, displaced=displaced)
        self.receiver.on_loop(self._pump)


class Looks(Protocol):
    """The link at the reader's end, as far as its transport needs it."""

    quiet: bool
    """Whether `look` is not to be called now: the link itself uses the transport."""

    def look(self) -> None:
        """Ask the writer's end for its newest sample, unless such a question is under way."""
        ...


class Pulling(FeaturedTransport):
    """A transport at the reader's end with one sample; each use of it asks for a newer sample. See `Transport`."""

    __slots__ = ()

    def settle(self) -> None:
        super().settle()
        link: Looks | None = self.extra.get(PULL)
        if link is not None and not link.quiet:
            self.receiver.on_loop(link.look)

    def statistics(self) -> ConnectorStatistics:
        link: Looks | None = self.extra.get(PULL)
        if link is None or link.quiet:
            return super().statistics()
        link.quiet = True
        try:
            return super().statistics()
        finally:
            link.quiet = False


class StampedThere(FeaturedTransport):
    """A transport at the reader's end whose samples the writer's end has stamped. See `Transport`."""

    __slots__ = ()

    def stamp_in(self, sample: Any) -> Any:
        return sample


class Aged(Dated):
    """A transport that knows when the last sample that was taken was written. See `Transport`."""

    __slots__ = ()

    def take(self) -> Any:
        self.extra[_TAKEN] = times_of(self.moments.queue, self.queue)[0]
        return super().take()

    @property
    def taken_ns(self) -> int:
        """The time when the last sample that was taken was written."""
        found: int = self.extra[_TAKEN]
        return found


def added(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    """The sums of two counts, by reason."""
    return {reason: one.get(reason, 0) + other.get(reason, 0) for reason in dict.fromkeys((*one, *other))}


def _drained(profile: ConnectorProfile) -> bool:
    """Whether a link drains the connector: its reader is in another kernel."""
    return profile.far_end == "reader"


def _is_pulled(profile: ConnectorProfile) -> bool:
    return profile.dataflow is Dataflow.PULL


def _asks(profile: ConnectorProfile) -> bool:
    """Whether the connector is the reader's end of a link that pulls."""
    return profile.dataflow is Dataflow.PULL and profile.far_end == "writer"


def _confirms(profile: ConnectorProfile) -> bool:
    return profile.subscription is Subscription.FLUSH and profile.dataflow is Dataflow.PUSH


def _is_stamped_there(profile: ConnectorProfile) -> bool:
    return profile.far_end == "writer" and profile.stamp is Stamp.SEND


def _stamped_there() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return StampedThere, StampedThere  # there are no periodic ones


def _linked() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return Linked, Linked


def _confirmed() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return Confirmed, Confirmed  # there are no periodic ones


def _pulled() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return Pulled, Pulled


def _pulling() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return Pulling, Pulling


def _aged() -> tuple[type[FeaturedTransport], type[FeaturedTransport]]:
    return Aged, Aged


FEATURES: Final = (
    Feature(LINK, lambda profile: _drained(profile) and profile.lifespan is not None, _aged),
    Feature(LINK, lambda profile: _drained(profile) and not _confirms(profile) and not _is_pulled(profile), _linked),
    Feature(LINK, lambda profile: _drained(profile) and _is_pulled(profile), _pulled),
    Feature("stamp = send", _is_stamped_there, _stamped_there),
    Feature(PULL, _asks, _pulling, settles=True, asks=True),
    Feature(LINK, lambda profile: _drained(profile) and _confirms(profile), _confirmed),
)
offer(*FEATURES)
