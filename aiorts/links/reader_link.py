"""The reader's end of a link in its kernel: writes what is received at a far out-port, in order.

Also the options of the connector at this end, and the check of the shape of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from anyio import WouldBlock

from aiorts.errors import StateError, WiringError, format_error
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.far import FarOutPort
from aiorts.kernel.ports.out_port import write_all, write_alone
from aiorts.kernel.quality.dated import Dated
from aiorts.kernel.quality.succession import pass_on
from aiorts.links.sides import LinkSide, Wakening, report
from aiorts.model.buffer import FullPolicy
from aiorts.model.declared import options_of
from aiorts.model.links import FATES, SOLE, ReaderEnd
from aiorts.model.options import AGAIN
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription
from aiorts.model.profile import ConnectorProfile

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.transport import Waiting
    from aiorts.links.sides import Owner
    from aiorts.links.transport import Channel
    from aiorts.model.links import Buffer
    from aiorts.model.profile import ConnectorStatistics

_MEASURED: Final = 1_000
"""The most reads that are timed for another kernel: sorting more of them for each answer takes too long."""
_KEPT_BY_READER: Final = tuple(
    key for key, one in options_of(ConnectorProfile).items() if one.end == "reader" and key not in ("length", "full")
)
"""Options that the reader's end of a link takes unchanged; the subscription decides about its buffer."""
_PATIENCE_NS: Final = 25_000_000
"""A sample waits for room this long, at most twice as long, before it displaces another. Samples written one after the
other come together, and a reader that keeps up has room for them a few turns of the loop later."""


class ReaderLink(LinkSide[ReaderEnd]):
    """Writes the samples that another kernel sends to one connector of this kernel.

    Args:
        decode: makes a sample of bytes and the parts that travelled with them.
        decode_all: makes several samples, one after the other, of bytes without parts. None: there is no such decoder.
    """

    def __init__(
        self,
        kernel: Microkernel,
        connector: Connector,
        epoch: int,
        owner: Owner,
        decode: Callable[[Buffer, Sequence[Buffer]], Any],
        decode_all: Callable[[Sequence[Buffer]], Iterator[Any]] | None = None,
    ) -> None:
        super().__init__(kernel, connector, ReaderEnd(0, epoch), owner)
        self._decode, self._decode_all = decode, decode_all
        self._waits = 0
        """The number of the sample that waits for room in the reader's buffer; 0: none does."""
        self.undecodable = 0
        """Samples that could not be decoded."""
        self.reported: ConnectorStatistics = connector.statistics
        """The counts of this end's connector when the writer's kernel last asked."""
        self._is_measured_for_writer = connector.profile.measure > 0
        """Whether the connector is measured as long as the writer's end is."""
        self.taken_over = 0
        """Unread samples that this end took over from the reader's end before it."""
        self.settled: Callable[[], None] | None = None
        """Called when a sample that waited for room is in the reader's buffer, or was refused."""
        self._waiting: Waiting | None = None
        self._lost_before: Mapping[str, int] = {}
        """The samples that its connector had dropped, by reason, when the present writer's end came."""
        self._ages = connector.profile.lifespan is not None
        self._displaces = _displaces(connector.profile)
        self._patience = Wakening(kernel, self._displace)
        """The timer at which samples that wait for room displace others."""
        self._patient_to = 0
        """The number of the last sample that displaces another when `_patience` is due; 0: none does."""
        # Its reader is in a third kernel: each sample waits for the answer from there, and so does its writer.
        self._confirms = connector.in_.is_far and connector.profile.subscription is Subscription.FLUSH
        self._takes_alone = not (self._confirms or self._ages)
        if isinstance(connector.out, FarOutPort):
            connector.out.held = lambda: self.end.held
            connector.out.clock = None

    @property
    def busy(self) -> bool:
        """Whether samples that have come wait for room in the reader's buffer."""
        return bool(self._waits or self.end.held)

    def measure(self, count: int) -> None:
        """Time the last `count` samples, as the writer's end does; a connector with its own `measure` keeps it."""
        connector, connections = self.connector, self._kernel.connections
        is_wanted = count > 0
        if is_wanted is self._is_measured_for_writer or (is_wanted and connector.profile.measure):
            return
        with suppress(StateError, WiringError):  # a real-time thread reads, or a service's own tap
            connections.measure(connector, min(count, _MEASURED))
            self._is_measured_for_writer = is_wanted

    def take_over(self, before: ReaderLink) -> None:
        """Take over the unread samples of another end at the same in-port, whose writer's end is gone."""
        before.take_all()
        self.taken_over += pass_on(before.connector, self.connector)

    def take_all(self) -> None:
        """Put all samples that have come into the reader's buffer, whether there is room or not."""
        transport = transport_of(self.connector)
        while (entry := self._waiting) is not None:
            with transport.guard():
                transport.admit_all()
            self._room_made(entry.future)

    @property
    def held(self) -> int:
        """Samples that have come and are not in the reader's buffer."""
        return self.end.held + len(transport_of(self.connector).waiting or ())

    def connect(self, channel: Channel, number: int, peer_epoch: int) -> None:
        """From now on, receive the frames that carry `number` over this channel."""
        self._channel, self.why = channel, ""
        self.end.renumber(number)
        now = self._now()
        if peer_epoch != self.end.peer_epoch:
            self._lost_before = dict(transport_of(self.connector).glance()[2])
            self.end.lost({})
        self.end.channel_up(now, peer_epoch)
        self._poll(now)

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        now, end = self._now(), self.end
        if len(frames) == 1 and self._takes_alone and not self._waits and not self._ended:
            head, parts = frames[0]
            if not parts and (ticket := end.receive_alone(now, head)):
                # `_deliver` and `_poll` of the only sample that has come, written out.
                try:
                    record = self._decode(head[SOLE:], ())
                except Exception as error:  # noqa: BLE001 - as in `_deliver`
                    self._cannot_decode(now, ticket, error)
                    return self._poll(now)
                if not write_alone(self.connector.out, record):
                    return self._deliver_alone(now, ticket, record)
                if (due := end.done_alone(now)) <= now:
                    self._poll(now)
                elif due < self._wakening.due_ns:
                    self._wakening.at(due)
                return None
        for head, parts in frames:
            end.receive(now, head, parts)
        self._deliver(now)
        self._poll(now)
        if end.peer_ended and not self._ended:
            self._owner.left()
        return None

    def _poll(self, now: int) -> None:
        end, channel = self.end, self._channel
        if channel is None:
            return
        if 0 < end.tell_ns <= now:
            end.lost(self._losses())
        due = end.poll(now, channel.send)
        if end.tell_ns and (due is None or end.tell_ns < due):
            due = end.tell_ns
        self._wakening.at(due)

    def _losses(self) -> dict[str, int]:
        """Samples of this writer's end that were lost, by reason. The writer's end itself counts the refused ones."""
        dropped, before = transport_of(self.connector).glance()[2], self._lost_before
        return {reason: dropped[reason] - before.get(reason, 0) for reason in dropped if reason not in FATES}

    def on_room(self) -> None:
        now = self._now()
        self.end.on_room(now)
        self._poll(now)

    def _down(self, why: str) -> None:
        self.on_clock(0, 0)
        super()._down(why)

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        if isinstance(self.connector.out, FarOutPort):
            self.connector.out.clock = (ahead_ns, within_ns) if within_ns else None

    def close(self, *, for_good: bool) -> None:
        """Close the side of a connector that has ended; `for_good`: tell the writer's end. Idempotent."""
        if self._ended:
            return
        self._ended = True
        self._wakening.cancel()
        self._patience.cancel()
        channel, self._channel = self._channel, None
        if channel is not None:
            if for_good:
                self.end.end(self._now(), channel.send)
            channel.close()

    def _deliver_alone(self, now: int, ticket: int, record: Any) -> None:
        """`_deliver` and `_poll` of the only sample that has come, where it cannot go straight into the queue."""
        transport = transport_of(self.connector)
        try:
            if self._displaces and len(transport.queue) >= transport.length:
                raise WouldBlock
            has_room = self.connector.out.write_nowait(record)
        except WouldBlock:
            self._wait(ticket, record)
        else:
            if has_room:
                self.end.done(now, ticket)
            else:
                self.end.failed(now, ticket, "rejected")
        self._poll(now)

    def _cannot_decode(self, now: int, ticket: int, error: Exception) -> None:
        self.end.failed(now, ticket, "undecodable")
        self.undecodable += 1
        if self.undecodable == 1:
            report(f"{self.connector.name}: dropped what cannot be decoded: {format_error(error)}")

    def _deliver(self, now: int) -> None:
        """Write the samples that came while the reader has room; samples without room are not acknowledged."""
        end, decode = self.end, self._decode
        write = _always_waits if self._confirms else self.connector.out.write_nowait
        ages = self._ages
        transport = transport_of(self.connector) if self._displaces else None
        taken = last = 0
        if self._decode_all is not None and self._takes_alone and end.held > 1 and not (self._waits or self._ended):
            self._deliver_all(now, self._decode_all)
        while not self._waits and not self._ended and (received := end.take()) is not None:
            ticket, head, parts = received
            try:
                record = decode(head, parts)
            except Exception as error:  # noqa: BLE001 - the class's own check of its values may raise anything
                end.done(now, last, taken)
                self._cannot_decode(now, ticket, error)
                taken = 0
                continue
            if ages:
                self._date(end.date)
            try:
                if transport is not None and len(transport.queue) >= transport.length:
                    raise WouldBlock
                has_room = write(record)
            except WouldBlock:
                end.done(now, last, taken)
                taken = 0
                self._wait(ticket, record)
                continue
            if has_room:
                taken, last = taken + 1, ticket
            else:
                end.done(now, last, taken)
                end.failed(now, ticket, "rejected")
                taken = 0
        end.done(now, last, taken)
        if ages and not self._waits:
            self._date(None)

    def _deliver_all(self, now: int, decode_all: Callable[[Sequence[Buffer]], Iterator[Any]]) -> None:
        """Write the first samples that have come, as many as can be written together; `_deliver` writes the rest."""
        transport, end = transport_of(self.connector), self.end
        records: list[Any] = []
        with suppress(Exception):  # as in `_deliver`, which decodes that sample again and reports it
            for record in decode_all(end.heads(transport.length - len(transport.queue))):
                records.append(record)  # noqa: PERF402 - keeps the samples before one that fails
        if records and (count := write_all(self.connector.out, records)):
            end.done(now, end.take_all(count), count)

    def _date(self, written_ns: int | None) -> None:
        """Date the next sample with this time of the kernel's clock; None: date the next samples when written."""
        transport = transport_of(self.connector)
        if isinstance(transport, Dated):
            transport.moments.given_ns = written_ns

    def _wait(self, number: int, record: Any) -> None:
        """Let a sample wait for room; `_room_made` is called when it is in the buffer."""
        future = self._kernel.loop.create_future()
        transport = transport_of(self.connector)
        self._waiting = transport.wait_for_room(record, future, patient=self._displaces)
        if self._waiting is None:
            self.end.done(self._now(), number, 1)
            return
        self._waits = number
        future.add_done_callback(self._room_made)
        if self._displaces and not self._patient_to:
            self._be_patient()

    def _be_patient(self) -> None:
        """Let the samples that have come until now wait for room, for a while."""
        self._patient_to = self.end.newest or self._waits
        self._patience.at(self._now() + _PATIENCE_NS)

    def _displace(self) -> None:
        """Put the samples that have waited long enough into the place of the oldest ones."""
        while (entry := self._waiting) is not None and self._waits <= self._patient_to:
            transport = transport_of(self.connector)
            if transport.give_up(entry):
                transport.offer(entry.sample)
            self._room_made(entry.future)
        if self._waits:
            self._be_patient()
        else:
            self._patient_to = 0

    def _room_made(self, future: object) -> None:
        number, entry = self._waits, self._waiting
        if entry is None or entry.future is not future:
            return  # this room was handled before
        self._waits, self._waiting = 0, None
        if self._ages:
            self._date(None)
        if self._ended:
            return
        now = self._now()
        if entry.refused:
            self.end.failed(now, number, "rejected")
        else:
            self.end.done(now, number, 1)
        self._deliver(now)
        self._poll(now)
        if self.settled is not None:
            self.settled()


def _always_waits(_sample: Any) -> bool:
    """Refuse each write for now: the sample is taken when its reader has answered."""
    raise WouldBlock


def reader_options(profile: ConnectorProfile) -> dict[str, Any]:
    """The options of the connector at the reader's end, from those of the link.

    A sample that finds the reader's buffer full waits at the reader's end. Where the connector overwrites, it waits for
    a moment and then takes the place of the oldest one. Else the window is used up, and the writer's buffer decides.
    With flush the writer waits for the answer, so the policy of the full buffer is the reader's own.
    """
    options: dict[str, Any] = {key: getattr(profile, key) for key in _KEPT_BY_READER}
    options |= {**AGAIN, "timeout": None, "measure": min(profile.measure, _MEASURED)}
    if profile.stamp in (Stamp.RECEIVED, Stamp.READ):
        options["stamp"] = profile.stamp
    if profile.dataflow is Dataflow.PULL:
        return {**options, "dataflow": profile.dataflow}
    if profile.subscription is Subscription.FLUSH:
        return {**options, "length": profile.length, "full": profile.full}
    if profile.push is Push.NEW:
        return {**options, "subscription": Subscription.NEW, "push": Push.NEW}
    full = FullPolicy.OVERWRITE if profile.full is FullPolicy.OVERWRITE else FullPolicy.BLOCK
    return {**options, "subscription": Subscription.NEW, "push": Push.ALL, "length": profile.length, "full": full}


def _displaces(profile: ConnectorProfile) -> bool:
    """Whether a sample that finds the buffer full replaces the oldest one; not with flush, where its writer waits."""
    is_chosen = profile.dataflow is Dataflow.PULL or profile.push is Push.NEW
    return profile.full is FullPolicy.OVERWRITE and profile.subscription is not Subscription.FLUSH and not is_chosen


def of_shape(
    decode: Callable[[Buffer, Sequence[Buffer]], Any], check: Callable[[Any, Any], object], shape: tuple[int, ...]
) -> Callable[[Buffer, Sequence[Buffer]], Any]:
    """A `decode` whose samples must have this shape."""

    def checked(head: Buffer, parts: Sequence[Buffer]) -> Any:
        sample = decode(head, parts)
        check(sample, shape)
        return sample

    return checked
