"""Make an answer at once if that takes less than `hold` seconds, else in several turns of the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Generator
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

from aiorts.clock import SimulatedClock
from aiorts.kernel.loop.turns import HOLD_SECONDS, in_turns

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

T = TypeVar("T")


def answer_in_turns(
    kernel: Microkernel, steps: Generator[object, None, T], hold: float = HOLD_SECONDS
) -> T | Awaitable[T]:
    """Take all steps; returns the result of the work, or an awaitable of it where the work takes longer than a turn.

    In simulated time the steps are taken at once: a task for them would be a further one that is ready at this instant.

    Args:
        hold: seconds that a turn may take.
    """
    until = perf_counter() + hold
    simulated = isinstance(kernel.clock, SimulatedClock)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found
        if perf_counter() >= until and not simulated:
            return _Rest(steps, hold)


class _Rest(Awaitable[T]):
    """An awaitable of the steps that are left. A coroutine would warn when it is cancelled before it begins."""

    __slots__ = ("_hold", "_steps")

    def __init__(self, steps: Generator[object, None, T], hold: float) -> None:
        self._steps, self._hold = steps, hold

    def __await__(self) -> Generator[Any, None, T]:
        yield from asyncio.sleep(0).__await__()
        return (yield from in_turns(self._steps, self._hold).__await__())
