"""A connector that gets other options, or is parked for a time, loses nothing by it, in virtual time."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from anyio import WouldBlock
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Connector, ExternalContext, Kernel
from aiorts.errors import ReadTimeout, WiringError, WriteTimeout
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.port import lock_all
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases, time_limit
from ports.parts import Sink, Source, long


def again(sample: TimedLong) -> TimedLong:
    return TimedLong(sample.tm, sample.data)


def odd(sample: TimedLong) -> TimedLong:
    if sample.data % 2 == 0:
        raise ValueError("even")
    return sample


KINDS: list[dict[str, Any]] = [
    {},
    {"subscription": "new", "push": "all"},
    {"subscription": "new", "push": "fifo"},
    {"subscription": "new", "push": "skip", "skip": 1},
    {"subscription": "new", "push": "new"},
    {"dataflow": "pull"},
    {"subscription": "periodic", "push": "all", "push_rate": 10, "out_length": 4},
    {"subscription": "periodic", "push": "fifo", "push_rate": 20, "out_length": 4},
    {"subscription": "periodic", "push": "skip", "skip": 1, "push_rate": 10, "out_length": 8},
    {"subscription": "periodic", "push": "new", "push_rate": 10},
    {"length": 0},
]
Wires = list[tuple[int, int, dict[str, Any]]]
Steps = list[tuple[str, int, Any, float]]
MORE: dict[str, Any] = {
    "full": st.sampled_from(["overwrite", "reject", "block", "block"]),
    "length": st.sampled_from([0, 1, 2, 3, 5]),
    "timeout": st.sampled_from([0.15, 1.0]),
    "lifespan": st.sampled_from([0.2, 1000.0]),
    "convert": st.sampled_from([again, odd]),
    "stamp": st.sampled_from(["send", "read", "received"]),
    "keep_last": st.just(True),
    "measure": st.just(3),
    "max_gap": st.just(0.3),
}
REASONS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "overwritten": lambda one: one.get("full", "overwrite") == "overwrite" or one.get("subscription") == "periodic",
    "rejected": lambda one: one.get("full") == "reject",
    "timeout": lambda one: one.get("timeout", 1.0) is not None,
    "skipped": lambda one: one.get("push") == "skip",
    "superseded": lambda one: one.get("push") == "new" or "dataflow" in one,
    "expired": lambda one: "lifespan" in one,
    "unconverted": lambda one: one.get("convert") is odd,
}
"""Which options let samples be dropped for it."""


@dataclass(eq=False)
class Link:
    """A connector, and what is known of it."""

    wire: Connector
    source: int
    sink: int
    options: list[dict[str, Any]]
    read: list[int] = field(default_factory=list)
    written: int = 0
    maybe: int = 0
    """Writes that were cancelled."""
    may_drop: set[str] = field(default_factory=set)

    @property
    def parked(self) -> bool:
        return self.wire.parked


class Bench:
    """The system."""

    def __init__(self, kernel: Kernel, *, locked: bool) -> None:
        self.kernel, self.locked = kernel, locked
        self.links: list[Link] = []
        self.number = 0
        self.source_of: dict[int, int] = {}
        """Of each sample."""
        self.writes: dict[asyncio.Task[bool], list[Link]] = {}
        self.reads: list[tuple[asyncio.Task[TimedLong], int]] = []
        self.removers: list[Callable[[], None]] = []

    async def build(self, wires: list[tuple[int, int, dict[str, Any]]]) -> None:
        self.sinks = [await self.kernel.add(Sink(f"sink{number}")) for number in range(2)]
        self.sources = [await self.kernel.add(Source(f"source{number}")) for number in range(2)]
        self.context = await self.kernel.start(ExternalContext(), *self.sinks, activate=True)
        for source, sink, options in wires:
            if not any((one.source, one.sink) == (source, sink) for one in self.links):
                try:
                    wire = await self.kernel.connect(self.sources[source].out, self.sinks[sink].inp, **options)
                except WiringError:
                    continue
                self.links.append(Link(wire, source, sink, [options]))
        if self.locked:
            for one in self.sinks:
                lock_all(one.inp)

    def fan(self, source: int) -> list[Link]:
        return [one for one in self.links if one.source == source and not one.parked and not one.wire.closed]

    async def do(self, operation: str, index: int, value: Any) -> None:
        link = self.links[index % len(self.links)]
        port = self.sinks[link.sink].inp
        source = self.sources[link.source]
        if operation == "write":
            for _ in range(value):
                sample = self.sample(link)
                try:
                    source.out.write_nowait(sample)
                except WouldBlock:
                    continue
                for one in self.fan(link.source):
                    one.written += 1
        elif operation == "wait":
            task = asyncio.create_task(source.out.write(self.sample(link)))
            self.writes[task] = self.fan(link.source)
        elif operation == "cancel":
            for task in list(self.writes)[:value]:
                task.cancel()
        elif operation == "read":
            for _ in range(value):
                if not any(sink == link.sink for _, sink in self.reads):
                    try:
                        self.took(port.read_nowait().data, link.sink)
                    except WouldBlock:
                        assert not port.is_new
        elif operation == "wait for one":
            if not any(sink == link.sink for _, sink in self.reads):
                self.reads.append((asyncio.create_task(port.read(timeout=0.2)), link.sink))
        elif operation == "stop waiting":
            for task, _ in self.reads:
                task.cancel()
        elif operation == "latest":
            if port.is_new:
                for one in self.links:
                    if one.sink == link.sink:
                        one.may_drop.add("superseded")
                self.took(port.latest.data, link.sink)
        elif operation == "drain":
            for wire, sample in port.drain(sources=True):
                assert wire is self.took(sample.data, link.sink).wire
        elif operation == "listen":
            if not link.wire.closed and not link.parked:
                self.removers.append(self.kernel.listen(link.wire, lambda event: None))
        elif operation == "unlisten":
            while self.removers:
                self.removers.pop()()
        elif operation == "renew":
            self.renew(link, value)
        elif operation == "park":
            self.unchanged(link, self.unpark if link.parked else self.kernel.connections.park)
        elif operation == "end" and (link.parked or value == 5):
            link.may_drop.add("disconnected")
            self.kernel.connections.end(link.wire)

    def sample(self, link: Link) -> TimedLong:
        self.number += 1
        self.source_of[self.number] = link.source
        return long(self.number)

    def unpark(self, wire: Connector) -> None:
        self.kernel.connections.unpark(wire)

    def renew(self, link: Link, options: dict[str, Any]) -> None:
        def renewed(wire: Connector) -> None:
            self.kernel.connections.replace_options(wire, options)

        if not link.parked and not link.wire.closed:
            before = link.wire.profile
            try:
                self.unchanged(link, renewed)
            except WiringError:
                assert link.wire.profile is before
            else:
                link.options.append(options)

    def unchanged(self, link: Link, change: Callable[[Connector], None]) -> None:
        """Nothing is dropped, read or reordered by a change, but where only the newest sample counts after it."""
        if link.wire.closed:
            return
        port, before = self.sinks[link.sink].inp, link.wire.statistics
        transport = transport_of(link.wire)
        waited = sum(not entry.done for entry in transport.waiting or ())
        peeked = port.peek()
        change(link.wire)
        after = link.wire.statistics
        assert after.delivered == before.delivered
        dropped = Counter(after.dropped) - Counter(before.dropped)
        # Those that were written longer ago than the new lifespan expire; the push policy has its say on who waited.
        profile = link.wire.profile
        newest = profile.dataflow == "pull" or (profile.subscription, profile.push) == ("new", "new")
        assert not dropped.keys() - {"expired", "skipped", *(["superseded"] if newest else [])}
        assert not newest or after.buffered <= 1
        assert dropped["skipped"] <= waited
        assert before.written <= after.written <= before.written + waited
        if peeked is not None and not dropped:
            assert port.peek() is peeked

    def took(self, number: int, sink: int) -> Link:
        (link,) = (one for one in self.links if one.sink == sink and self.source_of[number] == one.source)
        link.read.append(number)
        return link

    def check(self) -> None:
        for task, links in tuple(self.writes.items()):
            if task.done():
                del self.writes[task]
                cancelled = task.cancelled()
                if not cancelled:
                    assert task.exception() is None or isinstance(task.exception(), WriteTimeout)
                for one in links:
                    one.maybe += cancelled
                    one.written += not cancelled
        for entry in tuple(self.reads):
            if entry[0].done():
                self.reads.remove(entry)
                if not entry[0].cancelled() and entry[0].exception() is None:
                    self.took(entry[0].result().data, entry[1])
                elif not entry[0].cancelled():
                    assert isinstance(entry[0].exception(), ReadTimeout)
        pending = [one for links in self.writes.values() for one in links]
        for link in self.links:
            found = link.wire.statistics
            offered = transport_of(link.wire).offered
            assert found.balanced
            assert found.delivered == len(link.read), link.wire
            assert found.buffered >= 0
            assert link.written <= found.written - offered <= link.written + link.maybe + pending.count(link), link.wire
            assert link.read == sorted(set(link.read)), link.wire
            allowed = link.may_drop | {
                reason for reason, may in REASONS.items() if any(may(options) for options in link.options)
            }
            assert set(found.dropped) <= allowed, link.wire
        for number, sink in enumerate(self.sinks):
            unread = [len(transport_of(one.wire).queue) for one in self.links if one.sink == number]
            assert sink.inp.is_new == (sum(unread) > 0)
            assert (sink.inp.peek() is None) == (sum(unread) == 0)


def run(wires: Wires, steps: Steps, *, locked: bool) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            bench = Bench(kernel, locked=locked)
            await bench.build(wires)
            if not bench.links:
                return
            for operation, index, value, seconds in steps:
                await bench.do(operation, index, value)
                await kernel.sleep(seconds)
                for _ in range(6):
                    await asyncio.sleep(0)
                bench.check()
            for task, _ in bench.reads:
                task.cancel()
            for _ in range(200):
                await kernel.sleep(0.101)
                bench.check()
                for number in range(2):
                    for wire, sample in bench.sinks[number].inp.drain(sources=True):
                        assert wire is bench.took(sample.data, number).wire
                if not bench.writes and not any(one.wire.statistics.buffered for one in bench.links):
                    break
            bench.check()
            assert not bench.writes
            assert [one.wire for one in bench.links if one.wire.statistics.buffered and not one.parked] == []

    simulate(main())


OPTIONS = st.builds(
    lambda kind, more: {**more, **kind}, st.sampled_from(KINDS), st.fixed_dictionaries({}, optional=MORE)
)
WIRES = st.lists(st.tuples(st.integers(0, 1), st.integers(0, 1), OPTIONS), min_size=1, max_size=4)
SLEEPS = st.sampled_from((0.0, 0.0, 0.0, 0.0137, 0.1303, 0.4007))
OPERATIONS = st.tuples(
    st.sampled_from(
        (
            *("write", "write", "wait", "wait", "wait", "cancel", "read", "wait for one", "stop waiting"),
            *("latest", "drain", "listen", "unlisten", "park", "park", "end"),
        )
    ),
    st.integers(0, 3),
    st.sampled_from([1, 1, 2, 5]),
    SLEEPS,
)
RENEWALS = st.tuples(st.just("renew"), st.integers(0, 3), OPTIONS, SLEEPS)
STEPS = st.lists(st.one_of(OPERATIONS, OPERATIONS, RENEWALS), min_size=1, max_size=30)


@pytest.mark.slow(kept_by="test_writers_that_wait_go_on")
@pytest.mark.timeout(time_limit(600))
@pytest.mark.parametrize("locked", [False, True], ids=["plain", "locked"])
@settings(max_examples=cases(2_000), deadline=None)
@given(wires=WIRES, steps=STEPS)
def test_no_sample_is_lost_but_by_policy(locked: bool, wires: Wires, steps: Steps) -> None:
    run(wires, steps, locked=locked)


@pytest.mark.parametrize("length", [0, 2])
@pytest.mark.parametrize("options", [{}, {"length": 0}, {"length": 1, "full": "block"}, {"lifespan": 9.0}], ids=str)
def test_writers_that_wait_go_on(length: int, options: dict[str, Any]) -> None:
    steps: Steps = [*[("wait", 0, 1, 0.0)] * 4, ("renew", 0, options, 0.0), ("read", 0, 1, 0.0), ("wait", 0, 1, 0.0)]
    run([(0, 0, {"length": length, "full": "block"})], steps, locked=False)


def test_more_than_one_sample_makes_room_after_other_options_were_in_force() -> None:
    steps: Steps = [
        ("write", 0, 2, 0.0),
        ("renew", 0, {"subscription": "new", "push": "new", "stamp": "received"}, 0.0),
        ("write", 0, 2, 0.0),
    ]
    run([(0, 0, {}), (1, 0, {})], steps, locked=False)
