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
"""Getters of the items of a kept sample."""
_MS: Final = 1_000_000
FIRST_NS: Final = 200 * _MS
"""The time without an answer after which a frame is sent again, as long as no round trip was measured."""
LEAST_NS: Final = 100 * _MS
"""The shortest such time: the reader's end may keep an acknowledgement back for 50 ms."""
LONGEST_NS: Final = 2_000 * _MS
"""The longest such time: it doubles each time, up to this."""
STALLED_NS: Final = 2_000 * _MS
UNANSWERED_NS: Final = 10_000 * _MS
"""The time after which a channel without an answer to hello counts as leading nowhere."""
_KEPT_BACK_NS: Final = 50 * _MS
_KEEPS_UP_NS: Final = 100 * _MS
"""The time, plus two round trips, within which a sample is in the buffer of a reader that keeps up."""


@dataclass(slots=True)
class WriterLedger:
    """The counts of samples at the writer's end: offered = acknowledged + dropped + in_flight."""

    offered: int = 0
    acknowledged: int = 0
    dropped: int = 0
    """Samples that the reader's end did not put into the buffer, that were withdrawn, or of unknown fate."""
    sent_again: int = 0
    """Samples that the channel took again."""
    bad_frames: int = 0

    @property
    def in_flight(self) -> int:
        """Samples neither acknowledged nor dropped yet."""
        return self.offered - self.acknowledged - self.dropped


class WriterEnd:
    """The writer's end of one link. See `aiorts.model.links`.

    Args:
        number: the number that frames carry; the reader's end chooses it for each channel (`renumber`).
        epoch: the epoch of this end.
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
        """Acknowledged samples that the reader's end has lost, by reason, as it has reported last."""
        self._window, self._window_bytes = window, window_bytes
        self._least = self._open = window if least is None else min(least, window)
        """The smallest window, and the present one."""
        self._narrows = self._least < window
        self._judged, self._late_ns = 0, 0
        """The number of the sample whose way into the reader's buffer is timed (0: none), and when it is late."""
        self._fills = self._slow = False
        """Whether that sample has filled the window; whether the reader does not keep up."""
        self._peer_epoch = 0
        self._kept: dict[int, tuple[bytes, Sequence[memoryview], bool]] = {}
        """The unacknowledged samples, by number, without a gap."""
        self.query = 0
        """The query of the reader's end, on links that pull: 1 for a sample now, 2 or else for the next; 0: none."""
        self._is_query_new = False
        self.date: int | None = None
        """The time at which the sample that is offered next was written, where samples expire: frames carry ages."""
        self._dates: dict[int, int] = {}
        """The dates of the kept samples, by number."""
        self._bytes = 0
        self._oldest = 1
        """The number of the first kept sample, or else of the next one."""
        self._next = 1
        self._sent = 0
        """The number up to which samples were sent on this channel."""
        self._highest = 0
        """The number up to which samples were ever sent."""
        self._received = 0
        """The number up to which the reader's end has received."""
        self._fates: list[tuple[int, int, str]] = []
        self._up = self._was_up = self._greeted = self._ended = False
        self._hello_ns = 0
        """The time at which hello is sent (again)."""
        self._pause_ns = FIRST_NS
        self._again_ns = 0
        """The time at which samples that were not received are sent again."""
        self._heard_ns = 0
        self._trip_ns = 0
        """The round trip, smoothed; 0: not measured."""
        self._timed: tuple[int, int] = (0, 0)
        """The number whose round trip is being measured, and the time at which it was sent."""

    # -- the channel -----------------------------------------------------------------------------------------------

    def renumber(self, number: int) -> None:
        """Set the number that frames carry from now on."""
        self.number = number

    def channel_up(self, now: int, peer_epoch: int) -> bool:
        """Use a new channel; returns whether it leads to another reader's end than before.

        The same end goes on where it was. If the end is another, samples sent before are of unknown fate, and
        numbers begin again.
        """
        is_another = bool(self._peer_epoch) and peer_epoch != self._peer_epoch
        if is_another:
            self._begin_anew()
        self._peer_epoch, self._up, self._was_up, self._greeted = peer_epoch, True, True, False
        self._hello_ns = self._heard_ns = now
        self._pause_ns, self._timed = FIRST_NS, (0, 0)
        return is_another

    def channel_down(self, now: int) -> None:
        """Note that the channel is gone; all samples are kept."""
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
        """The state of the link."""
        if self._ended or self.peer_ended:
            return LinkState.ENDED
        if not self._up:
            return LinkState.DOWN if self._was_up else LinkState.CONNECTING
        if not self._greeted:
            return LinkState.CONNECTING
        waits = self._highest >= self._oldest and now - self._heard_ns > STALLED_NS
        return LinkState.STALLED if waits else LinkState.UP

    def is_unanswered(self, now: int) -> bool:
        """Whether no answer comes on this channel: another channel may lead to the reader's end."""
        return self._up and not self._greeted and now - self._heard_ns >= UNANSWERED_NS

    # -- samples ---------------------------------------------------------------------------------------------------

    @property
    def room(self) -> int:
        """The number of samples that `offer` takes now, as far as their bytes allow."""
        kept = len(self._kept)
        if not self._up or (kept and self._bytes >= self._window_bytes):
            return 0
        return self._open - kept

    @property
    def room_for_all(self) -> int:
        """The number of samples that `offer_all` takes now; 0 where each sample may change the room for the next."""
        return 0 if self._narrows or self.date is not None else self.room

    @property
    def numbered(self) -> int:
        """The number of the last offered sample; 0: no sample was offered since numbers began."""
        return self._next - 1

    @property
    def round_trip_ns(self) -> int | None:
        """The time from sending to acknowledgement, smoothed; None: not measured yet."""
        return self._trip_ns or None

    @property
    def peer_epoch(self) -> int:
        """The epoch of the reader's end; 0: there was none yet."""
        return self._peer_epoch

    def offer(self, now: int, head: bytes, parts: Sequence[memoryview] = (), *, confirm: bool = False) -> int:
        """Take one sample, for which there is room; returns its number. `confirm` asks for acknowledgement at once."""
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
        """Take several samples without parts, at most `room_for_all`."""
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
            self._greeted  # False while the channel is down
            and self._highest == self._sent == self._next - 1
            and not self._narrows
            and len(kept) < self._window
            and (self._bytes < self._window_bytes or not kept)
        )

    def send_alone(self, now: int, head: bytes, confirm: bool, send: Send) -> int:
        """Do `offer` and `poll` for a sample without parts that does not expire; returns when to call `poll`.

        Only `poll` sends samples again.
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
        """Answer a new query: there is no sample. A query for the next sample stays."""
        if self._is_query_new:
            self._is_query_new = False
            send(frames.none(self.number, self._next, wait=self.query > 1), ())
        if self.query == 1:
            self.query = 0

    def fates(self) -> list[tuple[int, int, str]]:
        """The fates of samples since the last call: first and last number, and "acknowledged", "unknown_fate" or why
        they are not in the reader's buffer ("rejected" and others)."""
        found, self._fates = self._fates, []
        return found

    # -- frames ----------------------------------------------------------------------------------------------------

    def receive(self, now: int, head: Buffer) -> None:
        """Take a frame of the reader's end; a bad frame is counted."""
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
        if self._slow:  # narrower by one for two samples read: the writer goes on meanwhile
            self._open = max(self._least, self._open - done // 2 + (first - 1) // 2)
        if 0 < self._judged <= done:
            self._judged, self._slow = 0, now > self._late_ns
            if not self._slow:
                self._open = min(2 * self._open, self._window)

    def _judge(self, now: int, number: int, fills: bool) -> bool:
        """Judge whether the reader keeps up. Returns whether this sample is to be acknowledged at once: it `fills` a
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
        """Do nothing: the channel takes frames again, and `poll` goes on."""

    def poll(self, now: int, send: Send) -> int | None:
        """Send the frames that are due; returns the latest time of the next call, None: when something happens."""
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
                # All samples came, and the reader has no room, or its acknowledgement was lost: hello asks for one.
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
                # All kept samples fit into one frame: their sizes need not be added up.
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
        """Disconnect this end, and tell the other one. Samples sent and not acknowledged are of unknown fate, the rest
        is dropped as disconnected."""
        if self._ended:
            return
        self._ended = True
        if self._up:
            send(frames.bye(self.number), ())
        self._greeted = False
        self._give_up("unknown_fate", self._highest)
        self._give_up("disconnected", self._next - 1)
