"""A composite in contexts of every kind; changes asked for by hooks, cancelled, too late; what exported ports cost."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import (
    Component,
    Composite,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    RealtimeContext,
    SimulatedClock,
    ThreadContext,
)
from aiorts.composites.composition import flow_order
from aiorts.errors import ComponentError, StateError, TransitionTimeout, WiringError
from aiorts.events import CompositeChanged
from aiorts.kernel.execution.context import Context
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


class Relay(Component):
    """Hands on what comes."""

    input = InPort(TimedDouble)
    output = OutPort(TimedDouble)

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.ran = 0

    def on_execute(self) -> None:
        self.ran += 1
        if (sample := self.input.latest) is not None:
            self.output.write_nowait(sample)


@pytest.mark.row(98, 99)
@pytest.mark.parametrize("make", [PeriodicContext, ThreadContext, RealtimeContext])
def test_a_composite_runs_and_changes_in_every_context_with_a_rate(make: type[Context]) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b, c = (Relay(name) for name in "abc")
            await kernel.add(c)
            own = await kernel.start(PeriodicContext(50.0, name="own"), c, activate=True)
            team = await kernel.add(Composite("team", a, b, exported={"*.output": "{component}"}))
            loop = await kernel.start(make(200.0), team, activate=True)  # type: ignore[call-arg]
            assert (team.state, loop.members) == (A, (a, b))
            await team.change(members=[c, a], timeout=None)
            assert (loop.members, own.members, b.contexts, c.state) == ((c, a), (), (), A)
            ran = c.ran
            await asyncio.sleep(0.1)
            assert c.ran > ran
            await team.remove_members(c, timeout=None)
            assert (loop.members, own.members, c.state) == ((a,), (c,), A)
            await team.deactivate()
            assert (team.state, c.state) == (I, A)
            await loop.stop()
            assert (team.state, team.contexts) == (None, ())

    simulate(main)


@pytest.mark.row(98)
def test_in_an_event_context_members_run_on_data_in_the_composites_order() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b = Relay("a"), Relay("b")
            team = await kernel.add(Composite("team", b, a, exported={"a.input": "input", "b.output": "output"}))
            source, sink = await kernel.add(Relay("source")), await kernel.add(Relay("sink"))
            await kernel.connect(source.output, kernel.find("team.input"))  # type: ignore[arg-type]
            await kernel.connect(a.output, b.input)
            await kernel.connect(kernel.find("team.output"), sink.input)  # type: ignore[arg-type]
            await kernel.start(EventContext(), team, activate=True)
            source.output.write_nowait(TimedDouble(0, 7.0))
            await asyncio.sleep(0.001)
            assert sink.input.read_nowait() == TimedDouble(0, 7.0)
            await team.change(members=[a, b])
            assert team.context.members == (a, b)
            assert sorted(member.order for member in team.context.runner.members) == [1, 2]

    simulate(main)


@pytest.mark.row(99)
def test_a_change_asked_for_by_a_members_hook_is_queued() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Leaves(Relay):
            async def on_execute(self) -> None:
                self.ran += 1
                assert await team.remove_members(self) == ()
                assert self in team.members

        async with Kernel() as kernel:
            heard: list[CompositeChanged] = []
            kernel.bus.subscribe(CompositeChanged, heard.append)
            a, b = Leaves("a"), Relay("b")
            team = await kernel.add(Composite("team", a, b))
            loop = await kernel.start(ExternalContext(), team, activate=True)
            await loop.tick()
            await asyncio.sleep(0.001)
            assert (team.members, loop.members, a.contexts) == ((b,), (b,), ())
            assert heard == [CompositeChanged("team", ("b",), (), ("a",), ())]

    simulate(main)


@pytest.mark.row(99)
def test_a_change_that_comes_too_late_is_nobodys_and_one_begun_is_seen_to_its_end() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Slow(Relay):
            async def on_execute(self) -> None:
                await self.sleep(3.0)

        class Starts(Relay):
            async def on_startup(self) -> None:
                await self.sleep(1.0)

        async with Kernel() as kernel:
            slow, c, d = Slow("slow"), Relay("c"), Starts("d")
            for one in (c, d):
                await kernel.add(one)
            own = await kernel.start(ExternalContext(name="own"), c, activate=True)
            team = await kernel.add(Composite("team", slow))
            loop = await kernel.start(ExternalContext(name="loop"), team, activate=True)
            tick = asyncio.ensure_future(loop.tick())
            await asyncio.sleep(0)
            with pytest.raises(TransitionTimeout):
                await team.add_members(c, timeout=0.5)
            assert (team.members, loop.members, own.members, c.state) == ((slow,), (slow,), (c,), A)
            await tick
            await team.add_members(d, timeout=0.5)  # begun in time
            assert (team.members, loop.members, d.state) == ((slow, d), (slow, d), A)
            asked = asyncio.ensure_future(team.add_members(c))
            await asyncio.sleep(0)
            asked.cancel()
            await asyncio.sleep(0.1)
            assert (team.members, loop.members) == ((slow, d, c), (slow, d, c))

    simulate(main)


@pytest.mark.row(100)
def test_activation_of_a_composite_is_all_or_none_unless_isolated() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Refuses(Relay):
            def on_activated(self) -> None:
                raise ValueError("no power")

        for errors, states in (("stop", (I, E, I)), ("report", (A, E, A)), ("isolate", (A, E, A))):
            async with Kernel() as kernel:
                parts = Relay("a"), Refuses("b"), Relay("c")
                team = await kernel.add(Composite("team", *parts, errors=errors))
                await kernel.start(ExternalContext(), team)
                with pytest.raises(ComponentError, match="b: on_activated raised ValueError: no power"):
                    await team.activate()
                assert tuple(part.state for part in parts) == states
                if errors == "stop":
                    with pytest.raises(StateError, match="cannot activate from error; reset it first"):
                        await team.activate()
                await team.reset()
                assert parts[1].state is I
                await team.deactivate()
                assert team.state is I

    simulate(main)


@pytest.mark.row(98)
def test_a_start_that_fails_leaves_members_in_their_own_contexts() -> None:
    async def main(clock: SimulatedClock) -> None:
        class Suspends(Relay):
            async def on_execute(self) -> None:
                await self.sleep(1.0)

        async with Kernel() as kernel:
            a, b = await kernel.add(Relay("a")), await kernel.add(Suspends("b"))
            own = await kernel.start(ExternalContext(name="own"), a, b, activate=True)
            team = await kernel.add(Composite("team", a, b))
            with pytest.raises(StateError):
                await kernel.start(ThreadContext(name="thread"), team)
            assert (own.members, a.state, b.state, team.state, list(kernel.contexts)) == ((a, b), A, A, None, ["own"])
            loop = await kernel.start(ExternalContext(name="loop"), team)
            with pytest.raises(StateError, match="team: runs in loop already"):
                await kernel.start(ExternalContext(), team)
            await loop.activate(team)
            assert team.state is A
            await loop.deactivate(team)
            await loop.remove(team)
            assert (loop.members, team.state) == ((), None)

    simulate(main)


@pytest.mark.row(98)
def test_the_exported_port_writes_as_the_members_own_without_a_hop() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, sink = Relay("a"), await kernel.add(Relay("sink"))
            inner = Composite("inner", a, exported=["a.output"])
            await kernel.add(Composite("outer", inner, exported={"inner.output": "command"}))
            exported = kernel.find("outer.command")
            await kernel.connect(exported, sink.input)  # type: ignore[arg-type]
            # No copy, no wrapper, no port in between: one object, one connector, on the fast path.
            assert exported is a.output
            assert len(a.output.connectors) == 1
            sample = TimedDouble(0, 1.0)
            exported.write_nowait(sample)  # type: ignore[union-attr]
            assert sink.input.read_nowait() is sample
            with pytest.raises(WiringError, match="already"):
                await kernel.connect(a.output, sink.input)

    simulate(main)


@pytest.mark.row(99)
def test_changes_at_the_same_time_are_made_one_after_the_other() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b, c = (Relay(name) for name in "abc")
            for one in (b, c):
                await kernel.add(one)
            team = await kernel.add(Composite("team", a))
            loop = await kernel.start(PeriodicContext(100.0), team, activate=True)
            await asyncio.gather(team.add_members(b), team.add_members(c), team.remove_members(a))
            assert (team.members, loop.members, a.contexts) == ((b, c), (b, c), ())

    simulate(main)


def test_what_stands_behind_a_loop_waits_for_it() -> None:
    assert flow_order("xab", [("a", "b"), ("b", "a"), ("b", "x")]) == ("a", "b", "x")
