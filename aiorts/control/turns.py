"""What takes long on the loop, a little at a time, so that everything else of the kernel goes on."""

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
"""For which a look holds the loop, before that has its turn."""


def in_turns(kernel: Microkernel, steps: Iterator[object], made: T) -> T | Awaitable[T]:
    """`made`, once all steps are done: at once where they take less than a turn, else with turns of the loop between.

    In simulated time it is at once: a task would be one more that is ready at this instant.
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
