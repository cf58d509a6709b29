"""A plan that makes a system do worse is rolled back, with the figure; what it is meant to do is no fault of it."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import replace
from random import Random
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext
from aiorts.model.wanted.entries import ComponentEntry, ContextEntry
from aiorts.model.wanted.plan import plan
from aiorts.planning import wanted_of
from aiorts.testing import simulated
from campaign import CAMPAIGN, time_limit
from machine_parts import spinning
from planning.generated import random_system

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.model.wanted.applied import Applied
    from aiorts.model.wanted.entries import Wanted

WINDOW = 1.0
quiet = pytest.mark.skipif(not CAMPAIGN, reason="needs a machine with nothing else to do; AIORTS_CAMPAIGN=1")


class Writer(Component):
    """Writes so many samples in each cycle, and takes so many seconds for it."""

    out = OutPort(float)
    count = Param(1)
    seconds = Param(0.0)

    async def on_execute(self) -> None:
        if self.seconds:
            await self.sleep(self.seconds)
        for _ in range(self.count):
            self.out.write_nowait(1.0)


class Filter(Component):
    """Passes on what there is, as many samples at once as it may."""

    into = InPort(float)
    out = OutPort(float)
    at_once = Param(1)

    def on_execute(self) -> None:
        for _ in range(self.at_once):
            if self.into.is_new:
                self.out.write_nowait(self.into.read_nowait())


class Broken(Component):
    def on_execute(self) -> None:
        raise OSError("no device")


async def start(kernel: Kernel) -> Wanted:
    """writer -> filter -> sink, each in a context of its own; a fifth of what the writer writes is lost."""
    writer, passing = await kernel.create(Writer, "writer"), await kernel.create(Filter, "filter", at_once=4)
    sink = await kernel.create(Filter, "sink", at_once=10)
    await kernel.connect(writer.out, passing.into, length=4)
    await kernel.connect(passing.out, sink.into, length=20)
    await kernel.start(PeriodicContext(rate=40.0, name="passing"), passing, activate=True)
    await kernel.start(PeriodicContext(rate=200.0, name="writing"), writer, activate=True)
    await kernel.start(PeriodicContext(rate=40.0, name="sinking"), sink, activate=True)
    await kernel.sleep(0.501)
    return wanted_of(kernel)


def with_params(wanted: Wanted, name: str, **params: Any) -> Wanted:
    one = wanted.components[name]
    return with_component(wanted, replace(one, params=MappingProxyType({**one.params, **params})))


def with_component(wanted: Wanted, one: ComponentEntry) -> Wanted:
    return replace(wanted, components=MappingProxyType({**wanted.components, one.name: one}))


def with_context(wanted: Wanted, one: ContextEntry) -> Wanted:
    return replace(wanted, contexts=MappingProxyType({**wanted.contexts, one.name: one}))


def with_rate(wanted: Wanted, name: str, rate: float) -> Wanted:
    one = wanted.contexts[name]
    return with_context(wanted, replace(one, options=MappingProxyType({**one.options, "rate": rate})))


def with_options(wanted: Wanted, number: int, **options: Any) -> Wanted:
    made = list(wanted.connections)
    made[number] = replace(made[number], options=MappingProxyType({**made[number].options, **options}))
    return replace(wanted, connections=tuple(made))


def with_broken(wanted: Wanted) -> Wanted:
    broken = ComponentEntry("broken", wanted.components["writer"].type.replace("Writer", "Broken"))
    return with_context(
        with_component(wanted, broken),
        ContextEntry("breaking", "periodic", ("broken",), options=MappingProxyType({"rate": 10.0})),
    )


def without(wanted: Wanted, name: str) -> Wanted:
    return replace(
        wanted,
        components=MappingProxyType({other: one for other, one in wanted.components.items() if other != name}),
        connections=tuple(one for one in wanted.connections if not any(f"{name}." in path for path in one.ports)),
        contexts=MappingProxyType({other: one for other, one in wanted.contexts.items() if name not in one.members}),
    )


WORSE: dict[str, tuple[Callable[[Wanted], Wanted], str]] = {
    "drops": (lambda now: with_params(now, "filter", at_once=2), "writer.out-filter.into: "),
    "drops of a connector made anew": (lambda now: with_options(now, 0, length=1, timeout=0.5), "writer.out-filter"),
    "overruns": (lambda now: with_params(now, "writer", seconds=0.012), "writing: "),
    "rate": (lambda now: with_params(now, "writer", count=0), "writer.out-filter.into: 0 samples a second, and 200"),
    "error": (with_broken, "broken: in error: OSError: no device"),
}
MEANT: dict[str, Callable[[Wanted], Wanted]] = {
    "a higher rate of the reader": lambda now: with_rate(now, "passing", 50.0),
    "a lower rate of the writer": lambda now: with_rate(now, "writing", 100.0),
    "the writer goes": lambda now: without(now, "writer"),
    "samples are left out": lambda now: with_options(now, 0, push="skip", skip=1),
    "a longer buffer": lambda now: with_options(now, 0, length=8),
    "not active": lambda now: with_context(now, replace(now.contexts["writing"], activate=False)),
    "the writer is in no context": lambda now: with_context(now, replace(now.contexts["writing"], members=())),
    "one between is in no context": lambda now: with_context(now, replace(now.contexts["passing"], members=())),
    "the reader is in no context": lambda now: with_context(now, replace(now.contexts["sinking"], members=())),
    "the writer runs on events alone": lambda now: with_context(
        now, replace(now.contexts["writing"], kind="event", options=MappingProxyType({}))
    ),
    "the context of the writer is stopped": lambda now: replace(
        now, contexts=MappingProxyType({name: one for name, one in now.contexts.items() if name != "writing"})
    ),
}


@pytest.mark.parametrize("what", WORSE)
def test_a_plan_that_makes_it_worse_is_rolled_back_with_the_figure(what: str) -> None:
    change, figure = WORSE[what]

    @simulated
    async def run() -> None:
        async with Kernel() as kernel:
            before = await start(kernel)
            components = dict(kernel.components)
            applied = await kernel.apply(change(before), window=1.0)
            assert (applied.done, applied.notes) == (False, ())
            assert applied.rolled_back.startswith(figure), applied.rolled_back
            assert wanted_of(kernel) == before
            assert dict(kernel.components) == components

    run()


@pytest.mark.parametrize("what", MEANT)
def test_what_a_plan_is_meant_to_do_is_kept(what: str) -> None:
    @simulated
    async def run() -> None:
        async with Kernel() as kernel:
            wanted = MEANT[what](await start(kernel))
            applied = await kernel.apply(wanted, window=1.0)
            assert (applied.done, applied.rolled_back) == (True, "")
            assert kernel.bus.observers == ()

    run()


async def applied_beside(kernel: Kernel, wanted: Wanted) -> Applied:
    """In the middle of it, when the change is made and measured, two processes begin to spin."""
    applying = asyncio.ensure_future(kernel.apply(wanted, window=WINDOW))
    await kernel.sleep(WINDOW)
    async with spinning():
        return await applying


@pytest.mark.slow(kept_by="test_what_a_plan_is_meant_to_do_is_kept")
@pytest.mark.anyio
@pytest.mark.campaign
@quiet
@pytest.mark.timeout(time_limit(600))
async def test_a_harmless_plan_is_kept_though_two_processes_begin_to_spin_in_its_window() -> None:
    async with Kernel() as kernel:
        before = await start(kernel)
        for number in range(20):
            applied = await applied_beside(kernel, with_options(before, 1, length=21 + number % 2))
            assert (applied.done, applied.rolled_back) == (True, "")
            await kernel.sleep(0.2)


@pytest.mark.slow(kept_by="test_a_plan_that_makes_it_worse_is_rolled_back_with_the_figure")
@pytest.mark.anyio
@pytest.mark.campaign
@quiet
@pytest.mark.timeout(time_limit(600))
@pytest.mark.parametrize("beside", [False, True])
async def test_a_plan_that_doubles_the_drops_of_an_edge_is_rolled_back_also_beside_processes_that_spin(
    beside: bool,
) -> None:
    async with Kernel() as kernel, AsyncExitStack() as stack:
        before = await start(kernel)
        if beside:
            await stack.enter_async_context(spinning())
        for _ in range(20):
            # Far more than twice as many: a machine that is busier meanwhile lets fewer be written, and so be dropped.
            applied = await kernel.apply(with_params(before, "filter", at_once=1), window=WINDOW)
            assert (applied.done, applied.notes) == (False, ())
            assert applied.rolled_back.startswith("writer.out-filter.into: ")
            assert wanted_of(kernel) == before
            await kernel.sleep(0.2)


@simulated
async def test_what_others_change_in_the_window_before_is_planned_too() -> None:
    async with Kernel() as kernel:
        wanted = random_system(Random(5))
        applying = asyncio.ensure_future(kernel.apply(wanted, window=1.0))
        await kernel.sleep(0.5)
        await kernel.create("FlexiDupe", "stranger", inputs=("TimedDouble:2",))
        assert (await applying).done
        assert "stranger" not in kernel.components  # it is not wanted
        assert plan(wanted_of(kernel), wanted).empty


@pytest.mark.slow
@pytest.mark.fault("G05")
@simulated
async def test_who_is_cancelled_while_the_system_before_is_measured_gives_it_up() -> None:
    async with Kernel() as kernel:
        before = await start(kernel)
        after = with_params(before, "filter", at_once=5)
        task = asyncio.ensure_future(kernel.apply(after, window=WINDOW))
        await kernel.sleep(WINDOW / 2)
        task.cancel()
        await asyncio.wait([task])
        await kernel.sleep(3 * WINDOW)
        assert wanted_of(kernel) == before
        assert (await kernel.apply(after, window=WINDOW)).done
