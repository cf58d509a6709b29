"""Event contexts with `every`: when a member runs that has no other cause, and what that keeps going."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext, SimulatedClock
from aiorts.errors import ConfigurationError
from aiorts.system import wait_finished
from aiorts.testing import simulated
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases
from contexts.parts import MS, Sender


class Noting(Component):
    """Notes when it runs, in milliseconds, and what it reads."""

    input = InPort(TimedLong)

    def __init__(self, name: str | None = None, takes: float = 0.0) -> None:
        super().__init__(name)
        self.takes = takes
        self.runs: list[tuple[int, int]] = []

    async def on_execute(self) -> None:
        self.runs.append((self.clock.monotonic_ns() // MS, len(self.input.drain())))
        if self.takes:
            await self.sleep(self.takes)


@simulated
async def test_a_member_without_data_runs_so_often_and_data_puts_the_next_run_off() -> None:
    async with Kernel() as kernel:
        noting, sender = await kernel.add(Noting()), await kernel.add(Sender("sender"))
        await kernel.connect(sender.output, noting.input)
        context = await kernel.start(EventContext(every=0.1), noting, activate=True)
        await asyncio.sleep(0.25)
        sender.send(1, 2)
        await asyncio.sleep(0.25)
        assert noting.runs == [(100, 0), (200, 0), (250, 2), (350, 0), (450, 0)]
        context.trigger()
        await asyncio.sleep(0.12)
        assert noting.runs[5:] == [(500, 0), (600, 0)]
        assert context.statistics.cycles == 7


@simulated
async def test_it_is_counted_for_each_member_from_its_own_activation_and_only_while_it_is_active() -> None:
    async with Kernel() as kernel:
        one, two = await kernel.add(Noting("one")), await kernel.add(Noting("two"))
        context = await kernel.start(EventContext(every=0.1), one, two)
        await asyncio.sleep(0.5)
        await context.activate(two)
        await asyncio.sleep(0.05)
        await context.activate(one)
        await asyncio.sleep(0.2)
        await context.deactivate(two)
        await asyncio.sleep(0.1)
        assert one.runs == [(650, 0), (750, 0), (850, 0)]
        assert two.runs == [(600, 0), (700, 0)]
        await context.remove(one)
        await context.activate(two)
        await asyncio.sleep(0.15)
        assert one.runs[3:] == []
        assert two.runs[2:] == [(950, 0)]


@simulated
async def test_a_missed_run_is_not_caught_up() -> None:
    async with Kernel() as kernel:
        slow = await kernel.add(Noting(takes=0.25))
        await kernel.start(EventContext(every=0.1), slow, activate=True)
        await asyncio.sleep(0.9)
        assert slow.runs == [(100, 0), (350, 0), (600, 0), (850, 0)]


@simulated
async def test_a_member_in_error_is_not_run_for_it() -> None:
    class Failing(Noting):
        async def on_execute(self) -> None:
            await super().on_execute()
            raise ValueError("as planned")

    async with Kernel() as kernel:
        failing = await kernel.add(Failing())
        context = await kernel.start(EventContext(every=0.1), failing, activate=True)
        await asyncio.sleep(0.55)
        assert failing.runs == [(100, 0)]
        await context.reset()
        await context.activate()
        await asyncio.sleep(0.15)
        assert failing.runs == [(100, 0), (650, 0)]


@pytest.mark.parametrize("takes", [0.0, 0.35])
@simulated
async def test_a_run_of_finite_data_still_ends(takes: float) -> None:
    class Source(Component):
        output = OutPort(TimedLong)
        left = 3

        def on_execute(self) -> None:
            self.output.write_nowait(TimedLong(0, self.left))
            self.left -= 1
            if not self.left:
                self.finish()

    async with Kernel() as kernel:
        noting, source = await kernel.add(Noting(takes=takes)), await kernel.add(Source())
        await kernel.connect(source.output, noting.input)
        await kernel.start(EventContext(every=0.1), noting, activate=True)
        await kernel.start(PeriodicContext(10.0), source, activate=True)
        assert await asyncio.wait_for(wait_finished(kernel), 60.0) == ()
        assert sum(count for _, count in noting.runs) == 3


@pytest.mark.parametrize("every", [0, -1.0, 0.00001, math.nan, math.inf, True, "0.1"])
def test_what_is_no_length_of_time_is_refused_with_its_key(every: Any) -> None:
    with pytest.raises(ConfigurationError, match=r"watch: every = .*: expected seconds from 0\.0001 on"):
        EventContext(every=every, name="watch")


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("send"), st.integers(0, 2)),
        st.tuples(st.just("trigger"), st.integers(0, 2)),
        st.tuples(st.just("switch"), st.integers(0, 2)),
        st.tuples(st.just("pass"), st.integers(1, 25)),
    ),
    max_size=30,
)


@pytest.mark.slow(kept_by="test_a_member_without_data_runs_so_often_and_data_puts_the_next_run_off")
@settings(max_examples=cases(5_000), deadline=None)
@given(STEPS, st.integers(0, 1_000_000))
def test_any_members_run_as_in_a_model(steps: list[tuple[str, int]], seed: int) -> None:
    """The model goes on millisecond by millisecond: a member is due 10 ms after it ran last or was activated."""

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            members = [await kernel.add(Noting(f"m{number}")) for number in range(3)]
            senders = [await kernel.add(Sender(f"s{number}")) for number in range(3)]
            for sender, member in zip(senders, members, strict=True):
                await kernel.connect(sender.output, member.input)
            context = await kernel.start(EventContext(every=0.01), *members)
            due: list[int | None] = [None, None, None]
            expected: list[list[tuple[int, int]]] = [[], [], []]
            now = 0
            for verb, what in steps:
                was = due[what % 3]
                if verb == "pass":
                    for moment in range(now + 1, now + what + 1):
                        for number in range(3):
                            if due[number] == moment:
                                expected[number].append((moment, 0))
                                due[number] = moment + 10
                    now += what
                    await asyncio.sleep(what / 1000)
                elif verb == "switch":
                    due[what] = now + 10 if was is None else None
                    await (context.activate if was is None else context.deactivate)(members[what])
                else:
                    senders[what].send(1) if verb == "send" else context.trigger(members[what])
                    if was is not None:
                        expected[what].append((now, int(verb == "send")))
                        due[what] = now + 10
                    await asyncio.sleep(0)
                for _ in range(10):
                    await asyncio.sleep(0)
            assert [member.runs for member in members] == expected

    simulate(main, seed=seed)
