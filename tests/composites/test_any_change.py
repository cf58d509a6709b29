"""Whatever is changed while everything runs: nobody runs twice or in two contexts, the order holds, ledgers balance."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import (
    AiortsError,
    Component,
    Composite,
    Connector,
    Context,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    SimulatedClock,
)
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import LENGTH, ORDERS

pytestmark = pytest.mark.row(99)

NAMES = "abcde"
LIFE = ("activate", "deactivate", "reset")
Change = tuple[Any, ...]


class Watched(Component):
    """Fails when it is entered twice; some of its hooks raise when told so."""

    input = InPort(TimedLong)
    output = OutPort(TimedLong)

    def __init__(self, name: str, diary: list[tuple[str, Context, int]]) -> None:
        super().__init__(name)
        self.diary = diary
        self.inside = 0
        self.refuses = False

    async def on_activated(self) -> None:
        await self.sleep(0.0003)
        if self.refuses:
            raise ValueError("refused")

    async def on_execute(self) -> None:
        self.inside += 1
        assert self.inside == 1
        assert len(self.contexts) == 1
        context = self.context
        assert self in context.members
        self.diary.append((self.name, context, context.ticks))
        for sample in self.input.drain():
            assert sample.data >= 0
        await self.sleep(0.0002)
        self.output.write_nowait(TimedLong(0, len(self.diary)))
        self.inside -= 1


members = st.lists(st.sampled_from(NAMES), unique=True, max_size=5)
changes = st.lists(
    st.one_of(
        st.tuples(st.just("members"), st.sampled_from(("one", "two")), members),
        st.tuples(st.just("order"), st.sampled_from(("one", "two")), st.sampled_from(("stated", "dataflow"))),
        st.tuples(st.just("groups"), st.sampled_from(("one", "two")), st.booleans()),
        st.tuples(st.just("refuses"), st.sampled_from(NAMES), st.booleans()),
        st.tuples(st.just("life"), st.sampled_from(("one", "two")), st.sampled_from(LIFE)),
        st.tuples(st.just("wait"), st.integers(0, 30)),
        st.tuples(st.just("both"), members, members),
        st.tuples(st.just("restart"), st.sampled_from(("one", "two"))),
    ),
    max_size=LENGTH,
)


async def play(clock: SimulatedClock, todo: list[Change]) -> None:
    diary: list[tuple[str, Context, int]] = []
    connectors: list[Connector] = []
    async with Kernel() as kernel:
        parts = {name: await kernel.add(Watched(name, diary)) for name in NAMES}
        outside = await kernel.add(Watched("outside", []))
        own = {name: await kernel.start(PeriodicContext(100.0, name=f"own_{name}"), parts[name]) for name in "ab"}
        await own["a"].activate()
        for writer, reader in ("ab", "bc", "de"):
            connectors.append(await kernel.connect(parts[writer].output, parts[reader].input))
        pairs = {
            name: await kernel.add(Composite(name, exported={"*.output": "{component}"}, errors="isolate"))
            for name in ("one", "two")
        }
        for name, pair in pairs.items():
            await kernel.start(PeriodicContext(200.0, name=f"loop_{name}"), pair)
        for step in todo:
            before, refused = seen(pairs), False
            try:
                await change(kernel, pairs, parts, step)
            except AiortsError:
                refused = step[0] in ("members", "order", "groups")
            assert not refused or seen(pairs) == before
            for pair in pairs.values():
                connectors += [
                    await kernel.connect(port, outside.input)
                    for port in pair.ports.values()
                    if all(connector.in_ is not outside.input for connector in port.connectors)
                ]
            check(pairs, parts)
        await asyncio.sleep(0.05)
        check(pairs, parts)
        assert [part.last_error for part in parts.values() if isinstance(part.last_error, AssertionError)] == []
        assert all(connector.statistics.balanced for connector in connectors)
    assert max(Counter(diary).values(), default=1) == 1  # nobody twice in one cycle
    assert all(connector.statistics.balanced for connector in connectors)


def seen(pairs: dict[str, Composite]) -> list[Any]:
    return [(pair.members, pair.parts, pair.order, dict(pair.ports), pair.context.members) for pair in pairs.values()]


async def change(kernel: Kernel, pairs: dict[str, Composite], parts: dict[str, Watched], step: Change) -> None:
    kind, *rest = step
    if kind == "members":
        await pairs[rest[0]].change(members=rest[1], groups="")
    elif kind == "order":
        await pairs[rest[0]].change(order=rest[1])
    elif kind == "groups":
        pair = pairs[rest[0]]
        await pair.change(groups="|".join(one.name for one in pair.members) if rest[1] else "")
    elif kind == "refuses":
        parts[rest[0]].refuses = rest[1]
    elif kind == "life":
        await getattr(pairs[rest[0]], rest[1])()
    elif kind == "wait":
        await asyncio.sleep(rest[0] / 1000)
    elif kind == "both":
        both = [pairs[name].change(members=those, groups="") for name, those in zip(("one", "two"), rest, strict=True)]
        for outcome in await asyncio.gather(*both, return_exceptions=True):
            assert outcome is None or isinstance(outcome, tuple | AiortsError), outcome
    else:
        pair = pairs[rest[0]]
        await pair.context.stop()
        await kernel.start(PeriodicContext(200.0, name=f"loop_{pair.name}"), pair, activate=True)


def check(pairs: dict[str, Composite], parts: dict[str, Watched]) -> None:
    for name, pair in pairs.items():
        assert pair.context.name == f"loop_{name}"
        assert pair.context.members == pair.parts
        assert sorted(part.name for part in pair.parts) == sorted(member.name for member in pair.members)
        assert dict(pair.ports) == {member.name: member.ports["output"] for member in pair.members}
        if pair.order == "stated":
            assert pair.parts == pair.members
        elif not pair.groups:
            names = [part.name for part in pair.parts]
            for writer, reader in ("ab", "bc", "de"):
                assert not {writer, reader} <= set(names) or names.index(writer) < names.index(reader)
    composed = {member for pair in pairs.values() for member in pair.members}
    for name, part in parts.items():
        assert len(part.contexts) == (1 if part in composed or name in "ab" else 0)
        if part not in composed and name in "ab":
            assert part.contexts[0].name == f"own_{name}"
            assert (part.state == "active") is (name == "a") or part.refuses or part.state == "error"


@pytest.mark.slow(kept_by="composites/test_shared_context.py::test_members_come_and_go_between_two_cycles_and_go_home")
@settings(
    max_examples=ORDERS,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
@given(changes, st.integers(0, ORDERS))
def test_any_changes_while_running_keep_order_and_ledger(todo: list[Change], seed: int) -> None:
    simulate(lambda clock: play(clock, todo), seed=seed)
