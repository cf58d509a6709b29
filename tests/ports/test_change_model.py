"""Any writes, waits, reads and changes of options, in virtual time and shuffled order, do what a small model says."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Connector, ExternalContext, Kernel, SimulatedClock
from aiorts.errors import WriteTimeout
from aiorts.events import ConnectorChanged
from aiorts.kernel.ports.port import lock_all
from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Push, admits
from aiorts.testing.simulation import simulate
from campaign import cases, time_limit
from ports.parts import Model, ModelConnector, Sink, Source, data, long

TIMEOUT_NS = 150_000_000
STEP_NS = 1_000_003
"""Between two operations at least: no two periods that were begun by a connection or a change end together."""
SLEEPS = (0.0, 0.0, 0.0137, 0.0511, 0.1303, 0.4007)
KINDS: dict[str, dict[str, Any]] = {
    "flush": {"subscription": "flush"},
    "lifespan": {"subscription": "flush", "lifespan": 1000.0},
    "convert": {"subscription": "new", "push": "all", "convert": lambda sample: sample},
    "fifo": {"subscription": "new", "push": "fifo"},
    "skip": {"subscription": "new", "push": "skip", "skip": 1},
    "new": {"subscription": "new", "push": "new"},
    "pull": {"dataflow": "pull"},
    "periodic all": {"subscription": "periodic", "push": "all", "push_rate": 10, "out_length": 4},
    "periodic fifo": {"subscription": "periodic", "push": "fifo", "push_rate": 10, "out_length": 4},
    "periodic skip": {"subscription": "periodic", "push": "skip", "skip": 2, "push_rate": 10, "out_length": 8},
}


@dataclass(eq=False)
class ChangingConnector(ModelConnector):
    """A connector with writers that wait, whose options may change."""

    waiting: deque[tuple[int, int]] = field(default_factory=deque)  # sample, deadline

    @property
    def blocks(self) -> bool:
        return self.ledger.full is FullPolicy.BLOCK and self.push is not Push.NEW

    @property
    def admits_next(self) -> bool:
        return admits(self.push, self.skip, self.ledger.written + 1)


class ChangingModel(Model):
    """An in-port, as in `Model`, with writers that wait and options that change."""

    connectors: list[Any]

    def write(self, connector: Any, sample: int) -> bool | None:
        if self.is_open and connector.blocks and connector.waiting and connector.admits_next:
            return None
        return super().write(connector, sample)

    def admit(self, connector: ChangingConnector, *, all_of_them: bool = False) -> None:
        """Let in who waits, as far as there is room."""
        ledger = connector.ledger
        while connector.waiting:
            sends = connector.admits_next
            if sends and len(ledger.samples) >= ledger.length and not all_of_them:
                return
            sample, _ = connector.waiting.popleft()
            ledger.written += 1
            if sends:
                ledger.samples.append(sample)
                self._arrived(connector, sample)
            else:
                ledger.drop("skipped")

    def read(self) -> int | None:
        found = super().read()
        if found is not None:
            self.admit(self.source)  # type: ignore[arg-type]
        return found

    def latest(self) -> int | None:
        newest: Any = self.newest()
        if newest is not None:
            self.last, self.source = newest.ledger.take_newest(), newest
            for one in (newest, *(one for one in self.connectors if one is not newest)):
                if one is not newest:
                    one.ledger.discard("superseded")
                self.admit(one)
        return self.last

    def set_open(self, is_open: bool) -> None:
        super().set_open(is_open)
        for one in self.connectors:
            one.ledger.written += len(one.waiting)
            one.ledger.drop("inactive", len(one.waiting))
            one.waiting.clear()

    def change(self, connector: ChangingConnector, options: dict[str, Any], now_ns: int) -> None:
        ledger = connector.ledger
        full = FullPolicy(options.get("full", ledger.full))
        self.admit(connector, all_of_them=full is not FullPolicy.BLOCK)
        ledger.full, ledger.length = full, options.get("length", ledger.length)
        self.admit(connector)
        if options.get("push_rate", connector.options.get("push_rate")) != connector.options.get("push_rate"):
            connector.options["push_rate"], connector.start_ns = options["push_rate"], now_ns

    def advance(self, from_ns: int, to_ns: int) -> None:
        super().advance(from_ns, to_ns)
        for one in self.connectors:
            late = [entry for entry in one.waiting if entry[1] <= to_ns]
            for entry in late:
                one.waiting.remove(entry)
            one.ledger.written += len(late)
            one.ledger.drop("timeout", len(late))


class Bench:
    """The real system, beside the model of it."""

    def __init__(self, kernel: Kernel, clock: SimulatedClock, options: list[dict[str, Any]], *, locked: bool) -> None:
        self.kernel, self.clock, self.options, self.locked = kernel, clock, options, locked
        self.model = ChangingModel()
        self.sources: list[Source] = []
        self.wires: list[Connector] = []
        self.removers: list[Callable[[], None]] = []
        self.tasks: dict[int, asyncio.Task[bool]] = {}
        self.cancelled: set[int] = set()
        self.changed: list[ConnectorChanged] = []
        self.written = 0

    async def build(self) -> None:
        self.kernel.bus.subscribe(ConnectorChanged, self.changed.append)
        self.sink = await self.kernel.add(Sink("sink"))
        self.context = await self.kernel.start(ExternalContext(), self.sink, activate=True)
        for number, chosen in enumerate(self.options):
            source = await self.kernel.add(Source(f"source{number}"))
            await self.pass_time(0.0)
            self.wires.append(await self.kernel.connect(source.out, self.sink.inp, timeout=TIMEOUT_NS / 1e9, **chosen))
            self.sources.append(source)
            said = {"subscription": "new", "push": "new", **chosen} if "dataflow" in chosen else dict(chosen)
            self.model.connectors.append(ChangingConnector(said, self.clock.monotonic_ns()))
        if self.locked:
            lock_all(self.sink.inp)

    async def pass_time(self, seconds: float) -> None:
        before = self.clock.monotonic_ns()
        await self.kernel.sleep(STEP_NS / 1e9 + seconds)
        self.model.advance(before, self.clock.monotonic_ns())

    async def do(self, operation: str, index: int, value: int) -> None:
        """Once here and once in the model, with the same result."""
        number = index % len(self.wires)
        source, wire, one = self.sources[number], self.wires[number], self.model.connectors[number]
        port, model = self.sink.inp, self.model
        if operation == "write":
            for _ in range(value):
                self.written += 1
                expected = model.write(one, self.written)
                try:
                    done: bool | None = source.out.write_nowait(long(self.written))
                except WouldBlock:
                    done = None
                assert done is expected
        elif operation == "wait":
            self.written += 1
            expected = model.write(one, self.written)
            if expected is None:
                one.waiting.append((self.written, self.clock.monotonic_ns() + TIMEOUT_NS))
            task = self.tasks[self.written] = asyncio.create_task(source.out.write(long(self.written)))
            await turns()
            assert task.done() is (expected is not None)
            assert expected is None or task.result() is expected
        elif operation == "cancel":
            for sample, _ in tuple(one.waiting)[:1]:
                one.waiting.popleft()
                self.cancelled.add(sample)
                self.tasks[sample].cancel()
        elif operation == "read":
            for _ in range(value):
                try:
                    read: int | None = port.read_nowait().data
                except WouldBlock:
                    read = None
                assert read == model.read()
        elif operation == "latest":
            latest = port.latest
            assert (None if latest is None else latest.data) == model.latest()
        elif operation == "drain":
            assert data(port.drain()) == model.drain()
        elif operation == "listen":
            self.removers.append(self.kernel.listen(wire, lambda event: None))
        elif operation == "unlisten":
            while self.removers:
                self.removers.pop()()
        elif operation == "switch":
            await (self.context.deactivate if model.is_open else self.context.activate)(self.sink)
            model.set_open(not model.is_open)

    def change(self, index: int, options: dict[str, Any]) -> None:
        number = index % len(self.wires)
        wire, one = self.wires[number], self.model.connectors[number]
        new = dict(options)
        if one.subscription != "periodic":
            new.pop("push_rate", None)
        if new:
            before, count = wire.profile, len(self.changed)
            wire.change(**new)
            self.model.change(one, new, self.clock.monotonic_ns())
            assert {key: getattr(wire.profile, key) for key in new} == new
            assert len(self.changed) == count + (wire.profile != before)

    async def compare(self) -> None:
        await turns()
        for wire, one in zip(self.wires, self.model.connectors, strict=True):
            ledger = wire.statistics
            assert (ledger.written, ledger.delivered, ledger.buffered, dict(ledger.dropped)) == one.expected
        unfinished = {sample for sample, task in self.tasks.items() if not task.done()}
        assert unfinished == {sample for one in self.model.connectors for sample, _ in one.waiting}
        port, order = self.sink.inp, self.model.order
        assert port.is_new == bool(order)
        peeked = port.peek()
        assert (None if peeked is None else peeked.data) == (order[0].ledger.samples[0] if order else None)


async def turns() -> None:
    """Let what is ready run; no time passes."""
    for _ in range(6):
        await asyncio.sleep(0)


def run(
    connectors: list[tuple[str, str, int]], steps: list[tuple[str, int, Any, float]], seed: int, *, locked: bool
) -> None:
    options = [{**KINDS[kind], "full": full, "length": length} for kind, full, length in connectors]

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            bench = Bench(kernel, clock, options, locked=locked)
            await bench.build()
            for operation, index, value, seconds in steps:
                await bench.pass_time(seconds)
                if operation == "change":
                    bench.change(index, value)
                else:
                    await bench.do(operation, index, value)
                await bench.compare()
        results = await asyncio.gather(*bench.tasks.values(), return_exceptions=True)
        assert all(isinstance(one, bool | WriteTimeout | asyncio.CancelledError) for one in results), results

    simulate(main, seed=seed)


FULL = st.sampled_from(["overwrite", "reject", "block", "block"])
LENGTH = st.sampled_from([1, 2, 3, 5])
CONNECTORS = st.lists(st.tuples(st.sampled_from(sorted(KINDS)), FULL, LENGTH), min_size=1, max_size=3)
OPERATIONS = st.tuples(
    st.sampled_from(
        (
            *("write", "wait", "wait", "read", "read"),
            *("write", "cancel", "latest", "drain", "listen", "unlisten", "switch"),
        )
    ),
    st.integers(0, 2),
    st.sampled_from([1, 1, 2, 5]),
    st.sampled_from(SLEEPS),
)
CHANGED = st.fixed_dictionaries(
    {}, optional={"length": LENGTH, "full": FULL, "push_rate": st.sampled_from([4, 10, 30])}
)
CHANGES = st.tuples(st.just("change"), st.integers(0, 2), CHANGED, st.sampled_from(SLEEPS))
STEPS = st.lists(st.one_of(OPERATIONS, OPERATIONS, CHANGES), min_size=1, max_size=40)


@pytest.mark.slow(kept_by="test_a_known_course")
@pytest.mark.timeout(time_limit(600))
@pytest.mark.parametrize("locked", [False, True], ids=["plain", "locked"])
@settings(max_examples=cases(3_000), deadline=None)
@given(connectors=CONNECTORS, steps=STEPS, seed=st.integers(0, 1_000))
def test_any_operations_do_what_the_model_says(
    locked: bool, connectors: list[tuple[str, str, int]], steps: list[tuple[str, int, Any, float]], seed: int
) -> None:
    run(connectors, steps, seed, locked=locked)


@pytest.mark.parametrize("kind", KINDS)
def test_a_known_course(kind: str) -> None:
    """Five writers, a smaller length, then another full policy, with a second writer beside them."""
    steps: list[tuple[str, int, Any, float]] = [("wait", index % 2, 1, 0.0) for index in range(10)]
    steps += [("change", 0, {"length": 1, "push_rate": 4}, 0.0), ("wait", 0, 1, 0.0), ("read", 0, 2, 0.0)]
    steps += [("change", 0, {"full": "overwrite"}, 0.0), ("write", 0, 2, 0.4007), ("change", 1, {"length": 9}, 0.0)]
    run([(kind, "block", 3), ("flush", "block", 2)], [*steps, ("drain", 0, 1, 0.4007)], 0, locked=False)
