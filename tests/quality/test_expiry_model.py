"""Any operations at connectors with a lifespan, in virtual time and shuffled order: what `expiry_model` says."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, ExternalContext, InPort, Kernel, OutPort, SimulatedClock
from aiorts.errors import WriteTimeout
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases, time_limit
from quality.expiry_model import LIFESPANS_NS, RATE, TIMEOUT_NS, Model, ModelConnector

STEP = 0.1
"""Seconds between two operations; the first is half of it after the last connector was made."""
APART_NS = 7_000_000
"""Between the making of two connectors: their periods do not end together."""
OPERATIONS = (
    *("write", "write", "write", "wait", "wait", "cancel", "read", "read", "read"),
    *("peek", "drain", "latest", "is_new", "listen", "unlisten", "switch", "length", "full"),
)


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


KINDS = st.sampled_from(["flush", "flush", "new", "pull", "periodic all", "periodic fifo", "periodic new"])
FULLS = ["overwrite", "reject", "block"]
FULL = st.sampled_from(FULLS)
CONNECTORS = st.lists(st.tuples(KINDS, FULL, st.integers(1, 3), st.booleans()), min_size=1, max_size=2)
CHANGES = st.lists(
    st.tuples(st.sampled_from(OPERATIONS), st.integers(0, 1), st.sampled_from([0, 0, 1, 1, 2, 4, 5, 9])),
    min_size=1,
    max_size=40,
)


def options_of(one: ModelConnector) -> dict[str, Any]:
    subscription, _, push = one.kind.partition(" ")
    options: dict[str, Any] = {"full": one.full, "length": one.length, "timeout": TIMEOUT_NS / 1e9}
    if one.lifespan_ns is not None:
        options["lifespan"] = one.lifespan_ns / 1e9
    if subscription == "pull":
        return {**options, "dataflow": "pull"}
    if one.periodic:
        options.update(push=push, push_rate=RATE, out_length=one.length)
    return {**options, "subscription": subscription}


class Bench:
    """The real system, beside the model of it."""

    def __init__(self, kernel: Kernel, clock: SimulatedClock, model: Model) -> None:
        self.kernel, self.clock, self.model = kernel, clock, model
        self.sources: list[Source] = []
        self.wires: list[Any] = []
        self.removers: list[Callable[[], None]] = []
        self.tasks: dict[int, asyncio.Task[bool]] = {}
        self.written = 0

    async def build(self) -> None:
        self.sink = await self.kernel.add(Sink("sink"))
        self.context = await self.kernel.start(ExternalContext(), self.sink, activate=True)
        for number, one in enumerate(self.model.connectors):
            source = await self.kernel.add(Source(f"source{number}"))
            await self.clock.advance((one.start_ns - self.clock.monotonic_ns()) / 1e9)
            self.wires.append(await self.kernel.connect(source.out, self.sink.inp, **options_of(one)))
            self.sources.append(source)

    async def do(self, operation: str, index: int) -> None:
        """Once here and once in the model, with the same result."""
        number = index % len(self.wires)
        source, wire, one, port, model = (
            self.sources[number],
            self.wires[number],
            self.model.connectors[number],
            self.sink.inp,
            self.model,
        )
        if operation in ("write", "wait"):
            self.written += 1
            sample = TimedLong(0, self.written)
            if operation == "write":
                try:
                    done: bool | None = source.out.write_nowait(sample)
                except WouldBlock:
                    done = None
                assert done == model.write(one, self.written, waits=False)
            else:
                expected = model.write(one, self.written, waits=True)
                task = asyncio.create_task(source.out.write(sample))
                for _ in range(4):
                    await asyncio.sleep(0)
                assert task.done() is (expected is not None)
                assert expected is None or task.result() is expected
                self.tasks[self.written] = task
        elif operation == "cancel":
            for entry in one.waiting[:1]:
                model.cancel(one, entry.sample)
                self.tasks[entry.sample].cancel()
                for _ in range(4):
                    await asyncio.sleep(0)
        elif operation == "read":
            try:
                read: int | None = port.read_nowait().data
            except WouldBlock:
                read = None
            assert read == model.read()
        elif operation == "peek":
            found = port.peek()
            assert (None if found is None else found.data) == model.peek()
        elif operation == "drain":
            assert [sample.data for sample in port.drain()] == model.drain()
        elif operation == "latest":
            latest = port.latest
            assert (None if latest is None else latest.data) == model.read_newest()
        elif operation == "is_new":
            assert port.is_new is bool(model.unread)
        elif operation == "listen":
            self.removers.append(self.kernel.listen(wire, lambda event: None))
        elif operation == "unlisten":
            while self.removers:
                self.removers.pop()()
        elif operation in ("length", "full"):
            if not one.replaces:
                length, full = one.length, one.full
                if operation == "length":
                    length = length % 3 + 1
                    wire.change(length=length)
                else:
                    full = FULLS[(FULLS.index(full) + 1) % 3]
                    wire.change(full=full)
                model.change(one, length, full)
                for _ in range(4):
                    await asyncio.sleep(0)
        else:
            await (self.context.deactivate if model.is_open else self.context.activate)(self.sink)
            model.set_open(not model.is_open)

    def compare(self) -> None:
        for wire, one in zip(self.wires, self.model.connectors, strict=True):
            ledger = wire.statistics
            found = ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)
            assert found == (*one.counts[:3], {reason: count for reason, count in one.dropped.items() if count})


def run(connectors: list[tuple[str, str, int, bool]], changes: list[tuple[str, int, int]], seed: int) -> None:
    async def main(clock: SimulatedClock) -> None:
        model = Model(
            [
                ModelConnector(
                    kind,
                    full,
                    1 if kind in ("new", "pull") else length,
                    LIFESPANS_NS[number] if short else None,
                    number * APART_NS,
                    length,
                )
                for number, (kind, full, length, short) in enumerate(connectors)
            ]
        )
        async with Kernel() as kernel:
            bench = Bench(kernel, clock, model)
            await bench.build()
            await asyncio.sleep(STEP / 2)
            for operation, index, steps in changes:
                model.advance(clock.monotonic_ns())
                await bench.do(operation, index)
                if steps != 1:  # else the next operation is the first that looks
                    bench.compare()
                if steps:
                    await asyncio.sleep(steps * STEP)
            model.advance(clock.monotonic_ns())
            bench.compare()
        results = await asyncio.gather(*bench.tasks.values(), return_exceptions=True)
        assert all(isinstance(one, bool | WriteTimeout | asyncio.CancelledError) for one in results), results

    simulate(main, seed=seed)


@pytest.mark.slow(kept_by="test_a_known_course")
@pytest.mark.timeout(time_limit(1200))
@settings(max_examples=cases(5_000), deadline=None)
@given(CONNECTORS, CHANGES, st.integers(0, 1_000))
def test_any_operations_do_what_the_model_says(
    connectors: list[tuple[str, str, int, bool]], changes: list[tuple[str, int, int]], seed: int
) -> None:
    run(connectors, changes, seed)


@pytest.mark.parametrize("full", ["overwrite", "reject", "block"])
def test_a_known_course(full: str) -> None:
    """What the model says, said once by hand: with length 1, three writes 0.3 s apart, read at 0.65 s."""
    changes = [("wait", 0, 3), ("wait", 0, 3), ("wait", 0, 0), ("drain", 0, 0)]
    run([("flush", full, 1, True)], changes, 0)
