"""What connectors with a lifespan must do, in plain lists: the reference of the property tests."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

LIFESPANS_NS = (450_100_000, 450_170_000)
TIMEOUT_NS = 620_300_000
"""None is a sum of others: no two things are due at one moment."""
RATE = 3


@dataclass(eq=False)
class Entry:
    """A sample that is buffered, or whose writer waits for room."""

    sample: int
    ns: int
    """When it was written; of one that waits, when its writer gives up."""
    place: int = 0
    """In the order of arrival at the reader."""


@dataclass(eq=False)
class ModelConnector:
    """One connector: `kind` is flush, new, pull, or periodic with its push policy."""

    kind: str
    full: str
    length: int
    lifespan_ns: int | None
    start_ns: int
    """When it was made: its periods count from there."""
    out_length: int
    queue: list[Entry] = field(default_factory=list)
    backlog: list[Entry] = field(default_factory=list)
    waiting: list[Entry] = field(default_factory=list)
    written: int = 0
    delivered: int = 0
    dropped: Counter[str] = field(default_factory=Counter)

    @property
    def counts(self) -> tuple[int, int, int, dict[str, int]]:
        """Written, delivered, buffered, dropped."""
        return self.written, self.delivered, len(self.queue) + len(self.backlog), dict(self.dropped)

    @property
    def periodic(self) -> bool:
        return self.kind.startswith("periodic")

    def period_end(self, number: int) -> int:
        return self.start_ns - (-number * 10**9 // RATE)

    @property
    def replaces(self) -> bool:
        return self.kind in ("new", "pull")


class Model:
    """One in-port with its connectors."""

    def __init__(self, connectors: list[ModelConnector]) -> None:
        self.connectors = connectors
        self.now = 0
        self.latest: int | None = None
        self.is_open = True
        self._places = 0

    # -- time ------------------------------------------------------------------------------------------------------

    def advance(self, ns: int) -> None:
        """Let time come to this moment: what is due happens in order."""
        while (due := min((when for one in self.connectors for when in self._due(one)), default=ns + 1)) <= ns:
            self.now = due
            for one in self.connectors:
                self._happen(one)
        self.now = ns
        for one in self.connectors:
            self._settle(one)

    def _due(self, one: ModelConnector) -> list[int]:
        due = [entry.ns for entry in one.waiting]
        if one.waiting and one.lifespan_ns is not None:
            due.append(one.queue[0].ns + one.lifespan_ns)
        if one.backlog:
            due.append(one.period_end(1 + (self.now - one.start_ns) * RATE // 10**9))
        return due

    def _happen(self, one: ModelConnector) -> None:
        self._settle(one)
        for entry in [entry for entry in one.waiting if entry.ns <= self.now]:
            one.waiting.remove(entry)
            one.written += 1
            one.dropped["timeout"] += 1
        if one.backlog and self.now == one.period_end((self.now - one.start_ns) * RATE // 10**9):
            self._send(one)

    def _send(self, one: ModelConnector) -> None:
        if one.kind == "periodic new":
            one.dropped["superseded"] += len(one.backlog) - 1
            del one.backlog[:-1]
        count = 1 if one.kind == "periodic fifo" else len(one.backlog)
        for _ in range(count):
            if one.full == "block" and len(one.queue) >= one.length:
                return
            self._store(one, one.backlog.pop(0))

    def _settle(self, one: ModelConnector) -> None:
        if one.lifespan_ns is None:
            return
        for held in (one.queue, one.backlog):
            while held and held[0].ns + one.lifespan_ns <= self.now:
                held.pop(0)
                one.dropped["expired"] += 1
        self._admit(one)

    # -- writing ---------------------------------------------------------------------------------------------------

    def write(self, one: ModelConnector, sample: int, *, waits: bool) -> bool | None:
        """What `write_nowait` returns; None for WouldBlock, or for a writer that waits from now on."""
        self._settle(one)
        blocks = one.full == "block" and not one.periodic and not one.replaces and self.is_open
        if blocks and (one.waiting or len(one.queue) >= one.length):
            if waits:
                one.waiting.append(Entry(sample, self.now + TIMEOUT_NS))
            return None
        one.written += 1
        entry = Entry(sample, self.now)
        if not self.is_open:
            one.dropped["inactive"] += 1
            return True
        if one.periodic:
            if len(one.backlog) >= one.out_length:
                if one.full == "reject":
                    one.dropped["rejected"] += 1
                    return False
                one.backlog.pop(0)
                one.dropped["overwritten"] += 1
            one.backlog.append(entry)
            return True
        if one.replaces:
            one.dropped["superseded"] += len(one.queue)
            one.queue.clear()
        return self._store(one, entry)

    def _store(self, one: ModelConnector, entry: Entry) -> bool:
        if len(one.queue) >= one.length:
            if one.full == "reject":
                one.dropped["rejected"] += 1
                return False
            one.queue.pop(0)
            one.dropped["overwritten"] += 1
        self._append(one, entry)
        return True

    def _append(self, one: ModelConnector, entry: Entry) -> None:
        self._places += 1
        entry.place = self._places
        one.queue.append(entry)

    def _admit(self, one: ModelConnector) -> None:
        while one.waiting and len(one.queue) < one.length:
            one.written += 1
            self._store(one, Entry(one.waiting.pop(0).sample, self.now))

    def change(self, one: ModelConnector, length: int, full: str) -> None:
        """Waiting writers go on as far as there is room; where nobody waits any more, all of them."""
        self._settle(one)
        one.length, one.full = length, full
        waiting = len(one.waiting) if full != "block" else max(0, length - len(one.queue))
        for entry in one.waiting[:waiting]:
            one.written += 1
            self._append(one, Entry(entry.sample, self.now))
        del one.waiting[:waiting]

    def cancel(self, one: ModelConnector, sample: int) -> None:
        """The writer of this sample waits no more."""
        one.waiting = [entry for entry in one.waiting if entry.sample != sample]

    # -- reading ---------------------------------------------------------------------------------------------------

    @property
    def unread(self) -> list[tuple[int, ModelConnector]]:
        """By place, the oldest first."""
        return sorted(
            ((entry.place, one) for one in self.connectors for entry in one.queue), key=lambda found: found[0]
        )

    def peek(self) -> int | None:
        return self.unread[0][1].queue[0].sample if self.unread else None

    def read(self) -> int | None:
        """The oldest sample, taken; None for WouldBlock."""
        if not self.unread:
            return None
        one = self.unread[0][1]
        sample = one.queue.pop(0).sample
        one.delivered += 1
        self._admit(one)
        self.latest = sample
        return sample

    def drain(self) -> list[int]:
        samples = []
        while (sample := self.read()) is not None:
            samples.append(sample)
        return samples

    def read_newest(self) -> int | None:
        if self.unread:
            newest = self.unread[-1][1]
            self.latest = newest.queue.pop().sample
            newest.delivered += 1
            for one in (newest, *(one for one in self.connectors if one is not newest)):
                one.dropped["superseded"] += len(one.queue)
                one.queue.clear()
                self._admit(one)
        return self.latest

    def set_open(self, is_open: bool) -> None:
        self.is_open = is_open
        for one in self.connectors:
            one.dropped["inactive"] += len(one.queue) + len(one.backlog) + len(one.waiting)
            one.written += len(one.waiting)
            one.queue, one.backlog, one.waiting = [], [], []
        if is_open:
            self.latest = None
