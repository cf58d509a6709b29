"""A composite is seen as one component and as its members: one context, one order, its ports are theirs."""

from __future__ import annotations

import asyncio

import pytest

from aiorts import (
    Component,
    Composite,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    SimulatedClock,
)
from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError, StateError, WiringError
from aiorts.events import PortAdded, PortRemoved, StateChanged
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

I, A, E = LifecycleState.INACTIVE, LifecycleState.ACTIVE, LifecycleState.ERROR  # noqa: E741


class Step(Component):
    """Adds one to what comes, and notes that it ran."""

    input = InPort(TimedDouble)
    output = OutPort(TimedDouble)

    def __init__(self, name: str, diary: list[str] | None = None) -> None:
        super().__init__(name)
        self.diary: list[str] = [] if diary is None else diary
        self.fails: Exception | None = None

    def on_execute(self) -> None:
        self.diary.append(self.name)
        if self.fails is not None:
            raise self.fails
        sample = self.input.latest
        self.output.write_nowait(TimedDouble(0, 1.0 + (0.0 if sample is None else sample.data)))

    def on_activated(self) -> None:
        self.diary.append(f"{self.name} activated")

    def on_deactivated(self) -> None:
        self.diary.append(f"{self.name} deactivated")


def steps(diary: list[str], *names: str) -> list[Step]:
    return [Step(name, diary) for name in names]


@pytest.mark.row(98)
def test_members_share_a_context_in_their_order_and_leave_their_own() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            a, b, c = steps(diary, "a", "b", "c")
            await kernel.add(b)
            own = await kernel.start(ExternalContext(name="own"), b, activate=True)
            arm = await kernel.add(Composite("arm", a, b, c))
            assert list(kernel.components) == ["b", "arm", "a", "c"]
            assert (arm.state, b.contexts) == (None, (own,))
            loop = await kernel.start(PeriodicContext(100.0, name="loop"), arm, activate=True)
            assert (own.members, loop.members) == ((), (a, b, c))
            assert (arm.context, arm.state, dict(arm.states)) == (loop, A, {"loop": A})
            diary.clear()
            await asyncio.sleep(0.025)
            assert diary[:6] == ["a", "b", "c"] * 2
            assert loop.profile.members == arm.profile.members == ("a", "b", "c")

    simulate(main)


@pytest.mark.row(98)
def test_an_exported_port_is_the_members_port_under_another_name() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            heard: list[tuple[str, str]] = []
            kernel.bus.subscribe(PortAdded, lambda event: heard.append((event.component, event.port.name)))
            a, b = steps([], "a", "b")
            reader = await kernel.add(Step("reader"))
            arm = await kernel.add(Composite("arm", a, b, exported={"*.output": "{component}_out", "a.input": "start"}))
            assert list(arm.ports) == ["start", "a_out", "b_out"]
            assert kernel.find("arm.b_out") is kernel.find("b.output") is b.output
            assert [port.name for port in arm.profile.ports] == ["start", "a_out", "b_out"]
            assert [name for whose, name in heard if whose == "arm"] == ["start", "a_out", "b_out"]
            connector = await kernel.connect(kernel.find("arm.b_out"), reader.input)  # type: ignore[arg-type]
            assert connector.profile.ports == ("b.output", "reader.input")
            b.output.write_nowait(TimedDouble(0, 3.0))
            assert reader.input.read_nowait() == TimedDouble(0, 3.0)

    simulate(main)


@pytest.mark.row(98)
def test_unknown_members_and_ports_are_refused_by_name() -> None:
    # OpenRTM looks names up and silently leaves out the ones there are not.
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            a = await kernel.add(Step("a"))
            with pytest.raises(StateError, match="no component 'b0', 'c0'; there are a"):
                await kernel.add(Composite("arm", a, "b0", "c0"))
            with pytest.raises(WiringError, match=r"exported 'a.outptu': no such port.*a.input, a.output"):
                await kernel.add(Composite("arm", a, exported=["a.outptu"]))
            with pytest.raises(WiringError, match=r"a.output and b.output would both be exported as 'output'"):
                await kernel.add(Composite("arm", a, Step("b"), exported=["*.output"]))
            with pytest.raises(StateError, match="a given twice"):
                await kernel.add(Composite("arm", a, "a"))
            # Nothing of it stays: who came with the composite went with it.
            assert list(kernel.components) == ["a"]
            await kernel.add(Composite("arm", "a", exported="a.output"))
            assert kernel.find("arm.output") is a.output
            with pytest.raises(StateError, match="a: is a member of arm already"):
                await kernel.add(Composite("other", a))

    simulate(main)


@pytest.mark.parametrize(
    ("exported", "says"),
    [
        (["a"], "expected component.port"),
        (["a.b.c"], "expected component.port"),
        ({"a.b": "{x}"}, "only {component} and {port}"),
        ({"a.b": "{"}, "exported 'a.b'"),
        ({"a.b": "x.y"}, "not allowed"),
        ({"a.b": 3}, "expected a name, got 3"),
        ([3], "expected component.port"),
    ],
)
def test_rules_that_cannot_be_read_are_refused(exported: object, says: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Composite("arm", exported=exported)  # type: ignore[arg-type]
    assert says in str(caught.value)
    assert "arm" in str(caught.value)


def test_a_composite_has_no_hooks_and_ports_of_its_own() -> None:
    with pytest.raises(DeclarationError, match="on_execute: a composite is not run itself"):

        class Runs(Composite):
            def on_execute(self) -> None: ...

    with pytest.raises(DeclarationError, match="out: a composite has its members' ports only"):

        class Sends(Composite):
            out = OutPort(TimedDouble)

    with pytest.raises(StateError, match="members' ports only"):
        Composite("arm").add_port("x", OutPort(TimedDouble))
    for wrong in ({"order": "random"}, {"errors": "ignore"}):
        with pytest.raises(ConfigurationError):
            Composite("arm", **wrong)  # type: ignore[arg-type]
    with pytest.raises(InvalidNameError):
        Composite("a.b")
    with pytest.raises(DeclarationError, match="got 3"):
        Composite("arm", 3)  # type: ignore[arg-type]


@pytest.mark.row(98)
def test_a_wrapper_is_a_composite_of_one() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            wrapped = await kernel.add(Composite("wrapped", Step("inner"), exported={"inner.output": "command"}))
            loop = await kernel.start(ExternalContext(), wrapped)
            assert wrapped.state is I
            await wrapped.activate()
            await loop.tick()
            assert (wrapped.state, list(wrapped.ports)) == (A, ["command"])
            await wrapped.deactivate()
            assert wrapped.state is I

    simulate(main)


@pytest.mark.row(99)
def test_members_come_and_go_between_two_cycles_and_go_home() -> None:
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            a, b, c = steps(diary, "a", "b", "c")
            await kernel.add(c)
            own = await kernel.start(ExternalContext(name="own"), c, activate=True)
            arm = await kernel.add(Composite("arm", a, b, exported={"*.output": "{component}_out"}))
            reader = await kernel.add(Step("reader"))
            loop = await kernel.start(ExternalContext(name="loop"), arm, activate=True)
            await arm.add_members(c)
            assert (loop.members, own.members, c.state) == ((a, b, c), (), A)
            connector = await kernel.connect(arm.ports["c_out"], reader.input)
            inner = await kernel.connect(c.output, a.input)
            await loop.tick()
            gone: list[str] = []
            kernel.bus.subscribe(PortRemoved, lambda event: gone.append(f"{event.component}.{event.port.name}"))
            ended = await arm.remove_members("c")
            assert ended == (connector,)
            assert (connector.statistics.written, connector.statistics.balanced) == (1, True)
            assert gone == ["arm.c_out"]
            assert not inner.closed
            assert (loop.members, own.members, own.state(c)) == ((a, b), (c,), A)
            with pytest.raises(WiringError):
                kernel.find("arm.c_out")

    simulate(main)


@pytest.mark.row(99)
def test_a_change_that_fails_leaves_everybody_where_he_was() -> None:
    # OpenRTM keeps what it has done when a later member cannot be added.
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []

        class Refuses(Step):
            def on_activated(self) -> None:
                raise ValueError("no power")

        async with Kernel() as kernel:
            a, b, c, d = steps(diary, "a", "b", "c", "d")
            bad = await kernel.add(Refuses("bad", diary))
            for one in (c, d):
                await kernel.add(one)
            own = await kernel.start(ExternalContext(name="own"), d, c, bad)
            await own.activate(c)
            arm = await kernel.add(Composite("arm", a, b, exported={"*.output": "{component}_out"}))
            loop = await kernel.start(ExternalContext(name="loop"), arm, activate=True)
            with pytest.raises(Exception, match="bad could not join: ValueError: no power; nothing was changed"):
                await arm.change(members=[b, c, bad])
            assert (arm.members, loop.members, own.members) == ((a, b), (a, b), (d, c, bad))
            assert (own.state(c), own.state(bad), loop.state(a), arm.state) == (A, I, A, A)
            assert list(arm.ports) == ["a_out", "b_out"]
            with pytest.raises(WiringError, match=r"c\.output and d\.output"):
                await arm.change(members=["c", "d"], exported=["*.output"])
            with pytest.raises(StateError, match="nobody"):
                await arm.add_members(c, "nobody")
            assert (arm.members, own.members) == ((a, b), (d, c, bad))
            await arm.change(members=[c, a])
            assert (loop.members, own.members, list(arm.ports)) == ((c, a), (d, bad), ["c_out", "a_out"])
            assert b.contexts == ()

    simulate(main)


@pytest.mark.row(100)
@pytest.mark.parametrize(("errors", "whole", "other"), [("stop", E, I), ("report", E, A), ("isolate", A, A)])
def test_the_error_of_a_member_is_what_the_policy_says(
    errors: str, whole: LifecycleState, other: LifecycleState
) -> None:
    # OpenRTM: the composite stays active and nobody is told.
    async def main(clock: SimulatedClock) -> None:
        diary: list[str] = []
        async with Kernel() as kernel:
            told: list[tuple[str, LifecycleState]] = []
            kernel.bus.subscribe(StateChanged, lambda event: told.append((event.component, event.new)))
            a, b, c = steps(diary, "a", "b", "c")
            arm = await kernel.add(Composite("arm", a, b, c, errors=errors))
            loop = await kernel.start(ExternalContext(), arm, activate=True)
            assert told[-1] == ("c", A)
            assert ("arm", A) in told
            b.fails = ValueError("b")
            await loop.tick()
            assert (arm.state, a.state, b.state, c.state) == (whole, other, E, other)
            assert arm.last_error is b.fails
            assert (("arm", E) in told) is (whole is E)
            diary.clear()
            await loop.tick()
            assert diary == ([] if other is I else ["a", "c"])
            b.fails = None
            await arm.reset()
            assert (arm.state, b.state) == (A if other is A else I, I)
            await arm.activate()
            assert (arm.state, a.state, b.state, c.state) == (A, A, A, A)

    simulate(main)
