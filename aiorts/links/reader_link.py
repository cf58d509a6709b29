"""The reader's end of a link in its kernel: writes what is received at a far out-port, in order.

Also the connector that it writes to: its options, and the check of the shape.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from anyio import WouldBlock

from aiorts.errors import format_error
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.far import FarOutPort
from aiorts.kernel.quality.dated import Dated
from aiorts.links.sides import LinkSide, report
from aiorts.model.buffer import FullPolicy
from aiorts.model.links import ReaderEnd
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.transport import Waiting
    from aiorts.links.sides import Owner
    from aiorts.links.transport import Channel
    from aiorts.model.links import Buffer
    from aiorts.model.profile import ConnectorProfile, ConnectorStatistics


class ReaderLink(LinkSide[ReaderEnd]):
    """Writes what another kernel sends to one connector of this one.

    Args:
        decode: makes the sample of bytes and what travelled beside them.
    """

    def __init__(
        self,
        kernel: Microkernel,
        connector: Connector,
        epoch: int,
        owner: Owner,
        decode: Callable[[Buffer, Sequence[Buffer]], Any],
    ) -> None:
        super().__init__(kernel, connector, ReaderEnd(0, epoch), owner)
        self._decode = decode
        self._waits = 0
        """The number of the sample that waits for room in the reader's buffer; 0: none does."""
        self.undecodable = 0
        """Samples that could not be decoded."""
        self.reported: ConnectorStatistics = connector.statistics
        """What its connector had counted when the writer's kernel last asked."""
        self.settled: Callable[[], None] | None = None
        """Called when a sample that waited for room is in the reader's buffer, or was refused."""
        self._waiting: Waiting | None = None
        self._ages = connector.profile.lifespan is not None
        # Its reader is in a third kernel: each sample waits for the answer from there, and so does its writer.
        self._confirms = connector.in_.is_far and connector.profile.subscription is Subscription.FLUSH
        if isinstance(connector.out, FarOutPort):
            connector.out.held = lambda: self.end.held
            connector.out.clock = None

    @property
    def busy(self) -> bool:
        """Whether samples that have come wait for room in the reader's buffer."""
        return bool(self._waits or self.end.held)

    @property
    def held(self) -> int:
        """Samples that have come and are not in the reader's buffer."""
        return self.end.held + len(transport_of(self.connector).waiting or ())

    def connect(self, channel: Channel, number: int, peer_epoch: int) -> None:
        """Receive over this channel from now on the frames that carry `number`."""
        self._channel, self.why = channel, ""
        self.end.renumber(number)
        now = self._now()
        self.end.channel_up(now, peer_epoch)
        self._poll(now)

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        now, end = self._now(), self.end
        for head, parts in frames:
            end.receive(now, head, parts)
        self._deliver(now)
        self._poll(now)
        if end.peer_ended and not self._ended:
            self._owner.left()

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
        """The connector has ended; `for_good`: say so to the writer's end. Idempotent."""
        if self._ended:
            return
        self._ended = True
        self._wakening.cancel()
        channel, self._channel = self._channel, None
        if channel is not None:
            if for_good:
                self.end.end(self._now(), channel.send)
            channel.close()

    def _deliver(self, now: int) -> None:
        """Write what came, as long as the reader has room; what has none is not acknowledged."""
        end, decode = self.end, self._decode
        write = _always_waits if self._confirms else self.connector.out.write_nowait
        ages = self._ages
        taken = last = 0
        while not self._waits and not self._ended and (received := end.take()) is not None:
            ticket, head, parts = received
            try:
                record = decode(head, parts)
            except Exception as error:  # noqa: BLE001 - the class's own check of its values may raise anything
                end.done(now, last, taken)
                end.failed(now, ticket, "undecodable")
                taken = 0
                self.undecodable += 1
                if self.undecodable == 1:
                    report(f"{self.connector.name}: dropped what cannot be decoded: {format_error(error)}")
                continue
            if ages:
                self._date(end.date)
            try:
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

    def _date(self, written_ns: int | None) -> None:
        """The next sample was written at this time of the kernel's clock; None: those that come are written now."""
        transport = transport_of(self.connector)
        if isinstance(transport, Dated):
            transport.moments.given_ns = written_ns

    def _wait(self, number: int, record: Any) -> None:
        """Have the connector say when the reader has made room for this sample, which is in the buffer then."""
        future = self._kernel.loop.create_future()
        self._waiting = transport_of(self.connector).wait_for_room(record, future)
        if self._waiting is None:
            self.end.done(self._now(), number, 1)
            return
        self._waits = number
        future.add_done_callback(self._room_made)

    def _room_made(self, _future: object) -> None:
        number, entry = self._waits, self._waiting
        self._waits, self._waiting = 0, None
        if self._ages:
            self._date(None)
        if self._ended:
            return
        now = self._now()
        if entry is not None and entry.refused:
            self.end.failed(now, number, "rejected")
        else:
            self.end.done(now, number, 1)
        self._deliver(now)
        self._poll(now)
        if self.settled is not None:
            self.settled()


def _always_waits(_sample: Any) -> bool:
    """Write a sample that is taken when its reader has said so."""
    raise WouldBlock


def reader_options(profile: ConnectorProfile) -> dict[str, Any]:
    """The options of the connector at the reader's end, by those that the link was made with.

    A link loses nothing inside its window: what finds the reader's buffer full waits at the reader's end, and when the
    window is used up the writer's buffer decides. With flush the writer waits for the answer, so the policy of the full
    buffer is the reader's own.
    """
    options: dict[str, Any] = {"timeout": None, "allow_duplicate": True}
    options |= {"keep_last": profile.keep_last, "lifespan": profile.lifespan, "max_gap": profile.max_gap}
    if profile.stamp in (Stamp.RECEIVED, Stamp.READ):
        options["stamp"] = profile.stamp
    if profile.dataflow is Dataflow.PULL:
        return {**options, "dataflow": profile.dataflow}
    if profile.subscription is Subscription.FLUSH:
        return {**options, "length": profile.length, "full": profile.full}
    if profile.push is Push.NEW:
        return {**options, "subscription": Subscription.NEW, "push": Push.NEW}
    return {**options, "length": profile.length, "full": FullPolicy.BLOCK}


def of_shape(
    decode: Callable[[Buffer, Sequence[Buffer]], Any], check: Callable[[Any, Any], object], shape: tuple[int, ...]
) -> Callable[[Buffer, Sequence[Buffer]], Any]:
    """The same `decode`, whose samples must have this shape."""

    def checked(head: Buffer, parts: Sequence[Buffer]) -> Any:
        sample = decode(head, parts)
        check(sample, shape)
        return sample

    return checked
