"""SCAFFOLD of the protocol, to be replaced."""
from __future__ import annotations
from collections import deque
from dataclasses import dataclass
from collections.abc import Callable, Sequence
from typing import Any
import msgpack
Buffer = bytes | bytearray | memoryview

@dataclass
class WriterLedger:
    written: int = 0
    acknowledged: int = 0
    rejected: int = 0
    in_flight: int = 0
    unknown_fate: int = 0
    sent_again: int = 0

class WriterEnd:
    def __init__(self, number: int, epoch: int, *, window: int = 256, window_bytes: int = 8 << 20) -> None:
        self.number, self.epoch, self.window = number, epoch, window
        self.next, self.base, self.sent = 1, 1, 0
        self.kept: deque[Any] = deque()
        self.peer_epoch = 0
        self.up = False
        self.peer_ended = False
        self._fates: list[tuple[int, int, str]] = []
        self.ledger = WriterLedger()
    def renumber(self, number: int) -> None:
        self.number = number
    def channel_up(self, now: int, peer_epoch: int) -> None:
        if self.peer_epoch and peer_epoch != self.peer_epoch:
            if self.kept:
                self._fates.append((self.base, self.next - 1, "unknown_fate"))
                self.kept.clear()
            self.next = self.base = 1
        self.peer_epoch, self.up, self.sent = peer_epoch, True, self.base - 1
        self.ledger.in_flight = len(self.kept)
    def channel_down(self, now: int) -> None:
        self.up = False
    @property
    def room(self) -> int:
        return self.window - len(self.kept) if self.up else 0
    def offer(self, now: int, head: bytes, parts: Sequence[memoryview] = (), *, written_ns: int | None = None, confirm: bool = False) -> int:
        self.kept.append((self.next, head, tuple(parts), confirm))
        self.next += 1
        self.ledger.in_flight = len(self.kept)
        return self.next - 1
    def withdraw(self, number: int) -> bool:
        return False
    def receive(self, now: int, head: Buffer) -> None:
        kind, number, *rest = msgpack.unpackb(head)
        if number != self.number:
            return
        if kind == 2:
            self.peer_ended = True
        if kind == 1:
            for first, last, what in rest[0]:
                while self.kept and self.kept[0][0] <= last:
                    self.kept.popleft()
                self.base = max(self.base, last + 1)
                self._fates.append((first, last, what))
        self.ledger.in_flight = len(self.kept)
    def on_room(self, now: int) -> None: ...
    def poll(self, now: int, send: Callable[[bytes, Sequence[memoryview]], bool]) -> int | None:
        for number, head, parts, confirm in self.kept:
            if number > self.sent:
                if not send(msgpack.packb([0, self.number, number, head]), parts):
                    break
                self.sent = number
        return None
    def fates(self) -> list[tuple[int, int, str]]:
        found, self._fates = self._fates, []
        return found
    def end(self, now: int, send: Any) -> None:
        send(msgpack.packb([2, self.number]), ())
        if self.kept:
            self._fates.append((self.base, self.next - 1, "unknown_fate"))
            self.kept.clear()
        self.ledger.in_flight = 0

@dataclass
class Sample:
    number: int
    head: Buffer
    parts: Sequence[Buffer]
    age_ns: int | None = None

class ReaderEnd:
    def __init__(self, number: int, epoch: int, *, window: int = 256, window_bytes: int = 8 << 20) -> None:
        self.number, self.epoch = number, epoch
        self.peer_epoch = 0
        self.expected = 1
        self.held: deque[Sample] = deque()
        self.acks: list[Any] = []
        self.peer_ended = False
    def renumber(self, number: int) -> None:
        self.number = number
    def channel_up(self, now: int, peer_epoch: int) -> None:
        if peer_epoch != self.peer_epoch:
            self.expected = 1
            self.held.clear()
        self.peer_epoch = peer_epoch
    def channel_down(self, now: int) -> None: ...
    def on_room(self, now: int) -> None: ...
    def receive(self, now: int, head: Buffer, parts: Sequence[Buffer] = ()) -> None:
        kind, number, *rest = msgpack.unpackb(head)
        if number != self.number:
            return
        if kind == 2:
            self.peer_ended = True
        if kind == 0 and rest[0] == self.expected:
            self.expected += 1
            self.held.append(Sample(rest[0], rest[1], parts))
    def take(self) -> Sample | None:
        return self.held.popleft() if self.held else None
    def done(self, now: int, number: int, what: str = "") -> None:
        what = {"": "acknowledged", "rejected": "rejected"}.get(what, "dropped:" + what)
        self.acks.append((number, number, what))
    def poll(self, now: int, send: Any) -> int | None:
        if self.acks and send(msgpack.packb([1, self.number, self.acks]), ()):
            self.acks = []
        return None
    def end(self, now: int, send: Any) -> None:
        send(msgpack.packb([2, self.number]), ())
