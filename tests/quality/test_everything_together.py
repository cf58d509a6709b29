"""All options of connectors at once, changed, closed and waited at in any order: every sample is read once or counted.

The model is a notebook: what each writer sent, what each read gave and through which connector. It says of each
connector how much it must have counted, and of each sample whether it may be read.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Protocol

import pytest
from anyio import WouldBlock

from aiorts import (
    Component,
    Connector,
    ExternalContext,
    Goal,
    InPort,
    Kernel,
    OutPort,
    Provided,
    Required,
    Synchronizer,
    wait_any,
)
from aiorts.errors import BusyError, ClosedError, ReadTimeout, ServiceError, StateError, WiringError, WriteTimeout
from aiorts.testing import simulate
from aiorts.types import TimedLong

CAMPAIGN = bool(os.environ.get("AIORTS_CAMPAIGN"))
SEEDS, OPERATIONS = (40, 2500) if CAMPAIGN else (2, 250)
OFFSET = 1_000_000
"""What the converter adds; a third of what it gets it refuses."""


class Work(Protocol):
    async def work(self, length: int) -> Goal[int, int]: ...


class Writer(Component):
    out = OutPort(TimedLong)


class Reader(Component):
    inp = InPort(TimedLong)


class Fused(Component):
    one = InPort(TimedLong)
    two = InPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.pairs = Synchronizer(self.one, self.two, policy="nearest", tolerance=0.05, length=4)


class Worker(Component):
    service = Provided[Work](cancel_timeout=0.2)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.goals: list[Goal[int, int]] = []

    def work(self, length: int) -> Goal[int, int]:
        if length % 5 == 0:
            raise ValueError(length)
        goal: Goal[int, int] = Goal()
        self.goals.append(goal)
        return goal


class Asker(Component):
    worker = Required[Work]()


def plus(sample: TimedLong) -> TimedLong:
    """Refuses every third, and answers every fifth with a wrong type."""
    if sample.data % 3 == 0:
        raise ValueError(sample.data)
    return "wrong" if sample.data % 5 == 0 else TimedLong(sample.tm, sample.data + OFFSET)  # type: ignore[return-value]


def unconvertible(data: int) -> bool:
    return data % 3 == 0 or data % 5 == 0


@dataclass(eq=False)
class Wire:
    """What the notebook says of one connector."""

    connector: Connector
    writer: int
    converts: bool
    lifespan: float | None
    least: int = 0
    """Writes that it must have counted."""
    most: int = 0
    """Writes that it may have counted."""
    read: list[int] = field(default_factory=list)


class Storm:
    """Random operations on one system, and the notebook."""

    def __init__(self, kernel: Kernel, seed: int) -> None:
        self.kernel = kernel
        self.random = random.Random(seed)
        self.wires: list[Wire] = []
        self.written: dict[int, dict[int, float]] = {}
        """By writer: each number with the time of its write."""
        self.number = 0
        self.tasks: set[asyncio.Task[None]] = set()
        self.failures: list[BaseException] = []
        self.done: Counter[str] = Counter()
        self.offers = 0
        self.at_once: set[int] = set()
        """Numbers that were written without waiting."""
        self.under_way = [0, 0, 0]
        """Writes of each writer that wait: a connector that is made meanwhile may get their samples, too."""

    async def open(self) -> None:
        create = self.kernel.create
        self.writers = [await create(Writer) for _ in range(3)]
        self.readers = [await create(Reader) for _ in range(3)]
        self.fused, self.worker, self.asker = await create(Fused), await create(Worker), await create(Asker)
        self.work = await self.kernel.connect(self.asker.worker, self.worker.service)
        self.context = await self.kernel.start(ExternalContext(), *self.writers, activate=True)
        self.others = await self.kernel.start(
            ExternalContext(), *self.readers, self.fused, self.worker, self.asker, activate=True
        )

    # -- one operation ---------------------------------------------------------------------------------------------

    async def one(self) -> None:
        name = self.random.choices(tuple(_WEIGHTS), tuple(_WEIGHTS.values()))[0]
        self.done[name] += 1
        await getattr(self, f"do_{name}")()

    def task(self, coroutine: Any) -> None:
        task = asyncio.ensure_future(coroutine)
        self.tasks.add(task)
        task.add_done_callback(self._task_ended)

    def _task_ended(self, task: asyncio.Task[None]) -> None:
        self.tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.failures.append(error)

    def sample(self, writer: int) -> TimedLong:
        self.number += 1
        self.written.setdefault(writer, {})[self.number] = self.kernel.clock.time()
        return TimedLong(self.kernel.clock.time_ns(), self.number)

    def live(self, writer: int) -> list[Wire]:
        return [wire for wire in self.wires if wire.writer == writer and not wire.connector.closed]

    async def do_write(self) -> None:
        writer = self.random.randrange(3)
        wires = self.live(writer)
        sample = self.sample(writer)
        self.at_once.add(sample.data)
        try:
            self.writers[writer].out.write_nowait(sample)
        except WouldBlock:
            return
        for wire in wires:
            wire.least += 1
            wire.most += 1

    async def do_write_waiting(self) -> None:
        self.task(self._write(self.random.randrange(3)))

    async def _write(self, writer: int) -> None:
        wires = self.live(writer)
        for wire in wires:
            wire.most += 1
        self.under_way[writer] += 1
        try:
            await self.writers[writer].out.write(self.sample(writer))
        except WriteTimeout:
            pass
        except asyncio.CancelledError:
            return
        finally:
            self.under_way[writer] -= 1
        for wire in wires:
            wire.least += not wire.connector.closed

    async def do_write_from_thread(self) -> None:
        writer = self.random.randrange(3)
        for wire in self.live(writer):
            wire.most += 1
        assert self.writers[writer].out.write_from_thread(self.sample(writer))

    async def do_cancel(self) -> None:
        if self.tasks:
            self.random.choice(sorted(self.tasks, key=id)).cancel()

    def most_under_way(self, writer: int) -> int:
        return self.under_way[writer] + self.writers[writer].out.thread_writes.waiting

    def took(self, port: InPort[Any], sample: TimedLong, connector: Connector | None = None) -> None:
        source = port.last_source if connector is None else connector
        wire = next(each for each in self.wires if each.connector is source)
        data = sample.data - OFFSET * wire.converts
        written = self.written[wire.writer][data]
        assert not (wire.converts and unconvertible(data))
        if wire.lifespan is not None:
            # The life begins when the sample comes into the connector: a writer may have waited a second for that.
            assert self.kernel.clock.time() - written <= wire.lifespan + 1.0
        assert data not in wire.read
        wire.read.append(data)

    def port(self) -> InPort[TimedLong]:
        return self.random.choice(self.readers).inp

    async def do_read(self) -> None:
        port = self.port()
        try:
            sample = port.read_nowait()
        except WouldBlock:
            assert not port.is_new
            return
        self.took(port, sample)

    async def do_latest(self) -> None:
        port = self.port()
        if port.is_new:
            sample = port.latest
            assert sample is not None
            self.took(port, sample)

    async def do_drain(self) -> None:
        port = self.port()
        for connector, sample in port.drain(sources=True):
            self.took(port, sample, connector)

    async def do_peek(self) -> None:
        port = self.port()
        assert (port.peek() is not None) is port.is_new

    async def do_read_waiting(self) -> None:
        self.task(self._read(self.port()))

    async def _read(self, port: InPort[TimedLong]) -> None:
        with contextlib.suppress(ReadTimeout, BusyError, ClosedError):
            self.took(port, await port.read(timeout=self.random.choice((0.0, 0.05, 0.5))))

    async def do_wait_any(self) -> None:
        self.task(self._wait_any())

    async def _wait_any(self) -> None:
        try:
            ports = await wait_any(*(reader.inp for reader in self.readers), timeout=0.1)
        except (ReadTimeout, BusyError, ClosedError):
            return
        assert ports

    async def do_pass_time(self) -> None:
        await self.kernel.sleep(self.random.choice((0.0, 0.001, 0.01, 0.1, 0.4)))

    def options(self) -> dict[str, Any]:
        r = self.random
        kind = r.randrange(8)
        some: dict[str, Any] = {"allow_duplicate": True, "max_gap": r.choice((None, None, 0.05, 0.3))}
        some["convert"] = r.choice((None, None, plus))
        if kind == 0:
            return {**some, "length": 0, "timeout": 0.3}
        some["lifespan"] = r.choice((None, None, 0.02, 0.2))
        some["keep_last"] = r.random() < 0.3
        some["length"] = r.randint(1, 5)
        some["full"] = r.choice(("overwrite", "reject", "block"))
        some["timeout"] = 0.3
        if kind == 1:
            some |= {"subscription": "periodic", "push_rate": 20.0, "push": r.choice(("all", "fifo", "skip", "new"))}
        elif kind == 2:
            some |= {"subscription": "new", "push": r.choice(("all", "skip", "new")), "skip": 1}
        elif kind == 3:
            some |= {"dataflow": "pull"}
        return some

    async def do_connect(self) -> None:
        if len([wire for wire in self.wires if not wire.connector.closed]) > 8:
            return
        writer = self.random.randrange(3)
        target: InPort[Any] = self.port()
        options = {key: value for key, value in self.options().items() if value is not None and value is not False}
        connector = await self.kernel.connect(self.writers[writer].out, target, **options)
        wire = Wire(connector, writer, "convert" in options, options.get("lifespan"))
        wire.most += bool(options.get("keep_last")) + self.most_under_way(writer)
        self.wires.append(wire)

    async def do_connect_fused(self) -> None:
        for port in (self.fused.one, self.fused.two):
            if not port.connectors:
                writer = self.random.randrange(3)
                wire = Wire(await self.kernel.connect(self.writers[writer].out, port, length=3), writer, False, None)
                wire.most = self.most_under_way(writer)
                self.wires.append(wire)

    async def do_match(self) -> None:
        try:
            one, two = self.fused.pairs.match_nowait()
        except WouldBlock:
            return
        assert abs(one.tm - two.tm) <= 50_000_000

    async def do_disconnect(self) -> None:
        wires = [wire for wire in self.wires if not wire.connector.closed]
        if len(wires) > 2:
            await self.kernel.disconnect(self.random.choice(wires).connector)

    async def do_change(self) -> None:
        wires = [wire for wire in self.wires if not wire.connector.closed]
        if not wires:
            return
        connector, r = self.random.choice(wires).connector, self.random
        asked = r.choice(({"length": r.randint(1, 5)}, {"full": r.choice(("overwrite", "reject", "block"))}))
        if connector.profile.push_rate is not None and r.random() < 0.5:
            asked = {"push_rate": r.choice((5.0, 20.0, 100.0))}
        if connector.profile.length == 0 and asked != {"full": "block"}:
            with pytest.raises(WiringError):
                connector.change(**asked)  # type: ignore[arg-type]
            return
        connector.change(**asked)  # type: ignore[arg-type]

    async def do_switch(self) -> None:
        component = self.random.choice((*self.writers, *self.readers, self.fused, self.worker, self.asker))
        request = self.kernel.deactivate if self._is_active(component) else self.kernel.activate
        for wire in self.wires:  # what is kept is offered again to a reader that becomes active
            wire.most += wire.connector.profile.keep_last and wire.connector.in_ in component.ports.values()
        self.task(self._switch(request, component.name))

    def _is_active(self, component: Component) -> bool:
        return "active" in map(str, component.states.values())

    async def _switch(self, request: Any, component: Any) -> None:
        with contextlib.suppress(StateError, ClosedError):
            await request(component)

    async def do_tick(self) -> None:
        for context in (self.context, self.others):
            await context.tick()

    async def do_goal(self) -> None:
        self.offers += 1
        self.task(self._goal(self.random.randrange(100)))

    async def _goal(self, length: int) -> None:
        try:
            goal = await self.asker.worker.proxy.work(length)
            if length % 2:
                async for _ in goal:
                    pass
            await goal.result(timeout=self.random.choice((None, 0.3)))
        except (ServiceError, ValueError, StateError, BusyError):
            pass

    async def do_advance_goal(self) -> None:
        goals = [goal for goal in self.worker.goals if goal.state == "running"]
        if goals:
            goal = self.random.choice(goals)
            what = self.random.randrange(5)
            if goal.cancel_requested and what:
                goal.cancelled()
            elif what < 3:
                goal.feedback(what)
            elif what == 3:
                goal.succeed(3)
            else:
                goal.fail("no")

    # -- what must be true -----------------------------------------------------------------------------------------

    def check(self) -> None:
        if self.failures:
            raise self.failures[0]
        for wire in self.wires:
            counts = wire.connector.statistics
            assert counts.balanced
            assert counts.buffered >= 0
            assert wire.connector.in_ in (self.fused.one, self.fused.two) or counts.delivered == len(wire.read), wire
            assert wire.least <= counts.written <= wire.most, wire
            # Waiting writes come in when there is room, those of threads later; those made at once are in order.
            at_once = [number for number in wire.read if number in self.at_once]
            assert wire.connector.profile.keep_last or at_once == sorted(at_once), wire
        for writer in self.writers:
            threads = writer.out.thread_writes
            assert threads.accepted == threads.written + threads.waiting + sum(threads.dropped.values())
        assert all(counts.balanced for counts in self.fused.pairs.statistics.values())
        for end in (self.worker.service, self.asker.worker):
            goals = end.statistics.goals
            assert goals is None or (goals.balanced and goals.offered <= self.offers)


_WEIGHTS = {
    "write": 30, "write_waiting": 12, "write_from_thread": 3, "cancel": 3, "read": 16, "latest": 5, "drain": 4,
    "peek": 3,
    "read_waiting": 6, "wait_any": 2, "pass_time": 16, "connect": 6, "connect_fused": 1, "match": 4, "disconnect": 4,
    "change": 6, "switch": 3, "tick": 2, "goal": 3, "advance_goal": 6,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS))
def test_whatever_is_done_every_sample_is_read_once_or_counted(seed: int) -> None:
    async def main() -> Counter[str]:
        async with Kernel() as kernel:
            storm = Storm(kernel, seed)
            await storm.open()
            for _ in range(OPERATIONS):
                await storm.one()
                storm.check()
            for task in storm.tasks:
                task.cancel()
            await asyncio.gather(*storm.tasks, return_exceptions=True)
            await kernel.sleep(2.0)
            storm.check()
            return storm.done

    done = simulate(main(), seed=seed)
    assert sum(done.values()) == OPERATIONS
