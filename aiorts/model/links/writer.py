"""The writer's end of a link: numbers, keeps and sends samples until each is acknowledged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import repeat
from operator import itemgetter
from typing import Final

from aiorts.late import dataclass
from aiorts.model.links import frames
from aiorts.model.links.frames import BATCH, BATCH_BYTES, DATA, BadFrame, Buffer, Send, check_window, numbered
from aiorts.model.links.state import LinkState

_HEAD, _PARTS, _CONFIRM = map(itemgetter, range(3))
"""The items of a sample that is kept."""
_MS: Final = 1_000_000
FIRST_NS: Final = 200 * _MS
"""After this time without an answer a frame is sent again, as long as no round trip was measured."""
LEAST_NS: Final = 100 * _MS
"""The same at the least: the reader's end may keep an acknowledgement back for 50 ms."""
LONGEST_NS: Final = 2_000 * _MS
"""Each time it doubles, up to this."""
STALLED_NS: Final = 2_000 * _MS
UNANSWERED_NS: Final = 10_000 * _MS
"""A channel on which no hello was answered for so long leads nowhere."""
_KEPT_BACK_NS: Final = 50 * _MS
_KEEPS_UP_NS: Final = 100 * _MS
"""A reader in whose buffer a sample is within this time, and two round trips, keeps up."""


@dataclass(slots=True)
class WriterLedger:
    """What the writer's end took, and what became of it: offered = acknowledged + dropped + in_flight."""

    offered: int = 0
    acknowledged: int = 0
    dropped: int = 0
    """What the reader's end did not put into the buffer, with those of unknown fate and those withdrawn."""
    sent_again: int = 0
    """Samples that the channel took once more."""
    bad_frames: int = 0

    @property
    def in_flight(self) -> int:
        """Neither acknowledged nor dropped yet."""
        return self.offered - self.acknowledged - self.dropped


class WriterEnd:
    """The writer's end of one link. See `aiorts.model.links`.

    Args:
        number: that frames carry; the reader's end chooses it for each channel (`renumber`).
        epoch: of this end.
        window: samples that may be unacknowledged, 1 to 65,535.
        window_bytes: the same in bytes; one larger sample goes alone.
        least: the window at the beginning, and while the reader does not keep up, so that the writer's buffer decides
            soon. It doubles with each round trip in which the reader keeps up. None: it is always whole.
    """

    def __init__(
        self, number: int, epoch: int, *, window: int = 256, window_bytes: int = 8 << 20, least: int | None = None
    ) -> None:
        check_window(window)
        self.number, self.epoch = number, epoch
        self.ledger = WriterLedger()
        self.peer_ended = False
        """Whether the reader's end was disconnected."""
        self.lost: Mapping[str, int] = {}
        """Acknowledged samples that the reader's end has lost, by reason, as it has said last."""
        self._window, self._window_bytes = window, window_bytes
        self._least = self._open = window if least is None else min(least, window)
        """The smallest window, and the present one."""
        self._narrows = self._least < window
        self._judged, self._late_ns = 0, 0
        """The number of the sample whose time into the reader's buffer is taken, 0: none; and when that is late."""
        self._fills = self._slow = False
        """Whether that sample has filled the window; whether the reader does not keep up."""
        self._peer_epoch = 0
        self._kept: dict[int, tuple[bytes, Sequence[memoryview], bool]] = {}
        """What is not acknowledged, by number, without a gap."""
        self.query = 0
        """Whether the reader's end asks for a sample: 1 now, 2 for the next one; of links that pull."""
        self._is_query_new = False
        self.date: int | None = None
        """When the sample was written that is offered next, where samples expire: frames say how old each is."""
        self._dates: dict[int, int] = {}
        """Of what is kept, by number."""
        self._bytes = 0
        self._oldest = 1
        """The number of the first that is kept, or of the next one."""
        self._next = 1
        self._sent = 0
        """Sent on this channel up to this number."""
        self._highest = 0
        """Ever sent up to this number."""
        self._received = 0
        """The reader's end has received up to this number."""
        self._fates: list[tuple[int, int, str]] = []
        self._up = self._was_up = self._greeted = self._ended = False
        self._hello_ns = 0
        """When hello is to be said (again)."""
        self._pause_ns = FIRST_NS
        self._again_ns = 0
        """When what was not received is sent again."""
        self._heard_ns = 0
        self._trip_ns = 0
        """The round trip, smoothed; 0: not measured."""
        self._timed: tuple[int, int] = (0, 0)
        """A number whose round trip is being measured, and when it was sent."""

    # -- the channel -----------------------------------------------------------------------------------------------

    def renumber(self, number: int) -> None:
        """Frames carry this number from now on."""
        self.number = number

    def channel_up(self, now: int, peer_epoch: int) -> bool:
        """There is a channel. The same reader's end as before goes on where it was; what another one was sent before
        is of unknown fate, and numbers begin anew. Returns whether there was another one before."""
        is_another = bool(self._peer_epoch) and peer_epoch != self._peer_epoch
        if is_another:
            self._begin_anew()
        self._peer_epoch, self._up, self._was_up, self._greeted = peer_epoch, True, True, False
        self._hello_ns = self._heard_ns = now
        self._pause_ns, self._timed = FIRST_NS, (0, 0)
        return is_another

    def channel_down(self, now: int) -> None:
        """The channel is gone; all is kept."""
        self._up = self._greeted = False

    def _begin_anew(self) -> None:
        unsent = [self._kept[number] for number in range(self._highest + 1, self._next)]
        self._give_up("unknown_fate", self._highest)
        self._kept = dict(enumerate(unsent, 1))
        self._dates = {number - self._highest: date for number, date in self._dates.items()}
        self._oldest, self._next = 1, 1 + len(unsent)
        self._sent = self._highest = self._received = self.query = self._judged = 0
        self._open, self._slow = self._least, False

    def state(self, now: int) -> LinkState:
        """How far the link is."""
        if self._ended or self.peer_ended:
            return LinkState.ENDED
        if not self._up:
            return LinkState.DOWN if self._was_up else LinkState.CONNECTING
        if not self._greeted:
            return LinkState.CONNECTING
        waits = self._highest >= self._oldest and now - self._heard_ns > STALLED_NS
        return LinkState.STALLED if waits else LinkState.UP

    def is_unanswered(self, now: int) -> bool:
        """Whether no answer comes on this channel: another one may lead to the reader's end."""
        return self._up and not self._greeted and now - self._heard_ns >= UNANSWERED_NS

    # -- samples ---------------------------------------------------------------------------------------------------

    @property
    def room(self) -> int:
        """Samples that `offer` takes now, as far as their bytes allow."""
        kept = len(self._kept)
        if not self._up or (kept and self._bytes >= self._window_bytes):
            return 0
        return self._open - kept

    @property
    def room_for_all(self) -> int:
        """Samples that `offer_all` takes now; 0 where each may change how many more there is room for."""
        return 0 if self._narrows or self.date is not None else self.room

    @property
    def numbered(self) -> int:
        """The number of the sample that was offered last; 0: none was since numbers began."""
        return self._next - 1

    @property
    def round_trip_ns(self) -> int | None:
        """The time from sending to acknowledgement, smoothed; None: not measured yet."""
        return self._trip_ns or None

    @property
    def peer_epoch(self) -> int:
        """Of the reader's end; 0: there was none yet."""
        return self._peer_epoch

    def offer(self, now: int, head: bytes, parts: Sequence[memoryview] = (), *, confirm: bool = False) -> int:
        """Take one sample; returns its number. There is room. `confirm`: have it acknowledged at once."""
        number = self._next
        self._next += 1
        if self._narrows:
            fills = len(self._kept) + 1 >= self._open
            if fills or not self._judged or now > self._late_ns:
                confirm |= self._judge(now, number, fills)
        self._kept[number] = (head, parts, confirm)
        if self.date is not None:
            self._dates[number] = self.date
        self._bytes += len(head) if not parts else len(head) + sum(part.nbytes for part in parts)
        self.ledger.offered += 1
        return number

    def offer_all(self, heads: Sequence[bytes], *, confirm: bool) -> None:
        """`offer` of several samples without parts. `room_for_all` is not less than their number."""
        number, count = self._next, len(heads)
        self._next = number + count
        self._kept.update(enumerate(zip(heads, repeat(()), repeat(confirm)), number))
        self._bytes += sum(map(len, heads))
        self.ledger.offered += count

    @property
    def takes_alone(self) -> bool:
        """Whether `send_alone` takes a sample: there is room, and all that was offered before was sent."""
        kept = self._kept
        return (
            self._greeted  # which it is not while the channel is down
            and self._highest == self._sent == self._next - 1
            and not self._narrows
            and len(kept) < self._window
            and (self._bytes < self._window_bytes or not kept)
        )

    def send_alone(self, now: int, head: bytes, confirm: bool, send: Send) -> int:
        """`offer` and `poll`, for a sample without parts that does not expire; when `poll` is to be called.

        What is to be sent again is left to that.
        """
        number = self._next
        self._next = number + 1
        self._kept[number] = head, (), confirm
        self._bytes += len(head)
        self.ledger.offered += 1
        oldest = self._oldest
        if number == oldest:
            self._heard_ns = now  # nothing was on its way
            self._again_ns = now + self._pause_ns
        if send(numbered(DATA, confirm, 1, self.number, number, oldest) + head, ()):
            self._sent = self._highest = number
            if not self._timed[0]:
                self._timed = number, now
        return self._again_ns

    def answer_none(self, send: Send) -> None:
        """There is no sample to answer the query with; one for the next sample stays."""
        if self._is_query_new:
            self._is_query_new = False
            send(frames.none(self.number, self._next, wait=self.query > 1), ())
        if self.query == 1:
            self.query = 0

    def fates(self) -> list[tuple[int, int, str]]:
        """What became of samples since the last call: first and last number, and "acknowledged", "unknown_fate" or
        why it is not in the reader's buffer ("rejected" and others)."""
        found, self._fates = self._fates, []
        return found

    # -- frames ----------------------------------------------------------------------------------------------------

    def receive(self, now: int, head: Buffer) -> None:
        """Take a frame of the reader's end; what is none is counted."""
        try:
            kind, flags, count, one, received = frames.head_of(head, self.number)
            if kind == frames.ACK:
                if count > self._window:
                    raise BadFrame("of more samples than are on their way")
                self._acknowledge(now, one, received, frames.fates_of(head, count) if count else {})
            elif kind == frames.HELLO:
                if one != self._peer_epoch or received > self._highest:
                    raise BadFrame("of another end")
                if not self._greeted:
                    self._greeted, self._pause_ns = True, self._first_pause()
                    self._received = max(self._received, received)
                    self._sent = max(self._received, self._oldest - 1)
                    self._heard_ns = now
            elif kind == frames.WANT:
                if one == self._next:  # else it was answered already
                    self.query, self._is_query_new = 1 + (flags & frames.WAIT), True
            elif kind == frames.LOST:
                if one != self._peer_epoch:
                    raise BadFrame("of another end")
                self.lost = frames.losses_of(head, count)
            elif kind == frames.BYE:
                self.peer_ended = True
            else:
                raise BadFrame("of an unknown kind")
        except BadFrame:
            self.ledger.bad_frames += 1

    def _acknowledge(self, now: int, done: int, received: int, fates: dict[int, str]) -> None:
        if not done <= received <= self._highest:
            raise BadFrame("acknowledges what was never sent")
        number, sent_ns = self._timed
        if number and received >= number:
            trip = now - sent_ns
            self._trip_ns = trip if not self._trip_ns else (7 * self._trip_ns + trip) // 8
            self._timed = (0, 0)
            self._pause_ns = self._first_pause()
        first = self._oldest
        if received > self._received:
            self._received = received
            self._sent = max(self._sent, received)
        elif done < first:
            return
        self._heard_ns = now
        self._again_ns = now + self._pause_ns
        if done < first:
            return
        for number in sorted(number for number in fates if first <= number <= done) if fates else ():
            self._settle(self._oldest, number - 1, "acknowledged")
            fate = fates[number]
            self._settle(number, number, fate if fate in frames.FATES else frames.REFUSED)
        self._settle(self._oldest, done, "acknowledged")
        if self._slow:  # one for two that were read: its writer does not stop until the window is narrow
            self._open = max(self._least, self._open - done // 2 + (first - 1) // 2)
        if 0 < self._judged <= done:
            self._judged, self._slow = 0, now > self._late_ns
            if not self._slow:
                self._open = min(2 * self._open, self._window)

    def _judge(self, now: int, number: int, fills: bool) -> bool:
        """Look whether the reader keeps up. Returns whether this sample is to be acknowledged at once: it `fills` a
        window that is not whole."""
        if not self._judged or (fills and not self._fills):
            self._judged, self._fills = number, fills
            self._late_ns = now + _KEEPS_UP_NS + 2 * self._trip_ns
        elif now > self._late_ns:
            self._slow, self._open = True, max(self._least, min(self._open, len(self._kept) + 1))
        return fills and self._open < self._window

    def _settle(self, first: int, last: int, fate: str) -> None:
        if last < first:
            return
        gone = list(map(self._kept.pop, range(first, last + 1)))
        self._bytes -= len(gone[0][0]) if first == last else sum(map(len, map(_HEAD, gone)))
        for parts in filter(None, map(_PARTS, gone)):
            self._bytes -= sum(part.nbytes for part in parts)
        if self._dates:
            self._dates = {number: date for number, date in self._dates.items() if number > last}
        self._oldest = last + 1
        count = last - first + 1
        ledger = self.ledger
        if fate == "acknowledged":
            ledger.acknowledged += count
        else:
            ledger.dropped += count
        if self._fates and self._fates[-1][2] == fate and self._fates[-1][1] == first - 1:
            first = self._fates.pop()[0]
        self._fates.append((first, last, fate))

    def _give_up(self, fate: str, last: int) -> None:
        self._settle(self._oldest, last, fate)

    def _first_pause(self) -> int:
        return min(max(3 * self._trip_ns + _KEPT_BACK_NS, LEAST_NS), LONGEST_NS) if self._trip_ns else FIRST_NS

    def on_room(self, now: int) -> None:
        """The channel takes frames again: `poll` goes on."""

    def poll(self, now: int, send: Send) -> int | None:
        """Send what is due; returns when it is to be called at the latest, None: when something happens."""
        if not self._up or self._ended:
            return None
        if not self._greeted:
            if now >= self._hello_ns:
                send(frames.hello(self.number, self.epoch, 0), ())
                self._hello_ns = now + self._pause_ns
                self._pause_ns = min(2 * self._pause_ns, LONGEST_NS)
            return self._hello_ns
        if self._sent >= self._oldest and now >= self._again_ns:
            self._timed = (0, 0)
            self._pause_ns = min(2 * self._pause_ns, LONGEST_NS)
            self._again_ns = now + self._pause_ns
            if self._sent > self._received:
                self._sent = max(self._received, self._oldest - 1)
            else:
                # All has come, and the reader has no room, or its acknowledgement was lost: hello asks for another.
                send(frames.hello(self.number, self.epoch, 0), ())
        if self._sent + 1 < self._next:
            self._send(now, send)
        return self._again_ns if self._sent >= self._oldest else None

    def _send(self, now: int, send: Send) -> None:
        if self._sent < self._oldest:
            if self._highest < self._oldest:
                self._heard_ns = now  # nothing was on its way
            self._again_ns = now + self._pause_ns
        kept, last = self._kept, self._next - 1
        while self._sent < last:
            first = self._sent + 1
            head, parts, confirm = kept[first]
            heads, size, number = [head], len(head), first
            if first < last and last - first < BATCH and self._bytes <= BATCH_BYTES:
                # All that is kept has room in one frame: nothing is to be asked of each.
                rest = [kept[number] for number in range(first, last + 1)]
                if not any(map(_PARTS, rest)):
                    heads, confirm, number = list(map(_HEAD, rest)), any(map(_CONFIRM, rest)), last
            while not parts and number < last and len(heads) < BATCH:
                head, more, confirms = kept[number + 1]
                size += len(head)
                if more or size > BATCH_BYTES:
                    break
                confirm |= confirms
                heads.append(head)
                number += 1
            ages = self._ages(now, first, number) if self._dates else ()
            frame = frames.data(self.number, first, self._oldest, heads, confirm=confirm, ages=ages)
            if not send(frame, parts):
                return
            self._sent = number
            if first <= self._highest:
                self.ledger.sent_again += min(number, self._highest) - first + 1
            if number > self._highest:
                self._highest = number
                if not self._timed[0]:
                    self._timed = (number, now)

    def _ages(self, now: int, first: int, last: int) -> Sequence[int]:
        dates = self._dates
        return [max(0, now - dates.get(number, now)) for number in range(first, last + 1)]

    def end(self, now: int, send: Send) -> None:
        """This end was disconnected: say so. What was sent and is not acknowledged is of unknown fate, the rest is
        dropped as disconnected."""
        if self._ended:
            return
        self._ended = True
        if self._up:
            send(frames.bye(self.number), ())
        self._greeted = False
        self._give_up("unknown_fate", self._highest)
        self._give_up("disconnected", self._next - 1)
