"""Random systems of several out-ports and in-ports leave exactly what the reference model leaves, step by step.

What is on the fast path is counted: a test of a path that nobody takes would prove nothing.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from typing import Any

import pytest

from aiorts import Connector, ExternalContext, Kernel, SimulatedClock, WouldBlock
from aiorts.errors import PortTypeError, WriteTimeout
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.last_sample import last_written
from aiorts.kernel.ports.port import NOTHING
from aiorts.testing.simulation import simulate
from campaign import CAMPAIGN, ORDERS, cases
from ports.parts import ModelConnector, Sink, Source, long
from ports.systems import Link, World, Write
from ports.test_connector import COMBINATIONS

pytestmark = pytest.mark.slow(
    kept_by="ports/test_connector.py::test_survivors_and_ledger_are_those_of_the_reference_model_after_every_step"
)

SOURCES = 3
SINKS = 3
STEPS = 60
_PLAIN = [combination for combination in COMBINATIONS if combination[0] != "periodic" and combination[1] != "skip"]


class System:
    """One random system, played on live ports and on the model side by side."""

    keeps_last = True
    """Whether the model knows the sample that each writer wrote last."""

    def __init__(self, number: int, hits: Counter[str], **kernel_options: Any) -> None:
        self.random = random.Random(number)
        # Half of the systems have direct connectors alone: one that has to choose changes how all are written.
        self.combinations = COMBINATIONS if number % 2 else _PLAIN
        self.kernel_options = kernel_options
        self.options: dict[str, Any] = {}
        """Of the next connector, besides those that are chosen at random."""
        self.hits = hits
        self.world = World(SINKS)
        self.live: dict[Link, Connector] = {}
        self.all: list[tuple[Connector, Link]] = []
        self.writes: list[tuple[asyncio.Task[bool], Write]] = []
        self.reads: list[asyncio.Task[Any] | None] = [None] * SINKS
        self.written = 0

    async def play(self, clock: SimulatedClock) -> None:
        self.clock = clock
        async with Kernel(**self.kernel_options) as kernel:
            self.kernel = kernel
            self.sources = [await kernel.add(Source(f"source{i}")) for i in range(SOURCES)]
            self.sinks = [await kernel.add(Sink(f"sink{i}")) for i in range(SINKS)]
            self.contexts = [await kernel.start(ExternalContext(), sink, activate=True) for sink in self.sinks]
            for _ in range(self.random.choice((1, 3, 5))):
                await self.connect()
            table = {
                self.write_nowait: 30,
                self.write: 14,
                self.read_nowait: 20,
                self.read: 8,
                self.latest: 4,
                self.drain: 2,
                self.pass_time: 8,
                self.connect: 5,
                self.disconnect: 4,
                self.activate: 3,
                self.cancel: 5,
                self.write_nonsense: 1,
            }
            for step in self.random.choices(list(table), list(table.values()), k=STEPS):
                await step()
                await self.settle()
                self.compare(step.__name__)
            for task, _ in self.writes:
                task.cancel()
            for read in filter(None, self.reads):
                read.cancel()

    async def settle(self) -> None:
        for _ in range(6):
            await asyncio.sleep(0)
        self.world.settle()

    def compare(self, step: str) -> None:
        for connector, link in self.all:
            ledger = connector.statistics
            got = (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped))
            assert got == link.model.expected, (step, connector)
            assert ledger.balanced
        for number, writer in enumerate(self.sources if self.keeps_last else ()):
            last = last_written(writer.out)
            assert (None if last is NOTHING else last.data) == self.world.last(number), (step, writer)
        for number, sink in enumerate(self.sinks):
            model = self.world.sinks[number]
            assert sink.inp.is_new == bool(model.order), step
            peeked = sink.inp.peek()
            assert (None if peeked is None else peeked.data) == (
                model.order[0].ledger.samples[0] if model.order else None
            ), step
            source = sink.inp.last_source
            assert (source is None) == (model.source is None), step
            assert source is None or any(c is source and link.model is model.source for c, link in self.all), step
            self.compare_read(number, step)
        for task, write in tuple(self.writes):
            assert task.done() == (not write.links), (step, write)
            if task.done():
                self.writes.remove((task, write))
                error = task.exception()
                assert error is None or isinstance(error, WriteTimeout), step
                assert ("late" if error else task.result()) == write.outcome, step
                self.hits["write timed out" if error else "write waited"] += 1

    def compare_read(self, number: int, step: str) -> None:
        read, got = self.reads[number], self.world.reads[number]
        assert (read is None) == (got is None), step
        if read is not None and got is not None:
            assert read.done() == bool(got), step
            if read.done():
                assert read.result().data == got[0], step
                self.reads[number] = self.world.reads[number] = None
                self.hits["read waited"] += 1

    def source(self) -> int:
        return self.random.choice(sorted({link.source for link in self.live}) or [0])

    def count(self, number: int) -> None:
        """How the next write of a source will go."""
        out = self.sources[number].out
        if out._stale:
            self.hits["write chose its path"] += 1
        elif len(out._fast) < out._room:
            self.hits["write fast"] += 1
        elif self.world.of_source(number):
            self.hits["write fan-out"] += len(out._fan) > 1
            self.hits["write merged"] += bool(out._merged)
            self.hits["write full"] += len(out._fan) == 1
            self.hits["write mixed"] += bool(out._others) and bool(out._fan)

    async def write_nowait(self) -> None:
        for _ in range(self.random.choice((1, 1, 2, 5))):
            number = self.source()
            self.written += 1
            expected = self.world.write_nowait(number, self.written)
            self.count(number)
            try:
                result: bool | None = self.sources[number].out.write_nowait(long(self.written))
            except WouldBlock:
                result = None
            assert result is expected
            self.hits["write"] += 1

    async def write_nonsense(self) -> None:
        with pytest.raises(PortTypeError):
            self.sources[self.source()].out.write_nowait("nonsense")  # type: ignore[arg-type]

    async def write(self) -> None:
        await self.tick()
        number = self.source()
        self.written += 1
        now = self.clock.monotonic_ns()
        give_up = {
            link: None if (timeout := self.live[link].profile.timeout) is None else now + round(timeout * 1e9)
            for link in self.world.of_source(number)
        }
        expected = self.world.write(number, self.written, give_up)
        self.count(number)
        task = asyncio.ensure_future(self.sources[number].out.write(long(self.written)))
        self.writes.append((task, expected))
        self.hits["write"] += 1

    async def read_nowait(self) -> None:
        for _ in range(self.random.choice((1, 1, 3))):
            number = self.random.randrange(SINKS)
            port = self.sinks[number].inp
            if port._fast:
                self.hits["read fast"] += 1
            elif receiver_of(port).plain:
                self.hits["read merged"] += bool(receiver_of(port).tokens)
                self.hits["read with writers waiting"] += bool(receiver_of(port).direct)
            expected = self.world.read(number)
            try:
                result: int | None = port.read_nowait().data
            except WouldBlock:
                result = None
            assert result == expected

    async def read(self) -> None:
        number = self.random.randrange(SINKS)
        if self.reads[number] is None:
            self.reads[number] = asyncio.ensure_future(self.sinks[number].inp.read())
            self.world.reads[number] = []

    async def latest(self) -> None:
        number = self.random.randrange(SINKS)
        sample = self.sinks[number].inp.latest
        assert (None if sample is None else sample.data) == self.world.latest(number)

    async def drain(self) -> None:
        number = self.random.randrange(SINKS)
        assert [sample.data for sample in self.sinks[number].inp.drain()] == self.world.drain(number)

    async def cancel(self) -> None:
        if self.writes:
            task, write = self.writes.pop(self.random.randrange(len(self.writes)))
            task.cancel()
            self.world.cancel(write)
            self.hits["write cancelled"] += 1
        number = self.random.randrange(SINKS)
        read = self.reads[number]
        if read is not None and self.random.random() < 0.5:
            read.cancel()
            self.reads[number] = self.world.reads[number] = None
            self.hits["read cancelled"] += 1

    async def pass_time(self, seconds: float = 0.0) -> None:
        before = self.clock.monotonic_ns()
        await self.kernel.sleep(seconds or self.random.choice((0.01, 0.05, 0.13, 0.4)))
        self.world.advance(before, self.clock.monotonic_ns())

    async def tick(self) -> None:
        """So that no two things that happen by the clock happen at the same moment."""
        await self.pass_time(0.000_100_003)

    async def connect(self) -> None:
        await self.tick()
        subscription, push, full = self.random.choice(self.combinations)
        if self.random.random() < 0.3:
            full = "block"
        options: dict[str, Any] = {"subscription": subscription, "push": push, "full": full}
        if push == "skip":
            options["skip"] = self.random.choice((0, 1, 2))
        if self.random.random() < 0.8:
            options["length"] = self.random.choice((1, 2, 3, 5))
        if subscription == "periodic":
            options |= {"push_rate": self.random.choice((4, 10, 30)), "out_length": self.random.choice((1, 2, 4, 8))}
        if self.keeps_last and self.random.random() < 0.3:
            options["keep_last"] = True
        source, sink = self.random.randrange(SOURCES), self.random.randrange(SINKS)
        connector = await self.kernel.connect(
            self.sources[source].out,
            self.sinks[sink].inp,
            allow_duplicate=True,
            timeout=self.random.choice((None, 0.03, 0.2)),
            **options,
            **self.options,
        )
        link = Link(source, sink, ModelConnector(options, self.clock.monotonic_ns()))
        self.world.links.append(link)
        self.world.sinks[sink].connectors.append(link.model)
        self.world.offer_last(link)
        self.hits["offered"] += link.model.offered
        self.live[link] = connector
        self.all.append((connector, link))

    async def disconnect(self) -> None:
        if self.live:
            link = self.random.choice(list(self.live))
            await self.kernel.disconnect(self.live.pop(link))
            self.world.disconnect(link)

    async def activate(self) -> None:
        number = self.random.randrange(SINKS)
        sink, context, is_open = self.sinks[number], self.contexts[number], self.world.sinks[number].is_open
        await (context.deactivate(sink) if is_open else context.activate(sink))
        self.world.set_open(number, not is_open)


PARTS = 20 if CAMPAIGN else 1
"""A campaign in parts, none of them longer than a test may take. Each system is played in an order of its own."""


@pytest.mark.row(39, 40, 41)
@pytest.mark.fault("B06")
@pytest.mark.campaign
@pytest.mark.parametrize("part", range(PARTS))
def test_random_systems_do_what_the_reference_model_does_and_take_the_fast_paths(part: int) -> None:
    hits: Counter[str] = Counter()

    size = ORDERS // PARTS
    for number in range(part * size, (part + 1) * size):
        simulate(System(number, hits).play, seed=number)
    for what in ("fast", "fan-out", "merged", "full", "mixed"):
        assert hits[f"write {what}"] > hits["write"] / 100, (what, hits)
    for what in ("fast", "merged", "with writers waiting", "waited", "cancelled"):
        assert hits[f"read {what}"] > 10, (what, hits)
    assert hits["offered"] > 10, hits
    for what in ("waited", "timed out", "cancelled"):
        assert hits[f"write {what}"] > 10, (what, hits)


@pytest.mark.campaign
def test_random_systems_in_debug_mode_take_the_general_path_and_do_the_same() -> None:
    hits: Counter[str] = Counter()

    async def main(clock: SimulatedClock) -> None:
        for number in range(max(cases(1_000), 40)):
            await System(number, hits, debug=True).play(clock)

    simulate(main)
    assert not hits["write fast"]
    assert not hits["read fast"]
    assert hits["write"]
