"""Every schedule of writes, reads, time, connections and activations leaves exactly what the reference model leaves."""

from __future__ import annotations

import random
from itertools import product
from typing import Any

import pytest

from aiorts import Connector, ExternalContext, Kernel, SimulatedClock, WouldBlock
from aiorts.kernel.ports.connector import unread_of
from aiorts.testing.simulation import simulate
from campaign import cases
from ports.parts import Model, ModelConnector, Sink, Source, long

pytestmark = pytest.mark.slow(kept_by="first")

COMBINATIONS = [
    (subscription, push, full)
    for subscription, pushes in (
        ("flush", ("all",)),
        ("new", ("all", "fifo", "skip", "new")),
        ("periodic", ("all", "fifo", "skip", "new")),
    )
    for push, full in product(pushes, ("overwrite", "reject", "block"))
]
STEPS = 60
WRITERS = 3


class Schedule:
    """One random schedule, played on live ports and on the model side by side."""

    def __init__(self, number: int, **kernel_options: Any) -> None:
        self.random = random.Random(number)
        self.first: tuple[str, str, str] | None = COMBINATIONS[number % len(COMBINATIONS)]
        self.stamp = kernel_options.pop("stamp", None)
        self.kernel_options = kernel_options
        self.model = Model()
        self.live: dict[int, tuple[Connector, ModelConnector]] = {}
        self.all: list[tuple[Connector, ModelConnector]] = []
        self.trace: list[object] = []
        self.written = 0

    async def play(self, clock: SimulatedClock) -> list[object]:
        self.clock = clock
        async with Kernel(**self.kernel_options) as kernel:
            self.kernel = kernel
            self.sink = await kernel.add(Sink("sink"))
            self.sources = [await kernel.add(Source(f"source{i}")) for i in range(WRITERS)]
            self.context = await kernel.start(ExternalContext(), self.sink)
            self.model.set_open(False)
            await self.activate()
            await self.connect()
            steps = (self.write, self.read, self.latest, self.drain, self.pass_time, self.connect, self.disconnect)
            chosen = self.random.choices((*steps, self.activate), (40, 22, 4, 2, 16, 7, 4, 3), k=STEPS)
            for step in chosen:
                await step()
                self.compare(step.__name__)
        return self.trace

    def compare(self, step: str) -> None:
        for connector, model in self.all:
            ledger = connector.statistics
            got = (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped))
            assert got == model.expected, (step, connector)
            assert unread_of(connector) == len(model.ledger.samples)
        port = self.sink.inp
        assert port.is_new == bool(self.model.order)
        first = self.model.order[0].ledger.samples[0] if self.model.order else None
        peeked = port.peek()
        assert (None if peeked is None else peeked.data) == first
        source = port.last_source
        assert (self.model.source is None) == (source is None), (step, source)
        assert source is None or (source, self.model.source) in self.all, step

    async def write(self) -> None:
        if not self.live:
            return
        for _ in range(self.random.choice((1, 1, 2, 5))):
            number = self.random.choice(sorted(self.live))
            self.written += 1
            expected = self.model.write(self.live[number][1], self.written)
            try:
                result: bool | None = self.sources[number].out.write_nowait(long(self.written))
            except WouldBlock:
                result = None
            assert result is expected
            self.trace.append(("write", result))

    async def read(self) -> None:
        for _ in range(self.random.choice((1, 1, 3))):
            expected = self.model.read()
            try:
                result: int | None = self.sink.inp.read_nowait().data
            except WouldBlock:
                result = None
            assert result == expected
            self.trace.append(("read", result))

    async def latest(self) -> None:
        sample = self.sink.inp.latest
        result = None if sample is None else sample.data
        assert result == self.model.latest()
        self.trace.append(("latest", result))

    async def drain(self) -> None:
        result = [sample.data for sample in self.sink.inp.drain()]
        assert result == self.model.drain()
        self.trace.append(("drain", result))

    async def pass_time(self) -> None:
        before = self.clock.monotonic_ns()
        await self.kernel.sleep(self.random.choice((0.01, 0.05, 0.13, 0.4)))
        self.model.advance(before, self.clock.monotonic_ns())

    async def connect(self) -> None:
        free = [number for number in range(WRITERS) if number not in self.live]
        if not free:
            return
        # Connections start at moments of their own: no two periods are ever over at the same time.
        before = self.clock.monotonic_ns()
        await self.kernel.sleep(0.001_000_003)
        self.model.advance(before, self.clock.monotonic_ns())
        number = free[0]
        subscription, push, full = self.first or self.random.choice(COMBINATIONS)
        self.first = None
        options: dict[str, Any] = {"subscription": subscription, "push": push, "full": full}
        if push == "skip":
            options["skip"] = self.random.choice((0, 1, 2))
        if self.random.random() < 0.8:
            options["length"] = self.random.choice((1, 2, 3, 5))
        if subscription == "periodic":
            options |= {"push_rate": self.random.choice((4, 10, 30)), "out_length": self.random.choice((1, 2, 4, 8))}
        connector = await self.kernel.connect(self.sources[number].out, self.sink.inp, stamp=self.stamp, **options)
        model = ModelConnector(options, self.clock.monotonic_ns())
        self.model.connectors.append(model)
        self.live[number] = (connector, model)
        self.all.append((connector, model))

    async def disconnect(self) -> None:
        if self.live:
            number = self.random.choice(sorted(self.live))
            connector, model = self.live.pop(number)
            await self.kernel.disconnect(connector)
            self.model.disconnect(model)

    async def activate(self) -> None:
        if self.model.is_open:
            await self.context.deactivate(self.sink)
        else:
            await self.context.activate(self.sink)
        self.model.set_open(not self.model.is_open)


@pytest.mark.row(39, 40, 41)
@pytest.mark.fault("B06")
@pytest.mark.campaign
def test_survivors_and_ledger_are_those_of_the_reference_model_after_every_step() -> None:
    async def main(clock: SimulatedClock) -> None:
        for number in range(max(cases(10_000), 2 * len(COMBINATIONS))):
            await Schedule(number).play(clock)

    simulate(main)


@pytest.mark.campaign
@pytest.mark.parametrize(
    "options", [{"debug": True}, {"stamp": "send"}, {"stamp": "read"}], ids=["debug", "stamp-send", "stamp-read"]
)
def test_the_fast_path_gives_what_the_general_path_gives(options: dict[str, Any]) -> None:
    async def main(clock: SimulatedClock) -> None:
        for number in range(100_000, 100_000 + cases(2_000)):
            assert await Schedule(number).play(clock) == await Schedule(number, **options).play(clock)

    simulate(main)
