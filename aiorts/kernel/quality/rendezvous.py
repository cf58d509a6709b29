"""Rendezvous (`length = 0`): a write is done when the reader has taken its sample.

A write that waits lies in the reader's queue as an unread sample does, so that readers find it in the order of arrival.
Its sample counts as written once it is taken, or lost; `waiting` has one entry for each sample in the queue. One that
`write_nowait` gave to a read that waits is written already; it stays unread where that read is cancelled meanwhile.
"""

from __future__ import annotations

import asyncio
from bisect import bisect_left
from collections import deque
from itertools import count, islice
from typing import Any, Final

from aiorts.kernel.ports.current import at_current
from aiorts.kernel.ports.features import FeaturedTransport
from aiorts.kernel.ports.port import OFF
from aiorts.kernel.ports.transport import Transport, Waiting
from aiorts.kernel.ports.waiting import Looking
from aiorts.late import dataclass

_turns: Final = count()


@dataclass(eq=False, slots=True)
class _Offered(Waiting):
    """A sample whose write waits for the reader; `done`: its write waits no more, and the sample is still unread."""

    arrived_at: int = 0
    """The sample's `Transport.arrived_at`."""
    turn: int = 0
    """The entry's number in the order of arrival, by which it is found fast among thousands that give up at once."""


class Rendezvous(FeaturedTransport):
    """A transport without a buffer: the reader takes each sample from a write that waits. See `Transport`."""

    __slots__ = ()
    waiting: Any
    """A deque of entries in the order of their samples in the queue, `done` entries first; None before the first."""

    @property
    def buffered(self) -> int:
        return bisect_left(self.waiting or (), True, key=lambda entry: not entry.done)

    @property
    def position(self) -> int:
        return self.total() + len(self.waiting or ()) - self.buffered

    @property
    def is_awaited(self) -> bool:
        receiver = self.receiver
        waiter = receiver.waiter
        return waiter is not None and not waiter.done() and not isinstance(waiter, Looking) and not receiver.unread()

    def queue_up(self, sample: Any, future: asyncio.Future[None] | None) -> Waiting:
        return self._hold_out(_Offered(self.connector, self.stamp_in(sample), future))

    def store_bounded(self, sample: Any) -> bool:
        if self.retired and not self.is_awaited:
            return super().store_bounded(sample)
        self._hold_out(_Offered(self.connector, self.stamp_in(sample), None, done=True))
        return True

    def _hold_out(self, entry: _Offered) -> Waiting:
        if self.waiting is None:
            self.waiting = deque()
        entry.turn = next(_turns)
        self.waiting.append(entry)
        self.connector.in_._fast = OFF
        self.push_in(entry.sample)
        entry.arrived_at = self.arrived_at
        return entry

    @at_current
    def give_up(self, entry: Waiting) -> bool:
        waiting = self.waiting
        if entry.done or not waiting or not isinstance(entry, _Offered):
            return False
        place = bisect_left(waiting, entry.turn, key=lambda one: one.turn)
        if place == len(waiting) or waiting[place] is not entry:
            return False
        del waiting[place]
        self.take_out(place)
        tokens = self.receiver.tokens
        if tokens is not None:
            mine = (index for index, token in enumerate(tokens) if token is self)
            del tokens[next(islice(mine, place, None))]
        if waiting:
            self.arrived_at = waiting[-1].arrived_at
        else:
            self.connector.in_._fast = self.receiver.direct
        return True

    def admit_waiting(self) -> None:
        """Let the writers of samples that have left the queue go on."""
        waiting = self.waiting
        if not waiting:
            return
        while len(waiting) > len(self.queue):
            entry = waiting.popleft()
            if not entry.done:
                self.written += 1
                self.resolve(entry)
        if not waiting:
            self.connector.in_._fast = self.receiver.direct
        self.receiver.room_made()

    def admit_all(self) -> None:
        """Let all waiting writers go on; their samples stay unread."""
        for entry in self.waiting or ():
            if not entry.done:
                self.written += 1
                self.resolve(entry)
        self.receiver.room_made()

    def carry_on(self, old: Transport) -> None:
        super().carry_on(old)
        self.waiting = deque(_Offered(self.connector, sample, None, done=True) for sample in self.queue)

    def discard_all(self, reason: str) -> None:
        """Empty the queue; count only `done` samples as dropped: others are counted when their writers go on."""
        waiting = self.waiting
        while waiting and waiting[0].done:
            waiting.popleft()
            self.drop(reason)
        self.queue.clear()
