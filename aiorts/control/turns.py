"""Long work on the loop, done in turns, so that everything else of the kernel goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Iterator
from time import perf_counter
from typing import TYPE_CHECKING, Final, TypeVar

from aiorts.clock import SimulatedClock

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

T = TypeVar("T")
HOLD_SECONDS: Final = 0.001
"""How long a turn of such work may hold the loop."""


def in_turns(kernel: Microkernel, steps: Iterator[object], made: T) -> T | Awaitable[T]:
    """Take all steps, and return `made`: at once where they take less than a turn, else an awaitable of it.

    In simulated time they are taken at once: a task would be one more that is ready at this instant.
    """
    until = perf_counter() + HOLD_SECONDS
    simulated = isinstance(kernel.clock, SimulatedClock)
    for _ in steps:
        if perf_counter() >= until and not simulated:
            return _rest(steps, made)
    return made


async def _rest(steps: Iterator[object], made: T) -> T:
    until = 0.0
    for _ in steps:
        if perf_counter() >= until:
            await asyncio.sleep(0)
            until = perf_counter() + HOLD_SECONDS
    return made
