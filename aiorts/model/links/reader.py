"""The reader's end of a link: gives samples out in order, each once, and reports their fates."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from itertools import islice, repeat
from operator import itemgetter
from typing import Final, TypeAlias

from aiorts.late import dataclass
from aiorts.model.links import frames
from aiorts.model.links.frames import CONFIRM, DATA, SOLE, BadFrame, Buffer, Send, check_window, numbers_of
from aiorts.model.links.state import LinkState

_HEAD, _PARTS = itemgetter(1), itemgetter(2)
"""Getters of the items of a received sample."""
_ERA: Final = 1 << 64
ACK_NS: Final = 50_000_000
"""The longest time for which an acknowledgement is kept back."""
_TELL_NS: Final = 50_000_000
"""The time after an acknowledgement at which the writer's end is notified of losses."""
_ACK_BYTES: Final = 1 << 19
"""After this many bytes no acknowledgement is kept back: until it comes, the writer keeps large samples, and needs
fresh memory for the next samples, which the system clears page by page."""
_AGAIN_NS: Final = 200_000_000
"""The time without an answer after which a sample is asked for again; it doubles each time, up to `_LONGEST_NS`."""
_LONGEST_NS: Final = 2_000_000_000

Received: TypeAlias = tuple[int, Buffer, Sequence[Buffer]]
"""A received sample: its ticket (its number, with the count of its writer's end in the upper bits), head, parts."""


@dataclass(slots=True)
class ReaderLedger:
    """The counts of samples at the reader's end: received = delivered + dropped + held."""

    received: int = 0
    delivered: int = 0
    """Samples given to the reader's buffer."""
    dropped: int = 0
    duplicates: int = 0
    """Samples that came again."""
    ahead: int = 0
    """Samples that came ahead of a missing one: they come again."""
    bad_frames: int = 0

    @property
    def held(self) -> int:
        """Samples neither given to the reader's buffer yet nor dropped."""
        return self.received - self.delivered - self.dropped


class ReaderEnd:
    """The reader's end of one link. See `aiorts.model.links`.

    Args:
        number: the number that frames carry (`renumber`). epoch: the epoch of this end.
        window: samples that the writer's end may have unacknowledged, 1 to 65,535.
        window_bytes: the same in bytes. Samples far beyond it are not taken: they come again.
    """

    def __init__(self, number: int, epoch: int, *, window: int = 256, window_bytes: int = 8 << 20) -> None:
        check_window(window)
        self.number, self.epoch = number, epoch
        self.ledger = ReaderLedger()
        self.peer_ended = False
        """Whether the writer's end was disconnected."""
        self.date: int | None = None
        """The time at which the last taken sample was written, by this end's clock, its time on the way left out.
        None: samples of this link do not expire."""
        self._dates: dict[int, int] = {}
        """The dates of the held samples, by ticket."""
        self._window, self._window_bytes = window, window_bytes
        self._bytes = 0
        """The bytes of the held samples."""
        self._unacknowledged, self._most_unacknowledged = 0, min(window_bytes // 2, _ACK_BYTES)
        """The bytes that have come since the last acknowledgement, and the number of bytes that make the next due."""
        self._peer_epoch = 0
        self._era = 0
        """Counts the writer's ends. Samples of an earlier end are given out and never acknowledged."""
        self._received = 0
        self._done = 0
        self._held: deque[Received] = deque()
        self._fates: dict[int, str] = {}
        """The fates of samples that are not in the buffer, until the writer's end certainly knows them."""
        self._confirm = 0
        """The number of the sample that is to be acknowledged at once; 0: none."""
        self._ack_at = window // 2
        """The number that is acknowledged once done: `_confirm`, or half a window after the last acknowledgement."""
        self._ack_ns: int | None = None
        self._wanted = 0
        """The question for a sample. 0: none; 1: a sample that is there; 2: such a sample, or else the next."""
        self._want_ns: int | None = None
        """The time at which the sample is asked for (again); None: the writer's end knows of it."""
        self._want_pause_ns = 0
        self._lost: Mapping[str, int] = {}
        """Samples that the reader's buffer has lost, by reason."""
        self.tell_ns = 0
        """The time at which `lost` is to be called; 0: nothing was acknowledged since."""
        self._up = self._was_up = self._hello = self._tells_lost = self._ended = False

    def renumber(self, number: int) -> None:
        """Set the number that frames carry from now on."""
        self.number = number

    def channel_up(self, now: int, peer_epoch: int) -> None:
        """Use a new channel. With another writer's end than before, numbers begin again; received samples stay."""
        if peer_epoch != self._peer_epoch:
            self._received = self._done = self._confirm = 0
            self._ack_at = self._window // 2
            self._fates.clear()
            self._era += _ERA
        self._peer_epoch, self._up, self._was_up, self._hello = peer_epoch, True, True, True
        self._tells_lost = bool(self._lost)
        self._ack_ns = now
        if self._wanted:
            self._want_ns, self._want_pause_ns = now, _AGAIN_NS

    def channel_down(self, now: int) -> None:
        """Note that the channel is gone; all samples are kept."""
        self._up = False

    def state(self, now: int) -> LinkState:
        """The state of the link."""
        if self._ended or self.peer_ended:
            return LinkState.ENDED
        if self._up:
            return LinkState.UP
        return LinkState.DOWN if self._was_up else LinkState.CONNECTING

    def receive(self, now: int, head: Buffer, parts: Sequence[Buffer] = ()) -> None:
        """Take a frame of the writer's end; a bad frame is counted."""
        try:
            kind, flags, count, one, oldest = frames.head_of(head, self.number)
            if kind == frames.DATA:
                ages = frames.ages_of(head, count) if flags & frames.AGED else ()
                samples = frames.samples_of(head, count, len(ages))
                self._take_in(now, one, oldest, samples, parts, bool(flags & frames.CONFIRM), ages)
            elif kind == frames.NONE:
                self._is_none(one, wait=bool(flags & frames.WAIT))
            elif kind == frames.HELLO:
                if one != self._peer_epoch:
                    raise BadFrame("of another end")
                self._hello, self._ack_ns = True, now
            elif kind == frames.BYE:
                self.peer_ended = True
            else:
                raise BadFrame("of an unknown kind")
        except BadFrame:
            self.ledger.bad_frames += 1

    def receive_alone(self, now: int, head: Buffer) -> int:
        """Do `receive` and `take` for a frame of just the next sample while nothing is held; returns the ticket.

        The sample is the rest of the frame from `frames.SOLE` on. 0: it is no such frame; nothing is received.
        """
        size = len(head) - SOLE
        if size < 0 or self._held or self._fates or self._wanted or self._dates:
            return 0
        kind, flags, count, link, number, _ = numbers_of(head)
        if kind != DATA or count != 1 or number != self._received + 1 or link != self.number or flags > CONFIRM:
            return 0
        if flags:
            self._confirm, self._ack_at = number, min(number, self._ack_at)
        self._unacknowledged += size
        self._received = number
        self.ledger.received += 1
        if self._ack_ns is None:
            self._ack_ns = now + ACK_NS
        return self._era + number

    def done_alone(self, now: int) -> int:
        """Do `done` for the last sample of `receive_alone`; returns when to acknowledge it: `now`, or later."""
        self.ledger.delivered += 1
        number = self._done = self._received
        due = self._ack_ns
        if due is None or number >= self._ack_at or self._unacknowledged >= self._most_unacknowledged:
            due = self._ack_ns = now
        return due

    def _take_in(
        self,
        now: int,
        first: int,
        oldest: int,
        samples: list[memoryview],
        parts: Sequence[Buffer],
        confirm: bool,
        ages: Sequence[int],
    ) -> None:
        count = len(samples)
        if parts and count != 1:
            raise BadFrame("parts of several samples")
        if self._fates and oldest > min(self._fates):
            self._fates = {number: fate for number, fate in self._fates.items() if number >= oldest}
        last, ledger, held = first + count - 1, self.ledger, self._held
        if last <= self._received:
            ledger.duplicates += count
            self._ack_ns = now  # the acknowledgement was lost
            return
        if first > self._received + 1:
            ledger.ahead += count
            return
        room = 2 * self._window - len(held) if self._bytes < 2 * self._window_bytes else 0
        fresh = samples
        if first <= self._received or count > room:
            fresh = samples[self._received + 1 - first :]
            ledger.duplicates += count - len(fresh)
            fresh = fresh[: max(0, room)]
            count = len(fresh)
        size = sum(map(len, fresh)) if count != 1 else len(fresh[0]) + (sum(map(len, parts)) if parts else 0)
        self._bytes += size
        self._unacknowledged += size
        next_ticket = self._era + self._received + 1
        if count == 1:
            held.append((next_ticket, fresh[0], parts))
        else:
            held.extend(zip(range(next_ticket, next_ticket + count), fresh, repeat(parts)))
        if ages:
            ages = ages[self._received + 1 - first :]
            self._dates.update((next_ticket + place, now - ages[place]) for place in range(count))
        self._received += count
        if self._wanted and count:
            self._wanted, self._want_ns = 0, None
        ledger.received += count
        if confirm:
            self._confirm, self._ack_at = self._received, min(self._received, self._ack_at)
        if self._ack_ns is None:
            self._ack_ns = now + ACK_NS

    def want(self, now: int, *, wait: bool) -> bool:
        """Ask for a sample, unless that is done already; `wait`: if there is none, for the next. Returns whether a
        frame is to be sent."""
        if self._wanted >= 1 + wait:
            return False
        self._wanted, self._want_ns, self._want_pause_ns = 1 + wait, now, _AGAIN_NS
        return True

    def poll_query(self, now: int, send: Send) -> int | None:
        """Send the request for a sample if it is due; returns the time of the next call, as `poll` does."""
        if not self._up or self._ended or self._want_ns is None or now < self._want_ns:
            return self._want_ns if self._up else None
        send(frames.want(self.number, self._received + 1, wait=self._wanted > 1), ())
        self._want_ns = now + self._want_pause_ns
        self._want_pause_ns = min(2 * self._want_pause_ns, _LONGEST_NS)
        return self._want_ns

    def _is_none(self, number: int, *, wait: bool) -> None:
        if number != self._received + 1 or 1 + wait < self._wanted:
            return  # the answer to an earlier query
        self._want_ns = None
        if self._wanted == 1:
            self._wanted = 0

    def take(self) -> Received | None:
        """The next sample in order; None where there is none. Its fate is reported by `done` or `failed`, in order."""
        if not self._held:
            return None
        found = self._held.popleft()
        ticket, head, parts = found
        if self._dates:
            self.date = self._dates.pop(ticket, None)
        self._bytes -= len(head) if not parts else len(head) + sum(map(len, parts))
        return found

    def heads(self, count: int) -> list[Buffer]:
        """The heads of the next held samples, at most `count`: `take_all` takes them.

        The list is empty if a sample has parts, or if samples expire.
        """
        first = list(islice(self._held, max(count, 0)))
        return [] if self._dates or any(map(_PARTS, first)) else list(map(_HEAD, first))

    def take_all(self, count: int) -> int:
        """Take so many samples that `heads` has given; returns the ticket of the last, for `done`."""
        held = self._held
        taken = [held.popleft() for _ in repeat(None, count)]
        self._bytes -= sum(map(len, map(_HEAD, taken)))
        return taken[-1][0]

    @property
    def held(self) -> int:
        """The number of samples that have come and were not taken."""
        return len(self._held)

    @property
    def newest(self) -> int:
        """The ticket of the newest sample that has come and was not taken; 0: none."""
        return self._held[-1][0] if self._held else 0

    @property
    def received(self) -> int:
        """The number up to which all samples of the present writer's end have come."""
        return self._received

    @property
    def peer_epoch(self) -> int:
        """The epoch of the writer's end; 0: there was none yet."""
        return self._peer_epoch

    def done(self, now: int, ticket: int, count: int = 1) -> None:
        """Note that so many samples are in the reader's buffer; the last has this ticket."""
        if count:
            self.ledger.delivered += count
            self._through(now, ticket - self._era)

    def failed(self, now: int, ticket: int, why: str) -> None:
        """Note that a sample is not put into the reader's buffer, for this reason, such as "rejected"."""
        self.ledger.dropped += 1
        if (number := ticket - self._era) > 0:
            self._fates[number] = why
        self._through(now, number)

    def _through(self, now: int, number: int) -> None:
        if number <= 0:
            return  # a sample of an earlier writer's end
        self._done = number
        if number >= self._ack_at or self._unacknowledged >= self._most_unacknowledged:
            self._ack_ns = now
        elif self._ack_ns is None:
            self._ack_ns = now + ACK_NS

    def lost(self, losses: Mapping[str, int]) -> None:
        """Tell the writer's end how many of its samples the reader's buffer has lost in all, by reason."""
        self.tell_ns = 0
        if losses != self._lost:
            self._lost, self._tells_lost = losses, True

    def on_room(self, now: int) -> None:
        """Do nothing: the channel takes frames again, and `poll` goes on."""

    def poll(self, now: int, send: Send) -> int | None:
        """Send the frames that are due; returns the latest time of the next call, None: when something happens."""
        if not self._up or self._ended:
            return None
        if self._hello:
            if not send(frames.hello(self.number, self.epoch, self._received), ()):
                return None
            self._hello = False
        if self._tells_lost:
            self._tells_lost = not send(frames.lost(self.number, self.epoch, self._lost), ())
        if self._ack_ns is None or now < self._ack_ns:
            return self._ack_ns
        if send(frames.acknowledgement(self.number, self._done, self._received, self._fates), ()):
            self._ack_ns, self._unacknowledged, self._ack_at = None, 0, self._done + self._window // 2
            if self._done >= self._confirm:
                self._confirm = 0
            else:
                self._ack_at = min(self._confirm, self._ack_at)
            self.tell_ns = self.tell_ns or now + _TELL_NS
        return None

    def end(self, now: int, send: Send) -> None:
        """Disconnect this end, and tell the other one."""
        if not self._ended and self._up:
            if self._ack_ns is not None:
                self._ack_ns = now
                self.poll(now, send)
            send(frames.bye(self.number), ())
        self._ended = True
