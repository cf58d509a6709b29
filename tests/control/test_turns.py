"""Long answers give the loop its turns, and leave nothing when they are not wanted any more."""

from __future__ import annotations

import asyncio
import gc
import warnings
from collections.abc import Generator

import pytest

from aiorts import Kernel
from aiorts.control.turns import answer_in_turns

pytestmark = pytest.mark.anyio


def steps(count: int) -> Generator[None, None, int]:
    for _ in range(count):
        yield
    return count


@pytest.mark.parametrize("hold", [0.0, 60.0])
async def test_an_answer_is_whole_whether_it_takes_turns_or_not(hold: float) -> None:
    async with Kernel() as kernel:
        answer = answer_in_turns(kernel, steps(5), hold)
        assert isinstance(answer, int) is (hold > 0.0)
        assert (answer if isinstance(answer, int) else await answer) == 5


async def test_an_answer_that_is_cancelled_before_it_begins_leaves_no_warning() -> None:
    async def later(answer: object) -> None:
        await answer  # type: ignore[misc] # an awaitable

    async with Kernel() as kernel:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            task = asyncio.create_task(later(answer_in_turns(kernel, steps(5), 0.0)))
            task.cancel()
            await asyncio.wait([task])
            del task
            gc.collect()
