"""Runs cycles of a context in virtual time, for any kind of context and any loop.

A context with `tick()` is ticked, one with a rate gets the time it needs, any other runs when it has a cause.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.clock import current_clock
from aiorts.errors import StateError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from aiorts.clock import SimulatedClock
    from aiorts.kernel import Context

T = TypeVar("T")

_LONGEST_NS: Final = 3600 * 10**9
"""Virtual time after which a hook that still waits counts as waiting forever."""


def is_ticked(context: Context) -> bool:
    """Whether this context is driven from outside, by `tick()`."""
    return callable(getattr(context, "tick", None))


def period_ns(rate: float) -> int:
    """The period of a rate in nanoseconds, rounded up."""
    numerator, denominator = float(rate).as_integer_ratio()
    return -(-denominator * 1_000_000_000 // numerator)


async def one_cycle(context: Context, clock: SimulatedClock) -> None:
    """Run one cycle, and everything that follows from it at this moment.

    Raises:
        StateError: the context has a rate and no deadline is pending, or a hook waits for an hour of virtual time.
    """
    tick: Callable[[], Coroutine[Any, Any, None]] | None = getattr(context, "tick", None)
    if tick is not None:
        await while_time_passes(clock, tick())
    elif context.rate is not None:
        await _pass_time_until(clock, context, context.ticks + 1)
    await clock.advance(0)


async def while_time_passes(clock: SimulatedClock, work: Coroutine[Any, Any, T]) -> T:
    """Await `work`; on a loop in real time the clock goes from deadline to deadline as long as `work` waits for it."""
    if current_clock() is clock:
        return await work
    task = asyncio.ensure_future(work)
    limit = clock.monotonic_ns() + _LONGEST_NS
    try:
        while True:
            await clock.advance(0)
            deadline = clock.next_deadline()
            if task.done() or deadline is None:
                return await task
            if deadline > limit:
                raise StateError(
                    f"{clock!r}: a hook still waits after an hour of virtual time; give it what it waits for"
                )
            await clock.advance_to(max(deadline, clock.monotonic_ns()))
    finally:
        task.cancel()


async def _pass_time_until(clock: SimulatedClock, context: Context, ticks: int) -> None:
    await clock.advance(0)
    while context.ticks < ticks:
        deadline = clock.next_deadline()
        if deadline is None:
            raise StateError(
                f"{context!r}: has a rate and waits for no time; does it run, and on the clock of its kernel?"
            )
        await clock.advance_to(max(deadline, clock.monotonic_ns()))
