"""Two ends of a link in virtual time, with pipes between them that lose, double, reorder and delay."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from random import Random
from typing import Any

from aiorts.model.links import SOLE, ReaderEnd, WriterEnd, join

MS = 1_000_000


class Pair:
    """A writer's end and a reader's end, and what a user would see of them."""

    def __init__(
        self,
        seed: int,
        *,
        loss: float = 0.0,
        double: float = 0.0,
        delay_ms: int = 1,
        jitter_ms: int = 0,
        window: int = 16,
        alone: float = 0.0,
    ) -> None:
        self.random = Random(seed)
        self.loss, self.double, self.delay_ms, self.jitter_ms = loss, double, delay_ms, jitter_ms
        self.window = window
        self.alone = alone
        """How often samples go the way of one that is alone, or of several together."""
        self.now = 1_000 * MS
        self.epochs = 1
        self.writer = WriterEnd(7, 1_000, window=window)
        self.reader = ReaderEnd(7, 2_000, window=window)
        self.ways: list[tuple[int, int, Any, bytes, Sequence[memoryview]]] = []
        self.count = 0
        self.up = False
        self.offered: list[int] = []
        """The samples that the writer's end took, in order."""
        self.fates: list[str] = []
        """What was said of them, in order."""
        self.seen: list[int] = []
        """What the reader got, in order, of the reader's end that there is now."""
        self.buffer = 10**9
        """How many more samples the reader has room for."""
        self.rejects = 0.0
        self.frames = 0

    def connect(self) -> None:
        self.up = True
        self.writer.channel_up(self.now, self.reader.epoch)
        self.reader.channel_up(self.now, self.writer.epoch)

    def cut(self) -> None:
        self.up = False
        self.ways.clear()
        self.writer.channel_down(self.now)
        self.reader.channel_down(self.now)

    def restart_reader(self) -> None:
        """The reader's kernel is started anew: its end forgets everything."""
        self.cut()
        self.settle()
        self.epochs += 1
        self.reader = ReaderEnd(7, 2_000 + self.epochs, window=self.window)

    def send(self, to: Any) -> Any:
        def send(head: bytes, parts: Sequence[memoryview]) -> bool:
            self.frames += 1
            for _ in range(1 + (self.random.random() < self.double)):
                if self.random.random() >= self.loss:
                    self.count += 1
                    delay = self.delay_ms * MS + self.random.randrange(self.jitter_ms * MS + 1)
                    heapq.heappush(self.ways, (self.now + delay, self.count, to, head, parts))
            return True

        return send

    def offer(self, value: int, *, confirm: bool = False) -> bool:
        if self.writer.room <= 0:
            return False
        sample = value.to_bytes(4, "little")
        if self.random.random() < self.alone and self.writer.takes_alone:
            self.writer.send_alone(self.now, sample, confirm, self.send(self.writer))
        else:
            self.writer.offer(self.now, sample, confirm=confirm)
        self.offered.append(value)
        return True

    def offer_all(self, value: int, count: int, *, confirm: bool = False) -> int:
        """Offer so many values from this one on, together; how many there was room for."""
        values = range(value, value + min(count, max(self.writer.room_for_all, 0)))
        self.writer.offer_all([each.to_bytes(4, "little") for each in values], confirm=confirm)
        self.offered.extend(values)
        return len(values)

    def settle(self) -> None:
        for first, last, what in self.writer.fates():
            self.fates += [what] * (last - first + 1)

    def step(self, until: int) -> None:
        """Let everything happen up to this time."""
        while True:
            self.deliver()
            wakes = [end.poll(self.now, self.send(end)) for end in (self.writer, self.reader)]
            due = [when for when in wakes if when is not None and self.up]
            if self.ways:
                due.append(self.ways[0][0])
            if not due or min(due) > until:
                self.now = max(self.now, until)
                return
            self.now = max(self.now + 1, min(due))
            while self.ways and self.ways[0][0] <= self.now:
                _, _, sender, head, parts = heapq.heappop(self.ways)
                if sender is self.writer:
                    self.receive(head, parts)
                else:
                    self.writer.receive(self.now, head)
            self.settle()

    def receive(self, head: bytes, parts: Sequence[memoryview]) -> None:
        """Give a frame to the reader's end, as either way into it would."""
        ticket = 0
        if self.buffer > 0 and not parts and self.random.random() < self.alone:
            ticket = self.reader.receive_alone(self.now, head)
        if not ticket:
            self.reader.receive(self.now, head, parts)
        elif self.random.random() < self.rejects:
            self.reader.failed(self.now, ticket, "rejected")
        else:
            self.buffer -= 1
            self.seen.append(int.from_bytes(head[SOLE:], "little"))
            self.reader.done_alone(self.now)

    def deliver(self) -> None:
        if self.random.random() < self.alone:
            self.deliver_all()
        last = taken = 0
        while self.buffer > 0 and (sample := self.reader.take()) is not None:
            ticket, head, _ = sample
            if self.random.random() < self.rejects:
                self.reader.done(self.now, last, taken)
                self.reader.failed(self.now, ticket, "rejected")
                taken = 0
            else:
                self.buffer -= 1
                self.seen.append(int.from_bytes(head, "little"))
                last, taken = ticket, taken + 1
        self.reader.done(self.now, last, taken)

    def deliver_all(self) -> None:
        """Give out several samples together: those of one frame, or of several, up to any of them."""
        heads = self.reader.heads(min(self.buffer, 1 + self.random.randrange(2 * self.window)))
        if heads:
            self.buffer -= len(heads)
            self.seen += [int.from_bytes(head, "little") for head in heads]
            self.reader.done(self.now, self.reader.take_all(len(heads)), len(heads))

    @property
    def unexplained(self) -> int:
        return join(self.writer.ledger, self.reader.ledger).unexplained
