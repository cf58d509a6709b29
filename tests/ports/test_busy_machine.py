"""A chain with default connectors loses nothing because the machine is busy, and what is lost is said."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.types import TimedLong
from campaign import CAMPAIGN, cases

pytestmark = pytest.mark.slow

RELAYS = 8
NOTHING: frozenset[int] = frozenset()


class Relay(Component):
    """Hands one sample on in each cycle. Some cycles leave others a turn, so that there is more than one sample to
    take; some take long, as they do where the machine is busy."""

    inp, out = InPort(TimedLong), OutPort(TimedLong)
    gives_way = takes_long = NOTHING
    runs = 0

    async def on_execute(self) -> None:
        self.runs += 1
        if self.runs in self.gives_way:
            await asyncio.sleep(0)
        if self.runs in self.takes_long:
            time.sleep(0.012)
        self.out.write_nowait(await self.inp.read())


class Last(Component):
    """Counts what came."""

    inp = InPort(TimedLong)
    count = 0

    async def on_execute(self) -> None:
        self.count += len(self.inp.drain())


class Ticker(Component):
    """Keeps the loop's timer queue at work."""

    def on_execute(self) -> None:
        """There is nothing to do."""


async def relayed(
    count: int,
    takes_long: frozenset[int] = NOTHING,
    gives_way: Sequence[frozenset[int]] = (NOTHING,) * RELAYS,
    rate: float | None = None,
) -> list[Mapping[str, int]]:
    """What the nine connectors of a chain of eight relays dropped of `count` samples, written four at a time."""
    async with Kernel() as kernel:
        source, last = await kernel.create(Relay, "source"), await kernel.create(Last, "last")
        relays = [await kernel.create(Relay, f"relay{number}") for number in range(RELAYS)]
        made = [await kernel.connect(one.out, two.inp) for one, two in pairwise([source, *relays])]
        made.append(await kernel.connect(relays[-1].out, last.inp))
        for number, one in enumerate(relays):
            one.gives_way = gives_way[number]
            one.takes_long = frozenset(cycle for cycle in takes_long if cycle % RELAYS == number)
        for member in (*relays, last):
            await kernel.start(EventContext(), member, activate=True)
        if rate is not None:
            await kernel.start(PeriodicContext(rate), await kernel.create(Ticker, "ticker"), activate=True)
        async with asyncio.timeout(100.0):
            for number in range(0, count, 4):
                for offset in range(4):
                    source.out.write_nowait(TimedLong(0, number + offset))
                while relays[0].inp.is_new:
                    await asyncio.sleep(0)
            while last.count + sum(sum(one.statistics.dropped.values()) for one in made) < count:
                await asyncio.sleep(0)
        return [one.statistics.dropped for one in made]


@pytest.mark.campaign
@hypothesis_settings(max_examples=max(cases(500), 10))
@given(
    st.frozensets(st.integers(1, 200), max_size=20),
    st.lists(st.frozensets(st.integers(1, 200), max_size=3), min_size=RELAYS, max_size=RELAYS),
    st.sampled_from([None, 200.0, 1000.0]),
)
def test_cycles_that_take_long_lose_nothing(
    takes_long: frozenset[int], gives_way: list[frozenset[int]], rate: float | None
) -> None:
    """How long a cycle took is no reason to rest: it may have been preempted, and its writers go on."""
    assert asyncio.run(relayed(200, takes_long, gives_way, rate)) == [{}] * (RELAYS + 1)


@contextlib.contextmanager
def busy(processes: int, seconds: float) -> Iterator[None]:
    """So many processes that spin, for so long at the most."""
    code = f"import time\nend = time.monotonic() + {seconds}\nwhile time.monotonic() < end: pass"
    running = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


@pytest.mark.campaign
@pytest.mark.timeout(120)
@pytest.mark.parametrize("run", range(20 if CAMPAIGN else 1))
def test_a_chain_beside_three_busy_processes_loses_nothing(run: int) -> None:
    with busy(3, 60.0):
        assert asyncio.run(relayed(3_000)) == [{}] * (RELAYS + 1)
