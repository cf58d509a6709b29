"""The conformance suite of execution contexts: the promises of every kind, checked in virtual time.

Members have plain `def` hooks wherever possible, so that a context that runs in a thread is held to the same promises.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.assembly import Kernel
from aiorts.errors import StateError
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.driving import is_ticked, period_ns
from aiorts.testing.simulation import simulate
from aiorts.testing.stage import AskedInside, Asking, Inside, Recorder, Stage, Waiting

if TYPE_CHECKING:
    from aiorts.clock import SimulatedClock
    from aiorts.kernel import Context

MakeContext = Callable[[], "Context"]

_SUITE: Suite[MakeContext] = Suite()
_CYCLES: Final = 20


def check_context(make: MakeContext, *, only: Iterable[str] | None = None, skip: Iterable[str] = ()) -> None:
    """Hold a kind of execution context to its promises; `CONTEXT_CHECKS` lists them.

    Args:
        make: a new context, not started. One with `tick()` is ticked, one with a rate (at most 1 kHz) gets the time it
            needs, one with `trigger()` is triggered.
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, what was expected, what happened.
    """
    _SUITE.run(type(make()).__name__, make, only, skip)


def _staged(check: Callable[[Stage], Coroutine[Any, Any, None]]) -> Callable[[MakeContext], None]:
    """Add a check that runs on a stage of its own."""

    def run(make: MakeContext) -> None:
        async def main(clock: SimulatedClock) -> None:
            async with Kernel("stage", clock=clock) as kernel:
                await check(Stage(kernel, make(), clock))

        simulate(main)

    run.__name__, run.__doc__ = check.__name__, check.__doc__
    return _SUITE.check(run)


FULL_CYCLE = ["a.on_execute", "b.on_execute", "a.on_state_update", "b.on_state_update"]


@_staged
async def starts_without_activating(stage: Stage) -> None:
    """Starting runs on_startup of each member in order, once, and nothing else."""
    await stage.start(activate=False)
    await stage.clock.advance(0.01)
    wanted = ["a.on_startup", "b.on_startup"]
    expect(stage.calls == wanted, f"{wanted} and no more", stage.calls)
    expect(stage.context.state(stage.a) is LifecycleState.INACTIVE, "an inactive member", stage.context.state(stage.a))


@_staged
async def runs_a_cycle_in_passes(stage: Stage) -> None:
    """A cycle runs on_execute of all active members in order, then on_state_update of all, once each."""
    await stage.start()
    for _ in range(_CYCLES):
        ran = await stage.cycle()
        expect(ran == FULL_CYCLE, f"one cycle, {FULL_CYCLE}", ran)


@_staged
async def loses_no_tick(stage: Stage) -> None:
    """Ticks that are asked for together are run one after the other, and time brings each tick that is due."""
    await stage.start()
    tick, rate = getattr(stage.context, "tick", None), stage.context.rate
    if tick is not None:
        await asyncio.gather(*(tick() for _ in range(_CYCLES)))
    elif rate is not None:
        await stage.clock.advance_to(stage.clock.monotonic_ns() + _CYCLES * period_ns(rate))
    else:
        for _ in range(_CYCLES):
            stage.context.trigger()  # type: ignore[attr-defined] # what is neither ticked nor timed is triggered
            await stage.clock.advance(0)
    executed = stage.calls.count("a.on_execute")
    expect(executed == _CYCLES, f"{_CYCLES} cycles for {_CYCLES} ticks", f"{executed}")


@_staged
async def counts_its_cycles(stage: Stage) -> None:
    """`ticks` and the statistics count each cycle once, and each timed hook as often as it ran."""
    await stage.start()
    ticks, cycles = stage.context.ticks, stage.context.statistics.cycles
    for _ in range(_CYCLES):
        await stage.cycle()
    expect(stage.context.ticks - ticks == _CYCLES, f"ticks + {_CYCLES}", f"ticks + {stage.context.ticks - ticks}")
    statistics = stage.context.statistics
    expect(statistics.cycles - cycles == _CYCLES, f"cycles + {_CYCLES}", f"cycles + {statistics.cycles - cycles}")
    for hook, times in statistics.hooks.items():
        wanted = _CYCLES if hook.endswith(("on_execute", "on_state_update")) else 1
        expect(times.count == wanted, f"{hook} counted {wanted} times", times.count)


@_staged
async def obeys_at_once_between_cycles(stage: Stage) -> None:
    """A request between two cycles takes effect at once: without data, a tick or a period."""
    await stage.start(activate=False)
    now_ns, ticks = stage.clock.monotonic_ns(), stage.context.ticks
    await stage.context.activate(stage.a)
    expect(stage.context.state(stage.a) is LifecycleState.ACTIVE, "a active", stage.context.state(stage.a))
    await stage.context.deactivate(stage.a)
    ran = [call for call in stage.calls if not call.endswith("on_startup")]
    expect(ran == ["a.on_activated", "a.on_deactivated"], "on_activated, then on_deactivated", ran)
    passed = stage.clock.monotonic_ns() - now_ns
    expect(
        passed == 0 and stage.context.ticks == ticks, "no time, no tick", f"{passed} ns, {stage.context.ticks - ticks}"
    )


@_staged
async def finishes_a_cycle_before_it_obeys(stage: Stage) -> None:
    """A request that comes in the middle of a cycle takes effect after it, not in it."""
    asked = AskedInside(stage)
    if stage.context.suspends:
        stage.a = Asking("a", stage.calls, asked)
    else:
        stage.a.during = asked.from_thread
    await stage.start()
    await stage.cycle()
    await asked.answered()
    ran = stage.calls
    expect(ran[: len(FULL_CYCLE)] == FULL_CYCLE, f"the whole cycle first, {FULL_CYCLE}", ran)
    expect("b.on_deactivated" in ran, "b.on_deactivated after the cycle", ran)


@_staged
async def never_enters_a_hook_twice(stage: Stage) -> None:
    """While a hook of a member runs, no hook of any member is entered, however often a cycle is asked for."""
    inside = Inside()
    stage.a.during = stage.b.during = inside.plain
    if stage.context.suspends:
        stage.a, stage.b = Waiting("a", stage.calls, inside), Waiting("b", stage.calls, inside)
    await stage.start()
    drives = [asyncio.ensure_future(stage.cycle()) for _ in range(3)] if is_ticked(stage.context) else [stage.cycle()]
    for drive in drives:
        await drive
    await stage.clock.advance(1.0)
    await stage.context.stop()
    expect(inside.entered >= 2, "hooks that ran", inside.entered)
    expect(inside.most == 1, "one hook at a time", f"{inside.most} at once")


@_staged
async def leaves_neighbours_alone(stage: Stage) -> None:
    """A member that fails goes to error, with on_aborting and then on_error; the others miss nothing."""
    await stage.start()
    stage.a.during = _fail
    ran = await stage.cycle()
    expect(ran.count("b.on_execute") == 1, "b.on_execute in the same cycle", ran)
    expect("a.on_aborting" in ran, "a.on_aborting after the cycle", ran)
    expect(stage.context.state(stage.a) is LifecycleState.ERROR, "a in error", stage.context.state(stage.a))
    expect(isinstance(stage.a.last_error, ZeroDivisionError), "its cause in last_error", stage.a.last_error)
    for _ in range(3):
        ran = await stage.cycle()
        wanted = ["a.on_error", "b.on_execute", "b.on_state_update"]
        expect([call for call in ran if call != "a.on_error"] == wanted[1:], f"b as before, {wanted}", ran)


def _fail() -> None:
    raise ZeroDivisionError("a conformance check makes this member fail")


@_staged
async def comes_back_after_reset(stage: Stage) -> None:
    """A member in error is inactive after reset, and can be activated and run again."""
    await stage.start()
    stage.a.during = _fail
    await stage.cycle()
    stage.a.during = lambda: None
    await stage.context.reset(stage.a)
    expect(stage.context.state(stage.a) is LifecycleState.INACTIVE, "a inactive", stage.context.state(stage.a))
    await stage.context.activate(stage.a)
    ran = await stage.cycle()
    expect(ran == FULL_CYCLE, f"{FULL_CYCLE}", ran)


@_staged
async def takes_members_while_running(stage: Stage) -> None:
    """A member added while running starts up, runs last once active, and is gone when removed."""
    await stage.start()
    third = await stage.kernel.add(Recorder("c", stage.calls))
    await stage.context.add(third)
    expect(stage.calls == ["c.on_startup"], "c.on_startup", stage.calls)
    await stage.context.activate(third)
    ran = [call for call in await stage.cycle() if call.endswith("on_execute")]
    expect(ran == ["a.on_execute", "b.on_execute", "c.on_execute"], "c last", ran)
    stage.calls.clear()
    await stage.context.remove(stage.a)
    expect(stage.calls == ["a.on_deactivated", "a.on_shutdown"], "a deactivated and shut down", stage.calls)
    ran = [call for call in await stage.cycle() if call.endswith("on_execute")]
    expect(ran == ["b.on_execute", "c.on_execute"], "b and c as before", ran)


@_staged
async def refuses_what_does_not_fit(stage: Stage) -> None:
    """Activating an active member, or asking a context that has stopped, is a StateError."""
    await stage.start()
    await _refused(stage.context.activate(stage.a), "activating an active member")
    await stage.context.stop()
    await _refused(stage.context.activate(stage.a), "a request to a stopped context")


async def _refused(request: Coroutine[Any, Any, None], what: str) -> None:
    try:
        await request
    except StateError:
        return
    expect(False, f"StateError for {what}", "nothing")


@_staged
async def tells_of_a_new_rate(stage: Stage) -> None:
    """A context whose rate can be set runs on_rate_changed of each member, and ticks at the new rate."""
    await stage.start()
    set_rate, rate = getattr(stage.context, "set_rate", None), stage.context.rate
    if set_rate is None or rate is None:
        return
    await set_rate(rate / 2)
    expect(stage.calls == ["a.on_rate_changed", "b.on_rate_changed"], "on_rate_changed of each", stage.calls)
    expect(stage.context.rate == rate / 2, f"a rate of {rate / 2}", stage.context.rate)
    await stage.cycle()
    ticks = stage.context.ticks
    await stage.clock.advance_to(stage.clock.monotonic_ns() + 10 * period_ns(rate / 2))
    expect(stage.context.ticks - ticks == 10, "10 ticks in 10 new periods", stage.context.ticks - ticks)


@_staged
async def ends_in_reverse_order(stage: Stage) -> None:
    """Stopping deactivates and shuts down the members, the last one first, and nothing runs afterwards."""
    await stage.start()
    await stage.cycle()
    stage.calls.clear()
    await stage.context.stop()
    wanted = ["b.on_deactivated", "b.on_shutdown", "a.on_deactivated", "a.on_shutdown"]
    expect(stage.calls == wanted, f"{wanted}", stage.calls)
    expect(not stage.context.running, "running = False", stage.context.running)
    await stage.clock.advance(1.0)
    expect(stage.calls == wanted, "no hook after the end", stage.calls)


CONTEXT_CHECKS: Mapping[str, str] = _SUITE.promises
"""The promises that `check_context` demands: name of the check -> promise."""
