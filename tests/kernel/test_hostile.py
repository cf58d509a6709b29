"""Nothing that belongs to the application can keep a failure from being recorded: neighbours go on at their rate."""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from aiorts import (
    Component,
    EventContext,
    ExternalContext,
    Kernel,
    PeriodicContext,
    Provided,
    RealtimeContext,
    Required,
    Supervision,
    ThreadContext,
)
from aiorts.errors import AiortsError, ServiceFailed
from aiorts.kernel.loop.bus import Event
from aiorts.model.lifecycle import HOOKS, LifecycleState
from aiorts.testing.simulation import simulate
from hostile import hostile, hostile_logging
from kernel_parts import PlainDiary

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts import Context, SimulatedClock

RUNS = 500
KINDS: dict[str, Callable[[], Context]] = {
    "periodic": lambda: PeriodicContext(100.0),
    "event": lambda: EventContext(),
    "external": lambda: ExternalContext(),
    "thread": lambda: ThreadContext(100.0),
    "realtime": lambda: RealtimeContext(100.0),
}


async def pass_time(context: Context, clock: SimulatedClock, cycles: int) -> None:
    """So many cycles of 10 ms, whatever runs them."""
    for _ in range(cycles):
        if isinstance(context, ExternalContext):
            await context.tick()
        elif isinstance(context, EventContext):
            context.trigger()
        await clock.advance(0.01)


async def one_run(seed: int, clock: SimulatedClock) -> None:
    rng = random.Random(seed)
    kind = rng.choice(tuple(KINDS))
    hook = rng.choice([hook for hook in HOOKS if hook != "on_initialize"])
    made: list[BaseException] = []

    def fail() -> None:
        made.append(hostile(rng))
        raise made[-1]

    def observe(_event: Event) -> None:
        raise hostile(rng)

    with hostile_logging(rng):
        async with Kernel(contain_interrupts=True) as kernel:
            if rng.random() < 0.3:
                kernel.bus.subscribe(Event, observe)
            parts: list[Any] = [await kernel.add(PlainDiary(name)) for name in ("before", "bad", "after")]
            before, bad, after = parts
            if rng.random() < 0.5:
                kernel.supervise(bad, Supervision(restart=rng.choice(("reset", "restart")), backoff=0.05))
            bad.plan[hook] = fail
            if hook in ("on_aborting", "on_error", "on_reset"):
                bad.plan["on_execute"] = fail
            context = await kernel.start(KINDS[kind](), *parts)
            await context.activate(before, after)
            with suppress(AiortsError):
                await context.activate(bad)
            if hook == "on_rate_changed" and kind in ("periodic", "thread", "realtime"):
                await context.set_rate(100.0)  # type: ignore[attr-defined]
            await pass_time(context, clock, 10)
            ran = [part.count("on_execute") for part in (before, after)]
            await pass_time(context, clock, 20)
            assert [part.count("on_execute") for part in (before, after)] == [count + 20 for count in ran]
            assert context.running
            assert [context.state(part) for part in (before, after)] == [LifecycleState.ACTIVE] * 2
            with suppress(AiortsError, asyncio.CancelledError):
                await context.reset(kernel.components["bad"])
            with suppress(AiortsError, asyncio.CancelledError):
                await context.deactivate(kernel.components["bad"])
        assert kernel.exit_status == 0
        assert all(part.ran[-3:] == ["on_deactivated", "on_shutdown", "on_finalize"] for part in (before, after))


@pytest.mark.slow
@pytest.mark.row(13)
@pytest.mark.fault("A01")
@pytest.mark.parametrize("first", range(0, RUNS, 50))
def test_hostile_exceptions_and_handlers_never_take_a_context_down(first: int) -> None:
    for seed in range(first, first + 50):
        try:
            simulate(lambda clock, seed=seed: one_run(seed, clock))
        except BaseException as error:
            raise AssertionError(f"seed {seed}") from error


class Brake(Protocol):
    def stop(self) -> None: ...


class Arm(Component):
    """Calls in each cycle."""

    brake = Required[Brake](timeout=1.0)
    failed = 0

    def on_execute(self) -> None:
        try:
            self.brake.proxy.stop()
        except ServiceFailed:
            self.failed += 1


class Rusty(Component):
    """Its method raises what raises in its turn."""

    brake = Provided[Brake]()
    rng: random.Random

    def stop(self) -> None:
        raise hostile(self.rng)


class Starter(Component):
    """Starts a task that fails."""

    rng: random.Random
    raised: BaseException

    async def fail(self) -> None:
        await asyncio.sleep(0.01)
        self.raised = hostile(self.rng)
        raise self.raised

    def on_activated(self) -> None:
        asyncio.create_task(self.fail())  # noqa: RUF006 - nobody keeps it


@pytest.mark.slow(
    kept_by="execution/test_failing_hooks.py::test_whatever_a_hook_raises_is_the_error_of_its_component_alone"
)
@pytest.mark.fault("A14")
def test_hostile_failures_of_tasks_and_calls_are_their_components() -> None:
    async def main(clock: SimulatedClock, seed: int) -> None:
        rng = random.Random(seed)
        with hostile_logging(rng):
            async with Kernel(contain_interrupts=True) as kernel:
                arm, rusty = await kernel.add(Arm("arm")), await kernel.add(Rusty("rusty"))
                starter = await kernel.add(Starter("starter"))
                rusty.rng = starter.rng = rng
                await kernel.connect(arm.brake, rusty.brake)
                context = await kernel.start(PeriodicContext(100.0), arm, rusty, starter, activate=True)
                await clock.advance(1.0)
                assert arm.failed in (100, 101)
                cancelled = issubclass(type(starter.raised), asyncio.CancelledError)  # and that is no failure
                assert context.state(starter) is LifecycleState[("ERROR", "ACTIVE")[cancelled]]
                assert context.state(arm) is LifecycleState.ACTIVE
            assert kernel.exit_status == 0

    for seed in range(100):
        try:
            simulate(lambda clock, seed=seed: main(clock, seed))
        except BaseException as error:
            raise AssertionError(f"seed {seed}") from error
