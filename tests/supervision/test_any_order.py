"""Whatever fails, whatever its owner asks meanwhile: who is helped comes back whole, in any order, or is given up."""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from aiorts import (
    AiortsError,
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    SimulatedClock,
    Supervision,
)
from aiorts.events import ComponentRecovered, RestartLimitReached
from aiorts.kernel.execution.cell import cell
from aiorts.testing import simulate
from aiorts.types import TimedLong
from campaign import LENGTH, ORDERS

NAMES = "abc"
HOOKS = ("on_execute", "on_activated", "on_deactivated", "on_reset", "on_initialize", "on_error")
ASKED = ("activate", "deactivate", "reset", "configure", "supervise", "reconnect", "trigger")

FAULTS = st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(HOOKS), st.integers(1, 6)), max_size=6)
ASKING = st.lists(st.tuples(st.sampled_from(ASKED), st.sampled_from(NAMES), st.integers(0, 25)), max_size=LENGTH)
Faults = list[tuple[str, str, int]]
Asking = list[tuple[str, str, int]]


class World:
    """What the instances of all components share: how often each hook ran, who is inside, what is to fail."""

    def __init__(self, faults: Faults) -> None:
        self.faults = set(faults)
        self.runs: Counter[tuple[str, str]] = Counter()
        self.inside: Counter[str] = Counter()
        self.twice: list[str] = []

    async def run(self, part: Part, hook: str, seconds: float) -> None:
        self.runs[part.name, hook] += 1
        self.inside[part.name] += 1
        if self.inside[part.name] > 1 and hook != "on_initialize":
            self.twice.append(f"{part.name}.{hook}")
        try:
            await part.sleep(seconds)
            if (part.name, hook, self.runs[part.name, hook]) in self.faults:
                raise RuntimeError(f"{part.name}.{hook}")
        finally:
            self.inside[part.name] -= 1


class Part(Component):
    """Takes its time in each hook, and fails where the world says so."""

    inp, out = InPort(TimedLong), OutPort(TimedLong)
    gain = Param(1.0)
    world: World

    def __init__(self, name: str, world: World) -> None:
        super().__init__(name)
        self.world = world

    async def on_initialize(self) -> None:
        await self.world.run(self, "on_initialize", 0.001)

    async def on_activated(self) -> None:
        await self.world.run(self, "on_activated", 0.002)

    async def on_deactivated(self) -> None:
        await self.world.run(self, "on_deactivated", 0.0)

    async def on_execute(self) -> None:
        self.inp.drain()
        await self.world.run(self, "on_execute", 0.001)
        self.out.write_nowait(TimedLong(0, self.world.runs[self.name, "on_execute"]))

    async def on_error(self, error: BaseException) -> None:
        await self.world.run(self, "on_error", 0.0)

    async def on_reset(self) -> None:
        await self.world.run(self, "on_reset", 0.001)


async def play(clock: SimulatedClock, actions: list[str], faults: Faults, asking: Asking) -> None:
    world, helped, given_up = World([]), list[ComponentRecovered](), list[RestartLimitReached]()
    async with Kernel() as kernel:
        kernel.bus.subscribe(ComponentRecovered, helped.append)
        kernel.bus.subscribe(RestartLimitReached, given_up.append)
        parts = [await kernel.add(Part(name, world)) for name in NAMES]
        for writer, reader in ("ab", "bc", "ca"):
            await kernel.connect(kernel.components[writer].ports["out"], kernel.components[reader].ports["inp"])
        periodic = await kernel.start(PeriodicContext(100.0), *parts[:2], activate=True)
        events = await kernel.start(EventContext(), parts[2], activate=True)

        def supervise(name: str) -> None:
            policy = Supervision(actions[NAMES.index(name)], budget=3, backoff=0.004, window=0.5)
            kernel.supervise(kernel.components[name], policy, factory=lambda name: Part(name, world))

        async def ask(what: str, name: str) -> None:
            part = kernel.components[name]
            if what == "supervise":
                supervise(name)
            elif what == "configure":
                await part.configure(gain=2.0)
            elif what == "trigger":
                events.trigger()
            elif what == "reconnect":
                for connector in part.ports["out"].connectors:
                    await kernel.disconnect(connector)
                after = NAMES[(NAMES.index(name) + 1) % 3]
                await kernel.connect(part.ports["out"], kernel.components[after].ports["inp"])
            else:
                await getattr(events if name == "c" else periodic, what)(part)

        async def tried(what: str, name: str) -> None:
            with suppress(AiortsError, KeyError):
                await ask(what, name)

        for name in NAMES:
            supervise(name)
        world.faults = set(faults)
        world.runs.clear()
        tasks = []
        for what, name, pause in asking:
            tasks.append(asyncio.create_task(tried(what, name)))
            await kernel.sleep(pause / 1000)
        await asyncio.gather(*tasks)
        await kernel.sleep(0.3)  # nobody fails any more: who can be helped has been helped
        world.faults.clear()

        assert world.twice == []
        for name, one in kernel.supervised.items():
            part = kernel.components[name]
            assert one.component is part
            (context,) = part.contexts
            assert context is (events if name == "c" else periodic)
            assert part in context.members
            assert one._task is None
            assert one._place is None
            assert cell(part).entry_lock.open
            assert one.exhausted or part.state is not LifecycleState.ERROR
            assert one.attempts <= 3 or not one.exhausted
        gone = set(NAMES) - set(kernel.components)
        assert gone <= {event.component for event in given_up}
        assert not kernel.registry.tasks
        live = {port for part in kernel.components.values() for port in part.ports.values()}
        for connector in kernel.connectors.values():
            assert connector.statistics.balanced
            assert {connector.out, connector.in_} <= live
        pairs = Counter((connector.out, connector.in_) for connector in kernel.connectors.values())
        assert not pairs or max(pairs.values()) == 1
        if not gone:
            assert len(kernel.connectors) == 3


@pytest.mark.slow(
    kept_by="supervision/test_whole_restart.py::test_two_that_fail_together_are_connected_as_before_and_not_twice"
)
@pytest.mark.fault("A18")
@settings(max_examples=ORDERS, suppress_health_check=[HealthCheck.too_slow])
@example(  # `c` was supervised anew in the midst of its restart, and was gone
    ["reset", "reset", "restart"],
    [("a", "on_execute", 4), ("c", "on_activated", 1), ("a", "on_execute", 1), ("c", "on_execute", 2)],
    [("activate", "a", 23), ("activate", "a", 6), ("activate", "a", 4), ("activate", "a", 3), ("supervise", "c", 0)],
    0,
)
@given(st.lists(st.sampled_from(["reset", "restart"]), min_size=3, max_size=3), FAULTS, ASKING, st.integers(0, ORDERS))
def test_who_is_helped_comes_back_whole_or_is_given_up(
    actions: list[str], faults: Faults, asking: Asking, seed: int
) -> None:
    simulate(lambda clock: play(clock, actions, faults, asking), seed=seed)
