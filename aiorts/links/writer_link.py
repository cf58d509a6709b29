"""The writer's end of a link in its kernel: drains a far in-port into the protocol, and sends."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from anyio import WouldBlock

from aiorts.clock import to_ns
from aiorts.errors import AiortsError
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.in_port import InPort, read_all, read_alone, receiver_of
from aiorts.kernel.ports.last_sample import last_written
from aiorts.kernel.ports.out_port import time_out
from aiorts.kernel.ports.port import NOTHING
from aiorts.links.layout import layout_of
from aiorts.links.linked import LINK, Aged, Confirmation, Confirmed, Linked, Pulled, added
from aiorts.links.sides import LinkSide, Wakening, report
from aiorts.links.transport import LinkOffer
from aiorts.model.buffer import FullPolicy
from aiorts.model.links import WriterEnd, versions
from aiorts.model.policy import Push, Subscription

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.links.sides import Owner
    from aiorts.links.transport import Channel
    from aiorts.model.links import Buffer
    from aiorts.model.names import Path
    from aiorts.model.profile import ConnectorProfile

_WINDOW: Final = 256
"""The most samples that may be unacknowledged."""
_WINDOW_BYTES: Final = 8 << 20
_NEWEST: Final = 2
"""The window where only the newest sample counts: one on its way and one behind it."""
_LEAST: Final = 4
"""The smallest window for a slow reader, where the writer's buffer decides what becomes of further samples."""
_SOON_NS: Final = 20_000
"""A sample written within this time after another was sent is sent together with the samples that follow.

Compared with a bound of 50 us (asyncio / uvloop; medians of the ratios of 15 interleaved rounds, two processes on two
cores that others used, too): there and back 1.04x / 0.94x, samples 15 us apart 0.91x / 0.89x, 30 us apart 0.96x /
0.89x, eight written at once 0.83x / 1.03x. With no bound, each sample a call of the system, eight at once take 1.32x /
1.43x and a stream 1.40x / 2.07x. The next sample of a burst comes within some 2 us.
"""
_ACKNOWLEDGED: Final = "acknowledged"
_UNKNOWN: Final = "unknown_fate"
_OWN_FATES: Final = (_UNKNOWN, "disconnected")
"""The reasons of drops for samples that the reader's end has not answered for."""


class WriterLink(LinkSide[WriterEnd]):
    """Sends the samples that are written to one connector into another kernel.

    Args:
        encode: makes the bytes of a sample, and the parts that travel with them.
        encode_all: makes the bytes of several samples without parts at once; empty if one of them does not fit.
            None: there is no such encoder.
    """

    def __init__(
        self,
        kernel: Microkernel,
        connector: Connector,
        epoch: int,
        owner: Owner,
        encode: Callable[[Any], tuple[bytes, Sequence[memoryview]]],
        encode_all: Callable[[Sequence[Any]], Sequence[bytes]] | None = None,
    ) -> None:
        profile = connector.profile
        window = _NEWEST if profile.push is Push.NEW else _WINDOW
        end = WriterEnd(0, epoch, window=window, least=_least(profile))
        super().__init__(kernel, connector, end, owner)
        self._encode, self._encode_all = encode, encode_all
        self._turn_due = self._taking = False
        self._sent_ns = 0
        """The time when a write last sent its sample."""
        self._ages = profile.lifespan is not None
        self._drains_full = profile.push is not Push.NEW
        self._goes_alone = not self._ages and not isinstance(self._transport(), Confirmed | Pulled)
        self._acknowledged = 0
        self._dropped: dict[str, int] = {}
        self.refused: Mapping[str, int] = {}
        """Samples that the present reader's end did not take, by reason."""
        self.acknowledged_before = 0
        """Samples that former reader's ends have acknowledged."""
        self._overwritten = 0
        """Samples that the buffer of this reader's end had overwritten when `lost` was last read."""
        self._confirmations: deque[Confirmation] = deque()
        self._confirmed_at = 0
        """The count of written samples when the last sample with a waiting writer was taken."""
        self._limit_ns = None if profile.timeout is None else to_ns(profile.timeout)
        """The longest wait of a write for the acknowledgement of its sample."""
        self._limit = Wakening(kernel, self._expire)
        """The timer of all writes that wait for an acknowledgement."""
        self._unsendable = False
        self._idle: asyncio.Future[None] | None = None
        """The future that the end of the kernel awaits."""
        self._transport().extra[LINK] = self
        receiver_of(connector.in_).add_callback(self._written)

    # -- the connector ---------------------------------------------------------------------------------------------

    def drained(self) -> tuple[int, int, Mapping[str, int]]:
        lost = self.lost
        arrived = self._acknowledged - sum(lost.values())
        return arrived, self.end.ledger.in_flight, added(added(self._dropped, self.refused), lost)

    @property
    def lost(self) -> Mapping[str, int]:
        """The acknowledged samples that the present reader's end has lost, by reason, as far as it has said so."""
        left, found = self._acknowledged - self.acknowledged_before, {}
        for reason, count in self.end.lost.items():
            if taken := min(count, left):
                found[reason] = taken
                left -= taken
        return found

    @property
    def round_trip_ns(self) -> int | None:
        return self.end.round_trip_ns

    def pump(self) -> None:
        """Take the samples from the connector that the window has room for, and send them."""
        now = self._now()
        if self._drain(now):
            self._poll(now)

    def _drain(self, now: int) -> bool:
        """Take the samples that the window has room for; False where none can be taken now."""
        if self._ended or self._taking or self._channel is None:
            return False
        # To take a sample makes room for a waiting writer, whose sample notifies: that is taken in its turn.
        self._taking = True
        try:
            self._take(now)
        finally:
            self._taking = False
        return True

    def _written(self, _port: InPort[Any]) -> bool:
        # A sample leaves in the write itself; those that follow closely travel together, in the next turn of the loop.
        if not self._turn_due:
            now = self._now()
            if now - self._sent_ns > _SOON_NS:
                self._send(now)
                self._sent_ns = self._now()
                return True
            self._turn_due = True
            self._kernel.loop.call_soon(self._turn)
        if self._drains_full:
            transport = transport_of(self.connector)
            if transport.blocks and not isinstance(transport, Confirmed):
                return False  # until the turn: a write that finds the buffer full before calls `make_room`
            if len(transport.queue) >= transport.length:
                self._drain(self._now())  # else the next sample would find it full, with room in the window
        return True

    def make_room(self) -> None:
        """Take the samples that the window has room for; they are sent in a turn of the loop that is due, or now."""
        if self._turn_due:
            self._drain(self._now())
        else:
            self.pump()

    def _send(self, now: int) -> None:
        """`_drain` and `_poll`; written out for the only sample that waits, as most are."""
        channel, end = self._channel, self.end
        if channel is not None and self._goes_alone and not self._taking and end.takes_alone:
            port = self.connector.in_
            sample = read_alone(port)
            if sample is not NOTHING:
                try:
                    head, parts = self._encode(sample)
                except AiortsError as error:
                    return self._not_sent(error)
                if parts:
                    end.offer(now, head, parts, confirm=not self._drains_full)
                    return self._poll(now)
                due = end.send_alone(now, head, not self._drains_full, channel.send)
                if due < self._wakening.due_ns:
                    self._wakening.at(due)
                if not port.is_new:  # else a thread has written meanwhile, without notification
                    return None
        if self._drain(now):
            self._poll(now)
        return None

    def confirm(self, transport: Confirmed, sample: Any) -> Confirmation | None:
        """`_drain` and `_poll` of the only sample that waits, whose writer waits for its answer; None: there is more
        to do."""
        channel, end = self._channel, self.end
        if channel is None or self._ages or self._taking or not end.takes_alone:
            return None
        try:
            head, parts = self._encode(sample)
        except AiortsError:
            return None  # the sample is taken in its turn, and its error reported
        now = self._now()
        transport.taken(sample)
        self._confirmed_at = transport.missed
        entry = Confirmation(self.connector, sample, self._kernel.loop.create_future(), number=end.numbered + 1)
        self._confirmations.append(entry)
        if (limit_ns := self._limit_ns) is not None:
            entry.until_ns = now + limit_ns
            self._limit.at(entry.until_ns)
        if parts:
            end.offer(now, head, parts, confirm=True)
            self._poll(now)
        else:
            self._wakening.at(end.send_alone(now, head, True, channel.send))
        return entry

    def _expire(self) -> None:
        """End the waits of writes whose time is over."""
        now = self._now()
        for entry in [each for each in self._confirmations if each.until_ns]:
            if entry.future is None or entry.future.done():
                continue
            if entry.until_ns > now:
                return self._limit.at(entry.until_ns)  # all wait equally long
            entry.late = time_out(entry)
            entry.future.set_result(None)
        return None

    def _turn(self) -> None:
        self._turn_due = False
        receiver_of(self.connector.in_).enable_notify()  # before it looks: a thread may write meanwhile
        self.pump()

    def _take(self, now: int) -> None:
        far, end, encode = self.connector.in_, self.end, self._encode
        transport = transport_of(self.connector)
        transport.settle()
        queue, read = transport.queue, self._read_aged if self._ages else far.read_nowait
        confirm = not self._drains_full  # its window is too small for an acknowledgement that is kept back
        if (encode_all := self._encode_all) is not None:
            direct = receiver_of(far).direct
            while (count := min(len(direct), end.room_for_all)) > 1:
                if not (heads := encode_all(list(islice(direct, count)))):
                    break
                read_all(far, count)
                end.offer_all(heads, confirm=confirm)
        while (queue or isinstance(transport, Confirmed)) and end.room > 0:
            if queue:
                try:
                    head, parts = encode(read())
                except AiortsError as error:
                    self._not_sent(error)
                    continue
                except WouldBlock:
                    continue  # it has expired in this moment
                end.offer(now, head, parts, confirm=confirm)
            else:
                if not isinstance(transport, Confirmed) or (entry := transport.next_waiting()) is None:
                    return
                try:
                    head, parts = encode(entry.sample)
                except AiortsError as error:
                    self._not_sent(error)
                    transport.settle_fate(entry, refused=True)
                    continue
                if self._ages:
                    end.date = now
                self._confirmed_at = transport.position
                entry.number = end.offer(now, head, parts, confirm=True)
                self._confirmations.append(entry)

    def _read_aged(self) -> Any:
        sample = self.connector.in_.read_nowait()
        transport = transport_of(self.connector)
        assert isinstance(transport, Aged)  # noqa: S101 - its profile has `lifespan`
        self.end.date = transport.taken_ns
        return sample

    def _not_sent(self, error: AiortsError) -> None:
        self._count("unsendable", 1)
        if not self._unsendable:
            self._unsendable = True
            report(f"{self.connector.name}: dropped what cannot be sent: {error}")

    def _transport(self) -> Linked:
        found = transport_of(self.connector)
        assert isinstance(found, Linked)  # noqa: S101 - its profile has `on_link_lost`
        return found

    def offer(self, writer: Path, reader: Path) -> LinkOffer:
        """The offer to the reader's kernel."""
        out = self.connector.out
        schema, text = layout_of(out.type)
        return LinkOffer(
            protocol=versions.SPOKEN,
            link=self.connector.name,
            writer=writer,
            reader=reader,
            writer_epoch=self.end.epoch,
            reader_epoch=0,
            number=0,
            schema=schema,
            type_text=text,
            unit=out.unit,
            shape=out.shape,
            profile=self.connector.profile,
            window=_WINDOW,
            window_bytes=_WINDOW_BYTES,
        )

    # -- the channel -----------------------------------------------------------------------------------------------

    def connect(self, channel: Channel, number: int, peer_epoch: int) -> None:
        """Send over this channel from now on; frames carry `number`."""
        self._channel, self.why = channel, ""
        self.end.renumber(number)
        is_another = self.end.channel_up(self._now(), peer_epoch)
        self._settle()
        if is_another:
            lost, self.end.lost = self.lost, {}
            self._dropped, self.refused = added(added(self._dropped, self.refused), lost), {}
            self._acknowledged -= sum(lost.values())
            self.acknowledged_before, self._overwritten = self._acknowledged, 0
        self.pump()
        if is_another and self.connector.profile.keep_last:
            self._offer_last()
            self.pump()

    def _offer_last(self) -> None:
        """Give a new reader the sample that the writer wrote last, as a new connector in one kernel does.

        The sample is sent once and in order: among the waiting samples if it is one of them, else behind them.
        """
        transport = self._transport()
        with transport.guard():
            transport.settle()
            # The out-port also keeps a sample that is on its way while its writer waits.
            is_missed = transport.missed == transport.position != self._confirmed_at
            if (self.busy or transport.buffered) and not is_missed:
                transport.spare_newest()
            elif (sample := last_written(self.connector.out)) is not NOTHING:
                transport.put_last(sample)

    @property
    def busy(self) -> bool:
        """Whether something is on its way, or waits to be sent."""
        transport = self._transport()
        return self.end.ledger.in_flight > 0 or bool(transport.queue) or bool(transport.waiting)

    def idle(self) -> asyncio.Future[None] | None:
        """A future, done when no sample is on its way any more or the channel is gone; None: that is so now."""
        if self._channel is None or not self.busy:
            return None
        if self._idle is None or self._idle.done():
            self._idle = self._kernel.loop.create_future()
        return self._idle

    def _look_idle(self) -> None:
        idle = self._idle
        if idle is not None and not idle.done() and (self._channel is None or not self.busy):
            idle.set_result(None)

    def on_frames(self, frames: Sequence[tuple[Buffer, tuple[Buffer, ...]]]) -> None:
        now, end = self._now(), self.end
        for head, _ in frames:
            end.receive(now, head)
        self._settle()
        transport = transport_of(self.connector)
        if end.ledger.in_flight or end.query or transport.queue or transport.waiting:
            self.pump()
        if end.lost:
            self._report_lost()
        if self._idle is not None:
            self._look_idle()
        if end.peer_ended and not self._ended:
            self._owner.left()

    def _report_lost(self) -> None:
        """Report that the reader's buffer overwrites, where it has overwritten more than at the last call."""
        overwritten = self.lost.get("overwritten", 0)
        if overwritten > self._overwritten and (losses := self._transport().losses):
            losses.begin(self.connector)
        self._overwritten = overwritten

    def on_room(self) -> None:
        self.end.on_room(self._now())
        self.pump()

    def on_clock(self, ahead_ns: int, within_ns: int) -> None:
        """Ignore the other end's clock: stamps are those of this kernel's clock."""

    def _down(self, why: str) -> None:
        super()._down(why)
        self._look_idle()

    def close(self, *, for_good: bool) -> None:
        """Close the side of an ended connector; `for_good`: tell the reader's end. Waiting writes go on. Idempotent."""
        if self._ended:
            return
        self._ended = True
        self._wakening.cancel()
        self._limit.cancel()
        channel, self._channel = self._channel, None
        self.end.end(self._now(), channel.send if channel is not None and for_good else _nowhere)
        self._settle()
        self._look_idle()
        if channel is not None:
            channel.close()

    def _wake(self) -> None:
        now = self._now()
        if self._channel is not None and self.end.is_unanswered(now):
            self.drop("the reader's end has not answered")
            self._owner.silent()
        else:
            self._poll(now)

    def _settle(self) -> None:
        """Count the fates of samples, and let the writes that wait for them go on."""
        for first, last, fate in self.end.fates():
            if fate == _ACKNOWLEDGED:
                self._acknowledged += last - first + 1
            elif fate in _OWN_FATES:
                self._count(fate, last - first + 1)
                if fate == _UNKNOWN:
                    what = f"dropped{{{_UNKNOWN}}} {last - first + 1}: sent to a reader that is gone"
                    report(f"{self.connector.name}: {what}, which may have read them or not")
            else:
                self.refused = added(self.refused, {fate: last - first + 1})
            confirmations = self._confirmations
            while confirmations and confirmations[0].number <= last:
                entry, transport = confirmations.popleft(), transport_of(self.connector)
                if isinstance(transport, Confirmed) and not entry.done:
                    transport.settle_fate(entry, refused=fate == "rejected")

    def _count(self, reason: str, count: int) -> None:
        self._dropped = added(self._dropped, {reason: count})


def _least(profile: ConnectorProfile) -> int | None:
    """The smallest window for a slow reader, in samples; None: the window is always whole."""
    if profile.full is FullPolicy.OVERWRITE or profile.subscription is Subscription.FLUSH:
        return None  # the reader's end takes all that comes, or the writer waits for each
    return max(_LEAST, profile.length)


def _nowhere(_head: bytes, _parts: Sequence[memoryview]) -> bool:
    return True
