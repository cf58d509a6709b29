"""The loop that runs the hooks of a cycle quickly does what the general one would have done.

A driver that is careful from the start runs no hook quickly. The two histories of a random system are compared:
everything that an observer, a component or a caller could see, in order and with the time.
"""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from typing import Any

import anyio
import pytest

from aiorts import (
    Component,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    SimulatedClock,
    WouldBlock,
)
from aiorts.errors import AiortsError
from aiorts.kernel.execution.cell import log_fields
from aiorts.kernel.execution.task_driver import TaskDriver
from aiorts.kernel.loop.bus import Event, HookAfter, HookBefore
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases

History = list[tuple[Any, ...]]


class World:
    """What the components of one system share."""

    def __init__(self, kernel: Kernel, clock: SimulatedClock, seed: int) -> None:
        self.kernel, self.clock, self.chance = kernel, clock, random.Random(seed)
        self.history: History = []
        self.spies: list[Any] = []
        self.steps = 0

    def note(self, *what: Any) -> None:
        self.history.append((self.clock.monotonic_ns(), *what))

    def observed(self, event: Event) -> None:
        self.note(*_shown(event))

    def spy(self) -> None:
        """Observers of hooks come and go."""
        if self.spies:
            self.spies.pop()()
        else:
            kind = self.chance.choice((HookBefore, HookAfter))
            self.spies.append(self.kernel.bus.subscribe(kind, self.observed))


def _shown(event: Event) -> tuple[Any, ...]:
    values = [getattr(event, name) for name in event.__dataclass_fields__]
    return (type(event).__name__, *(_error(v) if isinstance(v, BaseException) else repr(v) for v in values))


def _error(error: BaseException | None) -> str:
    return "" if error is None else f"{type(error).__name__}: {error}"


class _Acts(Component):
    """Does something random in every hook."""

    left = InPort(TimedLong)
    out = OutPort(TimedLong)

    def __init__(self, name: str, world: World) -> None:
        super().__init__(name)
        self.world = world

    def seen(self, hook: str) -> None:
        """Everything that is said of a component inside its hook."""
        fields = log_fields(self)
        self.world.note(self.name, hook, self.context.name, self.context.state(self).value, *fields)
        self.world.note("task", _owner() is self)

    def act(self) -> None:
        """What needs no await; may raise."""
        world, chance = self.world, self.world.chance
        world.steps += 1
        if self.left.is_new and chance.random() < 0.8:
            try:
                world.note("read", self.left.read_nowait().data)
            except WouldBlock:
                world.note("nothing to read")
        roll = chance.random()
        if roll < 0.02:
            raise ValueError(f"{self.name} at {world.steps}")
        if roll < 0.03:
            self.finish()
        elif roll < 0.07:
            world.spy()
        elif roll < 0.2 and self.out.connectors:
            self.out.write_nowait(TimedLong(0, world.steps))
        elif roll < 0.21:
            raise asyncio.CancelledError("of my own")

    def on_activated(self) -> None:
        self.seen("activated")

    def on_deactivated(self) -> None:
        self.seen("deactivated")

    def on_error(self, error: BaseException) -> None:
        self.seen("error")
        self.world.note(_error(error))

    async def on_aborting(self, error: BaseException) -> None:
        self.seen("aborting")


class Plain(_Acts):
    def on_execute(self) -> Any:
        self.seen("execute")
        self.act()
        return 7 if self.world.chance.random() < 0.01 else None


class Updating(Plain):
    def on_state_update(self) -> None:
        self.seen("update")


class Suspending(_Acts):
    async def on_execute(self) -> Any:
        self.seen("execute")
        chance = self.world.chance
        roll = chance.random()
        if roll < 0.2:
            await self.sleep(chance.choice((0.0, 0.003, 0.02, 0.4)))
        elif roll < 0.25:
            with anyio.move_on_after(0.01):
                await asyncio.sleep(chance.choice((0.005, 0.05)))
        elif roll < 0.3:
            try:
                await asyncio.sleep(1.0)
            except asyncio.CancelledError:
                self.world.note("cancelled", self.name)
                if chance.random() < 0.5:
                    raise
        elif roll < 0.31:
            asyncio.current_task().cancel()  # type: ignore[union-attr]
            if chance.random() < 0.5:
                await asyncio.sleep(0.001)
        elif roll < 0.32:
            await chance.choice(self.contexts).deactivate(self)
        elif roll < 0.322:
            await self.context.stop()
        elif roll < 0.332:
            while chance.random() < 0.8:
                try:
                    await asyncio.sleep(0.7)
                except asyncio.CancelledError:
                    self.world.note("ignored", self.name)
        elif roll < 0.37:
            asyncio.get_running_loop().create_task(self._stray(), name=f"stray {self.world.steps}")
        self.seen("still")
        self.act()
        return 7 if chance.random() < 0.01 else None

    async def _stray(self) -> None:
        await asyncio.sleep(0.01)
        self.world.note("stray", _owner() is self)
        if self.world.chance.random() < 0.5:
            raise KeyError("stray")


def _owner() -> Any:
    from aiorts.kernel.loop.tasks import current_task, owner_of

    return owner_of(current_task())


def _context(chance: random.Random, number: int) -> Context:
    kind = chance.randrange(3)
    deadline = chance.choice((None, None, None, 0.3))
    timing = chance.random() < 0.7
    if kind == 0:
        return PeriodicContext(chance.choice((20.0, 50.0)), name=f"c{number}", deadline=deadline, timing=timing)
    made = EventContext if kind == 1 else ExternalContext
    return made(name=f"c{number}", deadline=deadline, timing=timing)


async def _disturb(world: World, context: Context) -> None:
    """Something from outside, in a task of its own."""
    chance = world.chance
    what = chance.choice(
        ("trigger", "tick", "reset", "reset", "reset", "deactivate", "spy", "stop", "cancel", "wait", "remove")
    )
    if what in ("stop", "cancel", "remove") and chance.random() < 0.9:
        return
    world.note("asks", what, context.name)
    try:
        if what == "trigger" and isinstance(context, EventContext):
            context.trigger(*chance.sample(context.members, chance.randint(0, len(context.members))))
        elif what == "tick" and isinstance(context, ExternalContext):
            await context.tick(chance.randint(1, 4))
        elif what == "reset":
            with suppress(AiortsError):
                await context.reset(timeout=0.5)
            await context.activate(timeout=0.5)
        elif what == "deactivate" and context.members:
            await context.deactivate(chance.choice(context.members), timeout=0.5)
        elif what == "remove" and context.members:
            await context.remove(chance.choice(context.members), timeout=0.5)
        elif what == "spy":
            world.spy()
        elif what == "stop":
            await context.stop()
        elif what == "cancel" and context.runner.driver is not None:
            context.runner.driver.task.cancel()  # type: ignore[attr-defined]
    except AiortsError as error:
        world.note("refused", _error(error))


def played(seed: int) -> History:
    """What happened in a random system."""

    async def main(clock: SimulatedClock) -> History:
        async with Kernel() as kernel:
            world = World(kernel, clock, seed)
            chance = world.chance
            kernel.bus.subscribe(Event, world.observed)
            kinds = [chance.choice((Plain, Updating, Suspending, Suspending)) for _ in range(chance.randint(1, 5))]
            made = [await kernel.add(kind(f"k{n}", world)) for n, kind in enumerate(kinds)]
            for one in made:
                if chance.random() < 0.6:
                    await kernel.connect(one.out, chance.choice(made).left)
            contexts = [_context(chance, number) for number in range(chance.randint(1, 3))]
            for context in contexts:
                members = chance.sample(made, chance.randint(1, len(made)))
                await kernel.start(context, *members, activate=True)
            tasks = []
            for _ in range(40):
                tasks.append(asyncio.create_task(_disturb(world, chance.choice(contexts))))
                await asyncio.sleep(chance.choice((0.0, 0.001, 0.03)))
            await asyncio.sleep(8.0)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for context in contexts:
                world.note(context.name, context.statistics)
            for one in made:
                world.note(one.name, one.states, _error(one.last_error))
        world.note("closed", _owner() is None)
        return world.history

    return simulate(main)


@pytest.mark.slow(
    kept_by="execution/test_failing_hooks.py::test_whatever_a_hook_raises_is_the_error_of_its_component_alone"
)
@pytest.mark.fault("A06")
def test_hooks_run_quickly_and_hooks_run_with_care_give_the_same_history(monkeypatch: pytest.MonkeyPatch) -> None:
    def careful(driver: TaskDriver) -> None:
        driver._careful = True

    for seed in range(cases(5000)):
        quick = played(seed)
        with monkeypatch.context() as patch:
            patch.setattr(TaskDriver, "update_fast_path", careful)
            assert quick == played(seed), f"seed {seed}"
