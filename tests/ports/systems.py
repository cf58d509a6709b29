"""A reference model of whole systems of ports: several writers, several readers, who waits and what it gets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Push, Subscription, admits
from ports.parts import Model, ModelConnector

__all__ = ("Link", "Write", "World")


@dataclass(eq=False)
class Write:
    """An awaited write: where it still waits, and what it will give."""

    sample: int
    result: bool = True
    links: list[Link] = field(default_factory=list)
    late: bool = False
    """Whether a connector had no room in time."""
    written: bool = False
    """Whether a connector has it, or there was none."""

    @property
    def outcome(self) -> bool | str:
        return "late" if self.late else self.result


@dataclass(eq=False)
class Link:
    """One connector of the world, and who waits for room in it, with the moment each gives up."""

    source: int
    sink: int
    model: ModelConnector
    waiting: list[tuple[int | None, Write]] = field(default_factory=list)


class World:
    """What a system of out-ports and in-ports must do, said with the models of its parts."""

    def __init__(self, sinks: int) -> None:
        self.sinks = [Model() for _ in range(sinks)]
        self.links: list[Link] = []
        self.written: dict[int, list[tuple[int, Write | None]]] = {}
        """By source what was written, in order, and what waits for room or did."""
        self.reads: list[list[int] | None] = [None] * sinks
        """For each sink None, or what its awaited read got: nothing yet, or one sample."""

    def of_source(self, source: int) -> list[Link]:
        return [link for link in self.links if link.source == source]

    def last(self, source: int) -> int | None:
        """The sample written last; one whose write waits counts, one that was cancelled everywhere does not."""
        for sample, write in reversed(self.written.get(source, [])):
            if write is None or write.written or write.links:
                return sample
        return None

    def offer_last(self, link: Link) -> None:
        if (sample := self.last(link.source)) is not None:
            self.sinks[link.sink].offer_last(link.model, sample)

    def of_sink(self, sink: int) -> list[Link]:
        return [link for link in self.links if link.sink == sink]

    def must_wait(self, link: Link) -> bool:
        model = link.model
        if not self.sinks[link.sink].is_open or model.subscription is Subscription.PERIODIC:
            return False
        if model.ledger.full is not FullPolicy.BLOCK or model.push is Push.NEW:
            return False
        if not admits(model.push, model.skip, model.ledger.written + 1 - model.offered):
            return False
        return bool(link.waiting) or len(model.ledger.samples) >= model.ledger.length

    def write_nowait(self, source: int, sample: int) -> bool | None:
        """What `write_nowait` returns; None for WouldBlock."""
        links = self.of_source(source)
        if any(self.must_wait(link) for link in links):
            return None
        self.written.setdefault(source, []).append((sample, None))
        results = [self.sinks[link.sink].write(link.model, sample) for link in links]
        return all(results)

    def write(self, source: int, sample: int, give_up_ns: dict[Link, int | None]) -> Write:
        """Begin an awaited write; it is over when it waits nowhere."""
        write = Write(sample)
        for link in self.of_source(source):
            if self.must_wait(link):
                link.waiting.append((give_up_ns[link], write))
                write.links.append(link)
            else:
                write.result &= bool(self.sinks[link.sink].write(link.model, sample))
        write.written = len(write.links) < len(self.of_source(source)) or not write.links
        self.written.setdefault(source, []).append((sample, write))
        return write

    def cancel(self, write: Write) -> None:
        for link in write.links:
            link.waiting = [entry for entry in link.waiting if entry[1] is not write]
        write.links.clear()

    def admit(self, link: Link) -> None:
        """Move in who waits, as far as there is room."""
        model, ledger = link.model, link.model.ledger
        while link.waiting:
            sent = admits(model.push, model.skip, ledger.written + 1 - model.offered)
            if sent and len(ledger.samples) >= ledger.length:
                return
            _, write = link.waiting.pop(0)
            write.written = True
            write.links.remove(link)
            self.sinks[link.sink].write(model, write.sample)

    def read(self, sink: int) -> int | None:
        model = self.sinks[sink]
        first = next(iter(model.order), None)
        sample = model.read()
        for link in self.of_sink(sink):
            if link.model is first:
                self.admit(link)
        return sample

    def latest(self, sink: int) -> int | None:
        model = self.sinks[sink]
        links = self.of_sink(sink)
        source = model.newest()
        if source is not None:
            newest = next(link for link in links if link.model is source)
            model.last, model.source = source.ledger.take_newest(), source
            for link in (newest, *(link for link in links if link is not newest)):
                link.model.ledger.discard("superseded")
                self.admit(link)
        return model.last

    def drain(self, sink: int) -> list[int]:
        taken = []
        while (sample := self.read(sink)) is not None:
            taken.append(sample)
        return taken

    def settle(self) -> None:
        """Give each awaited read what there is for it."""
        for sink, got in enumerate(self.reads):
            if got == [] and (sample := self.read(sink)) is not None:
                got.append(sample)

    def end(self, link: Link, reason: str) -> None:
        for _, write in link.waiting:
            link.model.ledger.written += 1
            link.model.ledger.drop(reason)
            write.written = True
            write.links.remove(link)
        link.waiting.clear()

    def disconnect(self, link: Link) -> None:
        self.links.remove(link)
        self.sinks[link.sink].disconnect(link.model)
        self.end(link, "disconnected")

    def set_open(self, sink: int, is_open: bool) -> None:
        self.sinks[sink].set_open(is_open)
        for link in self.of_sink(sink):
            self.end(link, "inactive")
        for link in self.of_sink(sink):
            self.offer_last(link)

    def advance(self, from_ns: int, to_ns: int) -> None:
        """Let every period and every time-out in (from, to] be over, in order; reads happen as samples come."""
        due: list[tuple[int, Any, Link]] = []
        for link in self.links:
            due += [(at, write, link) for at, write in link.waiting if at is not None and from_ns < at <= to_ns]
            if link.model.subscription is Subscription.PERIODIC:
                rate = link.model.options["push_rate"]
                number = (from_ns - link.model.start_ns) * rate // 1_000_000_000 + 1
                while (moment := link.model.start_ns + -(-number * 1_000_000_000 // rate)) <= to_ns:
                    if moment > from_ns:
                        due.append((moment, None, link))
                    number += 1
        for _, write, link in sorted(due, key=lambda entry: entry[0]):
            if write is None:
                self.sinks[link.sink].period_over(link.model)
            elif link in write.links:
                link.waiting = [entry for entry in link.waiting if entry[1] is not write]
                write.links.remove(link)
                write.late = write.written = True
                link.model.ledger.written += 1
                link.model.ledger.drop("timeout")
            self.settle()
