"""Random writers, readers, cancels, time-outs, activations and connections leave exactly what a small model leaves."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from anyio import WouldBlock

from aiorts import Component, Connector, ExternalContext, InPort, Kernel, OutPort, SimulatedClock, ThreadContext
from aiorts.errors import WriteTimeout
from aiorts.kernel.ports.connector import unread_of
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.testing import simulate
from aiorts.types import TimedLong
from campaign import CAMPAIGN, cases

SOURCES = 3
SINKS = 2
STEPS = 60


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


# -- the model ---------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Link:
    """A connector: of length 0, or one that overwrites."""

    source: int
    sink: int
    length: int
    written: int = 0
    delivered: int = 0
    dropped: Counter[str] = field(default_factory=Counter)


@dataclass(eq=False)
class Write:
    """An awaited write, and where it still waits with the moment it gives up."""

    links: dict[Link, int | None] = field(default_factory=dict)
    late: bool = False
    taken_and_cancelled: bool = False


@dataclass(eq=False)
class Item:
    """An unread sample, counted as written already unless a write holds it."""

    link: Link
    sample: int
    write: Write | None = None


class Model:
    """One line of unread samples for each sink, in the order of arrival."""

    def __init__(self) -> None:
        self.links: list[Link] = []
        self.lines: list[list[Item]] = [[] for _ in range(SINKS)]
        self.open = [True] * SINKS
        self.last: list[int | None] = [None] * SINKS
        self.reading: list[list[int] | None] = [None] * SINKS
        """None, or what an awaited read got."""

    def write(self, source: int, sample: int, gives_up: Callable[[Link], int | None]) -> Write:
        write = Write()
        for link in self.of(source):
            if self.open[link.sink] and not link.length:
                self.lines[link.sink].append(Item(link, sample, write))
                write.links[link] = gives_up(link)
            else:
                self.put(link, sample)
        return write

    def write_nowait(self, source: int, sample: int) -> bool:
        """False: it would block."""
        for link in self.of(source):
            if not link.length and self.open[link.sink] and (self.reading[link.sink] != [] or self.lines[link.sink]):
                return False
        for link in self.of(source):
            self.put(link, sample)
        return True

    def of(self, source: int) -> list[Link]:
        return [link for link in self.links if link.source == source]

    def put(self, link: Link, sample: int) -> None:
        link.written += 1
        if not self.open[link.sink]:
            link.dropped["inactive"] += 1
            return
        line = self.lines[link.sink]
        mine = [item for item in line if item.link is link]
        if link.length and len(mine) == link.length:
            line.remove(mine[0])
            link.dropped["overwritten"] += 1
        line.append(Item(link, sample))

    def leave(self, item: Item, reason: str = "") -> None:
        """It was taken, or dropped for this reason."""
        self.lines[item.link.sink].remove(item)
        if item.write is not None:
            item.link.written += 1
            del item.write.links[item.link]
        if reason:
            item.link.dropped[reason] += 1
        else:
            item.link.delivered += 1
            self.last[item.link.sink] = item.sample

    def read(self, sink: int) -> int | None:
        if not self.lines[sink]:
            return None
        self.leave(self.lines[sink][0])
        return self.last[sink]

    def latest(self, sink: int) -> int | None:
        if self.lines[sink]:
            self.leave(self.lines[sink][-1])
            for item in tuple(self.lines[sink]):
                self.leave(item, "superseded")
        return self.last[sink]

    def settle(self) -> None:
        for sink, got in enumerate(self.reading):
            if got == [] and (sample := self.read(sink)) is not None:
                got.append(sample)

    def cancel(self, write: Write) -> None:
        for link in tuple(write.links):
            self.lines[link.sink] = [item for item in self.lines[link.sink] if item.write is not write]
        write.links.clear()

    def set_open(self, sink: int, is_open: bool) -> None:
        for item in tuple(self.lines[sink]):
            self.leave(item, "inactive")
        self.open[sink] = is_open
        if is_open:
            self.last[sink] = None

    def disconnect(self, link: Link) -> None:
        for item in tuple(self.lines[link.sink]):
            if item.link is link:
                self.leave(item, "disconnected")
        self.links.remove(link)

    def pass_time(self, now_ns: int) -> None:
        for line in self.lines:
            for item in tuple(line):
                write = item.write
                if write is not None and (at := write.links[item.link]) is not None and at <= now_ns:
                    self.leave(item, "timeout")
                    write.late = True


# -- side by side ------------------------------------------------------------------------------------------------------


class System:
    """One random system, played on live ports and on the model."""

    def __init__(self, number: int, hits: Counter[str], *, threads: bool = False, **kernel_options: Any) -> None:
        self.threads = threads
        self.kernel_options = kernel_options
        self.random = random.Random(number)
        self.hits = hits
        self.model = Model()
        self.live: dict[Link, Connector] = {}
        self.all: list[tuple[Connector, Link]] = []
        self.writes: list[tuple[asyncio.Task[bool], Write]] = []
        self.reads: list[asyncio.Task[TimedLong] | None] = [None] * SINKS
        self.removers: list[Callable[[], None]] = []
        self.written = 0

    async def play(self, clock: SimulatedClock) -> None:
        self.clock = clock
        async with Kernel(**self.kernel_options) as kernel:
            self.kernel = kernel
            self.sources = [await kernel.add(Source(f"source{number}")) for number in range(SOURCES)]
            self.sinks = [await kernel.add(Sink(f"sink{number}")) for number in range(SINKS)]
            self.contexts = [await kernel.start(ExternalContext(), sink, activate=True) for sink in self.sinks]
            if self.threads:
                await self.connect_a_thread()
            for _ in range(self.random.choice((1, 3, 5))):
                await self.connect()
            table = {
                self.write: 30,
                self.write_nowait: 12,
                self.read_nowait: 16,
                self.read: 12,
                self.latest: 8,
                self.drain: 3,
                self.pass_time: 8,
                self.cancel_write: 6,
                self.cancel_read: 4,
                self.cancel_at_once: 8,
                self.connect: 4,
                self.disconnect: 3,
                self.activate: 3,
                self.listen: 3,
            }
            for step in self.random.choices(list(table), list(table.values()), k=STEPS):
                await step()
                for _ in range(20 if self.threads else 6):
                    await asyncio.sleep(0)
                self.model.settle()
                self.compare(step.__name__)
                self.hits[step.__name__] += 1
            for task in (*(task for task, _ in self.writes), *filter(None, self.reads)):
                task.cancel()

    def compare(self, step: str) -> None:
        for connector, link in self.all:
            ledger = connector.statistics
            unread = [item for item in self.model.lines[link.sink] if item.link is link]
            buffered = sum(item.write is None for item in unread)
            expected = (link.written, link.delivered, buffered, dict(link.dropped))
            assert (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)) == expected, (step, link)
            assert ledger.balanced
            assert unread_of(connector) == len(unread), step
            for reason, count in ledger.dropped.items():
                self.hits[reason] += not link.length and count
        for number, sink in enumerate(self.sinks):
            line = self.model.lines[number]
            assert sink.inp.is_new == bool(line), step
            assert sink.inp.peek() == (long(line[0].sample) if line else None), step
            task, got = self.reads[number], self.model.reading[number]
            if task is not None and got is not None:
                assert task.done() == bool(got), step
                if task.done():
                    assert task.result() == long(got[0]), step
                    self.reads[number] = self.model.reading[number] = None
                    self.hits["read waited"] += 1
        for task, write in tuple(self.writes):
            assert task.done() == (not write.links), step
            if task.done():
                self.writes.remove((task, write))
                assert task.cancelled() == write.taken_and_cancelled, step
                if not task.cancelled():
                    assert isinstance(task.exception(), WriteTimeout) == write.late, step
                    self.hits["write timed out" if write.late else "write waited"] += 1

    def next(self) -> TimedLong:
        self.written += 1
        return long(self.written)

    async def write(self) -> None:
        await self.pass_time(0.000_1)
        now_ns = self.clock.monotonic_ns()

        def gives_up(link: Link) -> int | None:
            timeout = self.live[link].profile.timeout
            return None if timeout is None else now_ns + round(timeout * 1e9)

        number, sample = self.random.randrange(SOURCES), self.next()
        write = self.model.write(number, sample.data, gives_up)
        self.writes.append((asyncio.ensure_future(self.sources[number].out.write(sample)), write))

    async def write_nowait(self) -> None:
        for _ in range(self.random.choice((1, 1, 2))):
            number, sample = self.random.randrange(SOURCES), self.next()
            expected = self.model.write_nowait(number, sample.data)
            try:
                done = self.sources[number].out.write_nowait(sample)
            except WouldBlock:
                done = False
            assert done is expected

    async def read_nowait(self) -> None:
        number = self.random.randrange(SINKS)
        expected = self.model.read(number)
        try:
            got: int | None = self.sinks[number].inp.read_nowait().data
        except WouldBlock:
            got = None
        assert got == expected

    async def read(self) -> None:
        await self.begin_read(self.random.randrange(SINKS))

    async def begin_read(self, number: int) -> None:
        """Begin a read that waits, unless there is one."""
        if self.reads[number] is None:
            self.reads[number] = asyncio.ensure_future(self.sinks[number].inp.read())
            self.model.reading[number] = []
            for _ in range(4):
                await asyncio.sleep(0)

    async def latest(self) -> None:
        number = self.random.randrange(SINKS)
        sample = self.sinks[number].inp.latest
        assert (None if sample is None else sample.data) == self.model.latest(number)

    async def drain(self) -> None:
        number = self.random.randrange(SINKS)
        taken = []
        while (sample := self.model.read(number)) is not None:
            taken.append(sample)
        assert [sample.data for sample in self.sinks[number].inp.drain()] == taken

    async def pass_time(self, seconds: float = 0.0) -> None:
        await self.kernel.sleep(seconds or self.random.choice((0.01, 0.07, 0.25)))
        self.model.pass_time(self.clock.monotonic_ns())

    async def cancel_write(self) -> None:
        if self.writes:
            task, write = self.writes.pop(self.random.choice((-1, self.random.randrange(len(self.writes)))))
            task.cancel()
            self.model.cancel(write)

    async def cancel_read(self) -> None:
        self.cancel_now(self.random.randrange(SINKS))

    def cancel_now(self, number: int) -> None:
        if (task := self.reads[number]) is not None:
            task.cancel()
            self.reads[number] = self.model.reading[number] = None

    async def cancel_at_once(self) -> None:
        """A write whose sample was just taken; a read that was just given one."""
        number = self.random.randrange(SINKS)
        line = self.model.lines[number]
        if line and (write := line[0].write) is not None and len(write.links) == 1:
            await self.read_at(number)
            task = next(task for task, other in self.writes if other is write)
            task.cancel()
            write.taken_and_cancelled = True
            self.hits["taken and cancelled"] += 1
        elif not line:
            await self.begin_read(number)
            await self.write_nowait()
            self.cancel_now(number)
            self.hits["given and cancelled"] += bool(line)

    async def read_at(self, number: int) -> None:
        assert self.sinks[number].inp.read_nowait().data == self.model.read(number)

    async def connect(self) -> None:
        source, sink = self.random.randrange(SOURCES), self.random.randrange(SINKS)
        length, timeout = self.random.choice((0, 0, 0, 1, 3)), self.random.choice((None, None, 0.03, 0.2))
        options: dict[str, Any] = {"length": length, "timeout": timeout, "allow_duplicate": True}
        if length and self.random.random() < 0.3:
            options["lifespan"] = 1e6  # whose reader is of another class
        connector = await self.kernel.connect(self.sources[source].out, self.sinks[sink].inp, **options)
        link = Link(source, sink, length)
        self.model.links.append(link)
        self.live[link] = connector
        self.all.append((connector, link))

    async def connect_a_thread(self) -> None:
        """One that writes nothing: from now on whatever is at these ports takes their locks."""
        other = await self.kernel.add(Source("other"))
        await self.kernel.start(ThreadContext(rate=0.001), other)
        for sink in self.sinks:
            await self.kernel.connect(other.out, sink.inp)
            assert receiver_of(sink.inp).lock is not None

    async def disconnect(self) -> None:
        if self.live:
            link = self.random.choice(list(self.live))
            await self.kernel.disconnect(self.live.pop(link))
            self.model.disconnect(link)

    async def activate(self) -> None:
        number = self.random.randrange(SINKS)
        sink, context, is_open = self.sinks[number], self.contexts[number], self.model.open[number]
        await (context.deactivate(sink) if is_open else context.activate(sink))
        self.model.set_open(number, not is_open)

    async def listen(self) -> None:
        """Listeners come and go: the transport is replaced with the writes that wait in it."""
        if self.removers and self.random.random() < 0.5:
            self.removers.pop()()
        elif self.live:
            self.removers.append(self.kernel.listen(self.random.choice(list(self.live.values())), lambda event: None))


def long(number: int) -> TimedLong:
    return TimedLong(0, number)


@pytest.mark.slow(kept_by="quality/test_rendezvous_neighbours.py::test_in_debug_mode_it_is_the_same")
@pytest.mark.row(38)
@pytest.mark.campaign
@pytest.mark.parametrize("options", [{"threads": True}, {"debug": True}], ids=["threads", "debug"])
def test_nor_do_locks_or_checks_change_anything(options: dict[str, Any]) -> None:
    hits: Counter[str] = Counter()
    for number in range(cases(500)):
        simulate(System(number, hits, **options).play, seed=number)


PARTS = 10 if CAMPAIGN else 1


@pytest.mark.slow(kept_by="quality/test_rendezvous.py::test_a_write_that_waits_is_unread_data")
@pytest.mark.row(38)
@pytest.mark.campaign
@pytest.mark.parametrize("part", range(PARTS))
def test_random_systems_do_what_the_model_does(part: int) -> None:
    hits: Counter[str] = Counter()
    size = cases(2_500) // PARTS
    for number in range(part * size, (part + 1) * size):
        simulate(System(number, hits).play, seed=number)
    for what in ("timeout", "superseded", "inactive", "disconnected"):
        assert hits[what] > 10, (what, hits)
    for what in ("read waited", "write waited", "write timed out", "taken and cancelled", "given and cancelled"):
        assert hits[what] > 5, (what, hits)
