"""Work that is done a few steps at a time, so that the loop has its turns in between."""

from __future__ import annotations

import asyncio
from collections.abc import Generator
from time import perf_counter
from typing import Final, TypeVar

T = TypeVar("T")
_HOLD_SECONDS: Final = 0.001


async def in_turns(steps: Generator[None, None, T]) -> T:
    """What the work returns; after each millisecond of it the loop has a turn."""
    until = perf_counter() + _HOLD_SECONDS
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found
        if perf_counter() >= until:
            await asyncio.sleep(0)
            until = perf_counter() + _HOLD_SECONDS
