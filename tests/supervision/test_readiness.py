"""Readiness can be awaited and says who is missing; start and stop follow conditions; a cycle of them is an error."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as budgeted
from hypothesis import strategies as st

from aiorts import Component, EventContext, Kernel, LifecycleState, PeriodicContext, SimulatedClock, StartRule
from aiorts.errors import (
    AiortsError,
    ClosedError,
    ComponentError,
    ConfigurationError,
    InvalidNameError,
    StateError,
    TransitionTimeout,
)
from aiorts.events import StateChanged
from aiorts.model.wanted.start_rules import in_order
from aiorts.system import build, load, wanted
from aiorts.testing import simulated
from campaign import cases

A, E, I = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE  # noqa: E741


class Part(Component):
    """Takes its time to come up."""

    def __init__(self, name: str = "", seconds: float = 0.0, *, fails: bool = False) -> None:
        super().__init__(name)
        self.seconds, self.fails = seconds, fails

    async def on_activated(self) -> None:
        await self.sleep(self.seconds)
        if self.fails:
            raise RuntimeError("no camera")


async def parts(kernel: Kernel, *names: str, **seconds: float) -> dict[str, Part]:
    made = {name: await kernel.add(Part(name, seconds.get(name, 0.0))) for name in names}
    for part in made.values():
        await kernel.start(PeriodicContext(100.0), part)
    return made


# -- readiness -------------------------------------------------------------------------------------------------------


@simulated
async def test_ready_when_the_last_one_is_active(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        await kernel.wait_ready(timeout=0.0)  # nobody is to be active
        made = await parts(kernel, "one", "two", two=0.3)
        await kernel.create(Part, "idle")
        waiting = asyncio.ensure_future(kernel.wait_ready())
        await made["one"].context.activate()
        await asyncio.sleep(0)
        assert not waiting.done()
        await kernel.wait_ready(made["one"])
        await made["two"].context.activate()
        await waiting
        assert simulated_clock.monotonic_ns() == pytest.approx(0.3e9, abs=0.02e9)


@simulated
async def test_who_is_missing_is_named_with_the_reason(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        made = await parts(kernel, "one", "two")
        bad = await kernel.add(Part("bad", fails=True))
        context = await kernel.start(PeriodicContext(100.0), bad)
        await made["one"].context.activate()
        with pytest.raises(ComponentError):
            await context.activate()
        with pytest.raises(TransitionTimeout) as raised:
            await kernel.wait_ready(timeout=0.5)
        text = str(raised.value)
        assert "two is inactive in" in text
        assert "bad is error in" in text
        assert "no camera" in text
        assert "one is" not in text
        assert "0.5 s" in text
        with pytest.raises(TransitionTimeout, match="camera is not there"):
            await kernel.wait_ready("camera", timeout=0.1)


@simulated
async def test_waiting_ends_with_the_kernel_and_leaves_nothing(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        await parts(kernel, "one")
        observers = len(kernel.bus._observers)
        waiting = asyncio.ensure_future(kernel.wait_ready(timeout=None))
        await simulated_clock.advance(1.0)
        cancelled = asyncio.ensure_future(kernel.wait_ready())
        await simulated_clock.advance(1.0)
        cancelled.cancel()
        await asyncio.wait([cancelled])
        assert len(kernel.bus._observers) == observers + 1
    with pytest.raises(ClosedError):
        await waiting
    with pytest.raises(ClosedError):
        await kernel.wait_ready()


# -- order -----------------------------------------------------------------------------------------------------------


@pytest.mark.row(111)
@pytest.mark.row(92)
@pytest.mark.parametrize("how", ["stop_in_order", "close"])
@simulated
async def test_start_follows_conditions_and_stop_goes_the_other_way_round(
    how: str, simulated_clock: SimulatedClock
) -> None:
    changes: list[tuple[str, LifecycleState, float]] = []
    async with Kernel() as kernel:
        await parts(kernel, "arm", "camera", "filter", camera=1.0)
        kernel.bus.subscribe(
            StateChanged,
            lambda event: changes.append((event.component, event.new, simulated_clock.monotonic_ns() / 1e9)),
        )
        rules = [
            StartRule("arm", after=["filter active", "camera active"], wait=0.5),
            StartRule("filter", after="camera"),
            StartRule("camera"),
        ]
        await kernel.start_in_order(rules)
        assert [(name, state) for name, state, _ in changes] == [("camera", A), ("filter", A), ("arm", A)]
        at = {name: when for name, _, when in changes}
        assert at["camera"] == pytest.approx(1.0, abs=0.02)
        assert at["arm"] - at["filter"] == pytest.approx(0.5, abs=0.02)
        changes.clear()
        if how == "stop_in_order":
            await kernel.stop_in_order()
            await kernel.stop_in_order()  # nothing is left to stop
            assert len(changes) == 3
    assert [(name, state) for name, state, _ in changes] == [("arm", I), ("filter", I), ("camera", I)]


@pytest.mark.row(111)
@simulated
async def test_a_condition_that_never_comes_true_is_named(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        made = await parts(kernel, "arm", "camera")
        before = simulated_clock.monotonic_ns()
        with pytest.raises(TransitionTimeout, match=r"arm: not started.*camera active: it is inactive"):
            await kernel.start_in_order([StartRule("arm", after=["camera active", "arm added"], timeout=2.0)])
        assert simulated_clock.monotonic_ns() - before == 2_000_000_000
        with pytest.raises(TransitionTimeout, match="gripper added: it is not there"):
            await kernel.start_in_order([StartRule("camera"), StartRule("arm", after="gripper added", timeout=1.0)])
        assert (made["camera"].state, made["arm"].state) == (A, I)


@pytest.mark.parametrize(("after", "seconds"), [(["camera"], 2.0), (["light", "camera"], 2.5), (["light"], None)])
@simulated
async def test_time_counts_while_the_awaited_component_comes_up(
    after: list[str], seconds: float | None, simulated_clock: SimulatedClock
) -> None:
    """Only that: neither what comes between, nor what the others of the same rules wait."""
    async with Kernel() as kernel:
        made = await parts(kernel, "light", "between", "camera", "arm", light=1.5, between=4.0, camera=3.0)
        rules = [
            StartRule("light"),
            StartRule("between"),
            StartRule("camera", wait=2.0),
            StartRule("arm", after=after, timeout=2.0),
        ]
        before = simulated_clock.monotonic_ns()
        if seconds is None:
            await kernel.start_in_order(rules)
            assert made["arm"].state is A
            return
        with pytest.raises(TransitionTimeout, match=r"arm: not started: after 2.0 s still not camera active: it is in"):
            await kernel.start_in_order(rules)
        until = {2.0: 1.5 + 4.0 + 2.0 + 2.0, 2.5: 1.5 + 4.0 + 2.0 + 0.5}[seconds]
        assert (simulated_clock.monotonic_ns() - before) / 1e9 == pytest.approx(until, abs=0.05)
        assert made["arm"].state is I


@pytest.mark.parametrize("way", ["file", "plan"])
@simulated
async def test_time_counts_while_the_awaited_component_of_a_file_comes_up(
    way: str, simulated_clock: SimulatedClock, tmp_path: Path
) -> None:
    text = 'schema = 1\n[clock]\nkind = "simulated"\n'
    (tmp_path / "comes_up.py").write_text(
        "from aiorts import Component\nclass Slow(Component):\n    async def on_activated(self):\n"
        "        await self.sleep(3.0)\nclass Fast(Component):\n    pass\n"
    )
    (tmp_path / "none.toml").write_text(text)
    (tmp_path / "s.toml").write_text(
        f'{text}[components.slow]\ntype = "comes_up.py:Slow"\n[components.fast]\ntype = "comes_up.py:Fast"\n'
        'start.after = "slow"\nstart.timeout = 1.0\n[contexts.a]\nkind = "periodic"\nrate = 10.0\nmembers = ["slow"]\n'
        '[contexts.b]\nkind = "periodic"\nrate = 10.0\nmembers = ["fast"]\n'
    )
    async with Kernel() as kernel:
        if way == "file":
            with pytest.raises(TransitionTimeout, match=r"fast: not started: after 1.0 s still not slow active"):
                await build(kernel, load(tmp_path / "s.toml"))
            assert kernel.components["fast"].state is I
            return
        await build(kernel, load(tmp_path / "none.toml"))
        with pytest.raises(AiortsError, match=r"fast: not started: after 1.0 s still not slow active"):
            await kernel.apply(wanted(load(tmp_path / "s.toml")))
        assert list(kernel.components) == []


@simulated
async def test_conditions_may_come_true_by_others(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        made = await parts(kernel, "arm")
        starting = asyncio.ensure_future(kernel.start_in_order([StartRule("arm", after="late inactive")]))
        await simulated_clock.advance(1.0)
        late = await kernel.create(Part, "late")
        await simulated_clock.advance(1.0)
        assert made["arm"].state is I
        await kernel.start(EventContext(), late)
        await starting
        assert made["arm"].state is A


@pytest.mark.row(111)
@simulated
async def test_a_cycle_is_an_error_that_names_it_and_nothing_starts() -> None:
    async with Kernel() as kernel:
        made = await parts(kernel, "a", "b", "c", "d")
        rules = [StartRule("d"), StartRule("a", "b"), StartRule("b", "c active"), StartRule("c", ["a", "d"])]
        with pytest.raises(ConfigurationError, match="a -> b -> c -> a"):
            await kernel.start_in_order(rules)
        assert all(part.state is I for part in made.values())
        with pytest.raises(ConfigurationError, match="two rules"):
            await kernel.start_in_order([StartRule("a"), StartRule("a")])
        with pytest.raises(StateError, match="no such component; there are a, b, c, d"):
            await kernel.start_in_order([StartRule("e")])
        await kernel.create(Part, "lonely")
        with pytest.raises(StateError, match="in no context"):
            await kernel.start_in_order([StartRule("lonely")])


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: StartRule("a", "b running"),
        lambda: StartRule("a", "b active now"),
        lambda: StartRule("a", [""]),
        lambda: StartRule("a", "a active"),
        lambda: StartRule("a", 3),  # type: ignore[arg-type]
        lambda: StartRule("a", wait=-1.0),
        lambda: StartRule("a", timeout=float("nan")),
        lambda: StartRule("a b"),
    ],
)
def test_wrong_rules_are_refused(wrong: object) -> None:
    with pytest.raises((ConfigurationError, InvalidNameError)):
        wrong()  # type: ignore[operator]


NAMES = [f"n{number}" for number in range(8)]


@pytest.mark.slow(kept_by="test_start_follows_conditions_and_stop_goes_the_other_way_round")
@given(
    edges=st.lists(
        st.tuples(st.sampled_from(NAMES), st.sampled_from(NAMES)).filter(lambda e: e[0] != e[1]), max_size=20
    ),
    names=st.permutations(NAMES),
)
@budgeted(max_examples=cases(10_000))
@pytest.mark.campaign
def test_every_order_keeps_its_conditions_or_a_cycle_is_named(edges: list[tuple[str, str]], names: list[str]) -> None:
    rules = [StartRule(name, [before for after, before in edges if after == name]) for name in names]
    try:
        ordered = [rule.component for rule in in_order(rules)]
    except ConfigurationError as error:
        way = str(error).split(": ")[-1].split(" -> ")
        assert way[0] == way[-1]
        assert len(way) > 2
        assert all((one, other) in edges for one, other in itertools.pairwise(way))
        return
    assert sorted(ordered) == sorted(NAMES)
    assert all(ordered.index(after) > ordered.index(before) for after, before in edges)
    if not edges:
        assert ordered == list(names)
