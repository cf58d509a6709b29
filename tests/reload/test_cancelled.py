"""A caller of `reload` that is cancelled at any turn of the loop leaves a system that works on the new code."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import pytest

import reload_files
from aiorts import Kernel, LifecycleState, PeriodicContext, SimulatedClock
from aiorts.testing import simulate

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

TEXT = """
import reload_files
reload_files.READ.append(__name__)

class Part(Component):
    gain = Param(1.0)
    version = 1

    async def on_execute(self):
        await self.sleep(0.0001)

    async def on_reload(self, old):
        await self.sleep(0.0001)
"""


async def turn_for_threads() -> None:
    """A turn of the loop in which a thread gets on; it waits for hundreds of idle ones until it has the interpreter."""
    time.sleep(0.0002)
    await asyncio.sleep(0)


@pytest.mark.slow(
    kept_by="reload/test_requests.py::test_a_caller_that_is_cancelled_ends_nothing_and_nobody_else_is_called"
)
@pytest.mark.row(23)
@pytest.mark.fault("G05")
def test_cancelled_at_every_turn_a_reload_is_seen_through(source: Callable[[str], Source]) -> None:
    async def cancelled_after(clock: SimulatedClock, turns: int, file: Source) -> bool:
        before = asyncio.all_tasks()
        async with Kernel() as kernel:
            part = await kernel.create(file.get("Part"), "part")
            await kernel.start(PeriodicContext(1000.0), part, activate=True)
            file.replace("version = 1", "version = 2")
            read = len(reload_files.READ)
            task = asyncio.ensure_future(kernel.reload("Part", cycles=3, seconds=0.002))
            while len(reload_files.READ) == read:  # a thread reads the file: until then no two runs are the same
                await turn_for_threads()
            for turn in range(turns):
                await (clock.advance(0.0002) if turn % 4 == 3 else turn_for_threads())
            under_way = not task.done()
            task.cancel()
            await asyncio.wait([task], timeout=10.0)
            assert task.done()
            await kernel.sleep(2.0)
            assert not kernel.registry.renewing
            new: Any = kernel.components["part"]
            assert new.version == 2  # nobody who goes away leaves a change half done
            await new.configure(gain=2.0)
            file.replace("version = 2", "version = 3")
            await kernel.reload("Part")
            last: Any = kernel.components["part"]
            assert (last.version, last.gain, last.state) == (3, 2.0, LifecycleState.ACTIVE)
        assert asyncio.all_tasks() == before
        return under_way

    turns = 0
    while simulate(lambda clock, turns=turns: cancelled_after(clock, turns, source(TEXT))):  # type: ignore[misc]
        turns += 1
        assert turns < 400
    assert turns > 0
