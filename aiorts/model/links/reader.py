"""The reader's end of a link: gives samples out in order, each once, and says what became of them."""

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
"""The items of a sample that has come."""
_ERA: Final = 1 << 64
ACK_NS: Final = 50_000_000
"""How long an acknowledgement may be kept back."""
_TELL_NS: Final = 50_000_000
"""How soon after an acknowledgement the writer's end is told of losses."""
_ACK_BYTES: Final = 1 << 19
"""After so many bytes it is not: until then the writer keeps large samples, and its memory for the next is fresh, which
the system clears page by page."""
_AGAIN_NS: Final = 200_000_000
"""After this time without an answer a sample is asked for again; each time it doubles, up to the next."""
_LONGEST_NS: Final = 2_000_000_000

Received: TypeAlias = tuple[int, Buffer, Sequence[Buffer]]
"""A sample that has come: its ticket (the number, with which writer's end it is of in the upper bits), head, parts."""


@dataclass(slots=True)
class ReaderLedger:
    """What the reader's end received, and what became of it: received = delivered + dropped + held."""

    received: int = 0
    delivered: int = 0
    """Given to the reader's buffer."""
    dropped: int = 0
    duplicates: int = 0
    """Samples that came again."""
    ahead: int = 0
    """Samples that came before one that is missing: they come again."""
    bad_frames: int = 0

    @property
    def held(self) -> int:
        """Neither given to the reader's buffer yet nor dropped."""
        return self.received - self.delivered - self.dropped


class ReaderEnd:
    """The reader's end of one link. See `aiorts.model.links`.

    Args:
        number: that frames carry (`renumber`). epoch: of this end.
        window: samples that the writer's end may have unacknowledged, 1 to 65,535.
        window_bytes: the same in bytes. What is far beyond that is not taken: it comes again.
    """

    def __init__(self, number: int, epoch: int, *, window: int = 256, window_bytes: int = 8 << 20) -> None:
        check_window(window)
        self.number, self.epoch = number, epoch
        self.ledger = ReaderLedger()
        self.peer_ended = False
        """Whether the writer's end was disconnected."""
        self.date: int | None = None
        """When the sample that was taken last was written, by this end's clock, less its time on the way; None: it is
        of a link whose samples do not expire."""
        self._dates: dict[int, int] = {}
        """Of what is held, by ticket."""
        self._window, self._window_bytes = window, window_bytes
        self._bytes = 0
        """Bytes of what is held."""
        self._unacknowledged, self._most_unacknowledged = 0, min(window_bytes // 2, _ACK_BYTES)
        """Bytes of what has come since the last acknowledgement."""
        self._peer_epoch = 0
        self._era = 0
        """Counts the writer's ends: what one sent that is no more is given out and never acknowledged."""
        self._received = 0
        self._done = 0
        self._held: deque[Received] = deque()
        self._fates: dict[int, str] = {}
        """Of samples that are not in the buffer, until the writer's end has been told for certain."""
        self._confirm = 0
        """The sample of this number is to be acknowledged at once; 0: none."""
        self._ack_at = window // 2
        """Acknowledge at once when this number is done: that one, or half a window after the last acknowledgement."""
        self._ack_ns: int | None = None
        self._wanted = 0
        """Whether a sample is asked for: 1 one that is there, 2 else the next one."""
        self._want_ns: int | None = None
        """When it is asked for (again); None: the writer's end knows of it."""
        self._want_pause_ns = 0
        self._lost: Mapping[str, int] = {}
        """Samples that the reader's buffer has lost, by reason."""
        self.tell_ns = 0
        """When `lost` is to be called; 0: nothing was acknowledged since."""
        self._up = self._was_up = self._hello = self._tells_lost = self._ended = False

    def renumber(self, number: int) -> None:
        """Frames carry this number from now on."""
        self.number = number

    def channel_up(self, now: int, peer_epoch: int) -> None:
        """There is a channel. With another writer's end than before numbers begin anew; what came before stays."""
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
        """The channel is gone; all is kept."""
        self._up = False

    def state(self, now: int) -> LinkState:
        """How far the link is."""
        if self._ended or self.peer_ended:
            return LinkState.ENDED
        if self._up:
            return LinkState.UP
        return LinkState.DOWN if self._was_up else LinkState.CONNECTING

    def receive(self, now: int, head: Buffer, parts: Sequence[Buffer] = ()) -> None:
        """Take a frame of the writer's end; what is none is counted."""
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
        """`receive` and `take` of a frame that has the next sample alone, behind which nothing waits: its ticket.

        The sample is what stands in the frame from `frames.SOLE` on. 0: it is no such frame, and was not received.
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
        """`done` of the sample that `receive_alone` has taken last; when it is to be acknowledged: `now`, or later."""
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
        """Ask for a sample, unless that is under way; `wait`: for the next one where there is none. Returns whether
        there is something to send."""
        if self._wanted >= 1 + wait:
            return False
        self._wanted, self._want_ns, self._want_pause_ns = 1 + wait, now, _AGAIN_NS
        return True

    def poll_query(self, now: int, send: Send) -> int | None:
        """As `poll`, of what is asked for."""
        if not self._up or self._ended or self._want_ns is None or now < self._want_ns:
            return self._want_ns if self._up else None
        send(frames.want(self.number, self._received + 1, wait=self._wanted > 1), ())
        self._want_ns = now + self._want_pause_ns
        self._want_pause_ns = min(2 * self._want_pause_ns, _LONGEST_NS)
        return self._want_ns

    def _is_none(self, number: int, *, wait: bool) -> None:
        if number != self._received + 1 or 1 + wait < self._wanted:
            return  # of an earlier query
        self._want_ns = None
        if self._wanted == 1:
            self._wanted = 0

    def take(self) -> Received | None:
        """The next sample in order; None where there is none. `done` and `failed` say what became of it, in order."""
        if not self._held:
            return None
        found = self._held.popleft()
        ticket, head, parts = found
        if self._dates:
            self.date = self._dates.pop(ticket, None)
        self._bytes -= len(head) if not parts else len(head) + sum(map(len, parts))
        return found

    def heads(self, count: int) -> list[Buffer]:
        """The heads of the next samples, as many as are held but at most so many: `take_all` takes them.

        None where one has parts, or they expire.
        """
        first = list(islice(self._held, max(count, 0)))
        return [] if self._dates or any(map(_PARTS, first)) else list(map(_HEAD, first))

    def take_all(self, count: int) -> int:
        """Take so many samples that `heads` has given; the ticket of the last. `done` says that they are taken."""
        held = self._held
        taken = [held.popleft() for _ in repeat(None, count)]
        self._bytes -= sum(map(len, map(_HEAD, taken)))
        return taken[-1][0]

    @property
    def held(self) -> int:
        """Samples that have come and were not taken."""
        return len(self._held)

    @property
    def newest(self) -> int:
        """The ticket of the newest sample that has come and was not taken; 0: all were."""
        return self._held[-1][0] if self._held else 0

    @property
    def received(self) -> int:
        """All up to this number have come of the writer's end there is now."""
        return self._received

    @property
    def peer_epoch(self) -> int:
        """Of the writer's end; 0: there was none yet."""
        return self._peer_epoch

    def done(self, now: int, ticket: int, count: int = 1) -> None:
        """So many samples are in the reader's buffer, the last of them with this ticket."""
        if count:
            self.ledger.delivered += count
            self._through(now, ticket - self._era)

    def failed(self, now: int, ticket: int, why: str) -> None:
        """A sample is not in the reader's buffer: "rejected", or another reason."""
        self.ledger.dropped += 1
        if (number := ticket - self._era) > 0:
            self._fates[number] = why
        self._through(now, number)

    def _through(self, now: int, number: int) -> None:
        if number <= 0:
            return  # of an end that is no more
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
        """The channel takes frames again: `poll` goes on."""

    def poll(self, now: int, send: Send) -> int | None:
        """Send what is due; returns when it is to be called at the latest, None: when something happens."""
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
        """This end was disconnected: say so."""
        if not self._ended and self._up:
            if self._ack_ns is not None:
                self._ack_ns = now
                self.poll(now, send)
            send(frames.bye(self.number), ())
        self._ended = True
