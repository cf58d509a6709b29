"""A composite in a composite runs in its place; with a schedule of its own it runs apart; and everything ends."""

from __future__ import annotations

import pytest

from aiorts import (
    Component,
    Composite,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    SimulatedClock,
    ThreadContext,
)
from aiorts.errors import StateError, WiringError
from aiorts.kernel.loop.bus import StateChanged
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


class Part(Component):
    """Notes that it ran."""

    input = InPort(TimedDouble)
    output = OutPort(TimedDouble)

    def __init__(self, name: str, diary: list[str]) -> None:
        super().__init__(name)
        self.diary = diary
        self.fails = False

    def on_execute(self) -> None:
        self.diary.append(self.name)
        if self.fails:
            raise ValueError(self.name)


@pytest.mark.row(98, 99)
def test_nested_composites_run_in_their_place_and_ports_reach_through() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            a, b, c, d, e = (Part(name, diary) for name in "abcde")
            inner = Composite("inner", b, c, exported={"c.output": "out"})
            outer = await kernel.add(Composite("outer", a, inner, d, exported={"inner.out": "result"}))
            assert kernel.find("outer.result") is kernel.find("inner.out") is c.output
            loop = await kernel.start(ExternalContext(), outer, activate=True)
            await loop.tick()
            assert diary == ["a", "b", "c", "d"]
            assert (outer.members, outer.parts, inner.context, inner.state) == ((a, inner, d), (a, b, c, d), loop, A)
            await kernel.add(e)
            await inner.change(members=[c, e, b])
            diary.clear()
            await loop.tick()
            assert diary == ["a", "c", "e", "b", "d"]
            reader = await kernel.add(Part("reader", []))
            connector = await kernel.connect(c.output, reader.input)
            assert await inner.remove_members(c) == (connector,)
            assert connector.closed
            assert (dict(inner.ports), dict(outer.ports), c.contexts) == ({}, {}, ())
            with pytest.raises(StateError, match="outer: would be a member of itself"):
                await inner.add_members(outer)
            with pytest.raises(StateError, match="a: is a member of outer, which says where it runs"):
                await kernel.start(ExternalContext(), a)
            with pytest.raises(StateError, match="a: cannot leave: it is a member of outer"):
                await loop.remove(a)

    simulate(main)


@pytest.mark.row(98)
def test_one_with_its_own_schedule_runs_apart() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            a, b, c = (Part(name, diary) for name in "abc")
            inner = Composite("inner", b, own_schedule=True, exported=["b.output"])
            outer = await kernel.add(Composite("outer", a, inner, c, exported=["inner.output"]))
            slow = await kernel.start(ExternalContext(name="slow"), outer, activate=True)
            fast = await kernel.start(ExternalContext(name="fast"), inner, activate=True)
            await slow.tick()
            await fast.tick(2)
            assert diary == ["a", "c", "b", "b"]
            assert (slow.members, fast.members, list(outer.ports)) == ((a, c), (b,), ["output"])

    simulate(main)


@pytest.mark.row(30, 98, 100)
@pytest.mark.parametrize("errors", ["stop", "report", "isolate"])
def test_one_whose_members_all_run_apart_is_what_they_are_together(errors: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b, c = (Part(name, []) for name in "abc")
            left, right = Composite("left", a, own_schedule=True), Composite("right", b, c, own_schedule=True)
            outer = await kernel.add(Composite("outer", left, right, errors=errors))
            seen: list[tuple[str, LifecycleState]] = []
            kernel.bus.subscribe(
                StateChanged,
                lambda event: seen.append((event.context, event.new)) if event.component == "outer" else None,
            )
            assert (outer.state, dict(outer.states)) == (None, {})
            with pytest.raises(
                StateError, match="outer: each member has a schedule of its own; start left, right, each"
            ):
                await kernel.start(ExternalContext(), outer)
            one = await kernel.start(ExternalContext(name="one"), left, activate=True)
            two = await kernel.start(ThreadContext(10.0, name="two"), right, activate=True)
            assert (outer.state, seen) == (A, [("one", A)])
            await outer.deactivate()
            assert [part.state for part in (outer, a, b, c)] == [I, I, I, I]
            await kernel.activate("outer")
            a.fails = True
            await one.tick()
            await kernel.sleep(1.0)
            whole, others = {"stop": (E, I), "report": (E, A), "isolate": (A, A)}[errors]
            assert [part.state for part in (outer, a, b, c)] == [whole, E, others, others]
            assert (dict(outer.states), seen[-1][1]) == ({"one": whole, "two": whole}, whole)
            a.fails = False
            await outer.reset()
            await outer.activate()
            assert [part.state for part in (outer, a, b, c)] == [A, A, A, A]
            await two.stop()
            assert (outer.state, dict(outer.states)) == (A, {"one": A})

    simulate(main)


@pytest.mark.row(100)
def test_the_kernel_asks_for_all_or_none_of_it_as_it_does_itself() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b = (Part(name, []) for name in "ab")
            arm = await kernel.add(Composite("arm", a, b))
            context = await kernel.start(ExternalContext(name="loop"), arm, activate=True)
            b.fails = True
            await context.tick()
            b.fails = False
            assert [part.state for part in (arm, a, b)] == [E, I, E]
            for named in (None, "loop"):
                with pytest.raises(StateError, match="arm in loop: cannot activate from error; reset it first"):
                    await kernel.activate("arm", context=named)
                assert [part.state for part in (arm, a, b)] == [E, I, E]
            await kernel.reset("arm")
            await kernel.activate("arm")
            assert [part.state for part in (arm, a, b)] == [A, A, A]

    simulate(main)


@pytest.mark.row(100)
def test_an_error_goes_out_as_far_as_the_policies_say() -> None:
    async def main(clock: SimulatedClock) -> None:
        for errors, whole, neighbour in (("isolate", A, A), ("stop", E, I)):
            async with Kernel() as kernel:
                a, b, c = (Part(name, []) for name in "abc")
                inner = Composite("inner", b, c, errors=errors)
                outer = await kernel.add(Composite("outer", a, inner))
                loop = await kernel.start(ExternalContext(), outer, activate=True)
                b.fails = True
                await loop.tick()
                assert (inner.state, outer.state, a.state, c.state) == (whole, whole, neighbour, neighbour)

    simulate(main)


@pytest.mark.row(98)
@pytest.mark.parametrize("first", ["outer", "inner", "b", "a", "kernel"])
@pytest.mark.parametrize("running", [False, True])
def test_composites_go_in_any_order_and_leave_nothing_behind(first: str, running: bool) -> None:
    # The exit of a composite killed OpenRTM's process (OpenRTM-aist#182).
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b, c = (Part(name, []) for name in "abc")
            await kernel.add(b)
            own = await kernel.start(ExternalContext(name="own"), b)
            inner = Composite("inner", b, c, exported={"*.output": "{component}"})
            outer = await kernel.add(Composite("outer", a, inner, exported=["inner.b"]))
            if running:
                loop = await kernel.start(ExternalContext(name="loop"), outer, activate=True)
                await loop.tick()
            if first == "kernel":
                return
            await kernel.remove(kernel.components[first])
            assert first not in kernel.components
            if first != "b" and "b" not in (part.name for part in outer.parts):
                assert b.contexts == (own,)
            if first == "b":
                assert (dict(outer.ports), list(inner.ports)) == ({}, ["c"])
            for name in tuple(kernel.components):
                await kernel.remove(kernel.components[name])
            assert dict(kernel.components) == {}
            assert own.members == ()

    simulate(main)


@pytest.mark.row(98)
def test_ports_that_come_and_go_are_exported_at_once_or_refused() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a, b = Part("a", []), Part("b", [])
            team = await kernel.add(Composite("team", a, b, exported={"*.out*": "{port}", "b.output": "other"}))
            port = a.add_port("out2", OutPort(TimedDouble))
            assert kernel.find("team.out2") is port
            with pytest.raises(WiringError, match=r"a.out2 and b.out2 would both be exported as 'out2'"):
                b.add_port("out2", OutPort(TimedDouble))
            assert "out2" not in b.ports
            a.remove_port("out2")
            assert list(team.ports) == ["output", "other"]
            assert b.add_port("out2", OutPort(TimedDouble)) is team.ports["out2"]

    simulate(main)


def test_dataflow_puts_writers_before_readers() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            a, b, c = (Part(name, diary) for name in "abc")
            team = await kernel.add(Composite("team", a, b, c, order="dataflow"))
            await kernel.connect(c.output, b.input)
            await kernel.connect(b.output, a.input)
            loop = await kernel.start(ExternalContext(), team, activate=True)
            await loop.tick()
            assert diary == ["c", "b", "a"]
            await kernel.connect(a.output, c.input)  # a loop: cut where it was stated first
            await team.change(order="dataflow")
            assert loop.members == (a, c, b)
            await team.change(order="stated")
            assert loop.members == (a, b, c)

    simulate(main)
