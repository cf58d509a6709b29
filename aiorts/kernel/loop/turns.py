"""Long work on the loop, done in turns, so that everything else of the kernel goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from time import perf_counter
from typing import Final, TypeVar

T = TypeVar("T")
HOLD_SECONDS: Final = 0.001
"""How long a turn of such work may hold the loop."""


async def in_turns(steps: Generator[object, None, T], hold: float = HOLD_SECONDS) -> T:
    """Take all steps, with a turn of the loop after each `hold` seconds of them; returns what the work returns."""
    until = perf_counter() + hold
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found
        if perf_counter() >= until:
            await asyncio.sleep(0)
            until = perf_counter() + hold
