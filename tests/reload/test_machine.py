"""What two processes that never wait do to a system is not blamed on new code, and hides nothing that is its fault."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, asynccontextmanager
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, InPort, Kernel, PeriodicContext
from aiorts.errors import ComponentError
from campaign import CAMPAIGN, time_limit
from machine_parts import spinning

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.campaign,
    pytest.mark.timeout(time_limit(600)),
    pytest.mark.skipif(not CAMPAIGN, reason="needs a machine with nothing else to do; AIORTS_CAMPAIGN=1"),
]
WINDOW = 1.0
WORKER = """
import time

class Worker(Component):
    out = OutPort(float)
    busy = Param(0.0)

    def on_execute(self):
        done = time.thread_time() + self.busy
        while time.thread_time() < done:
            pass
        for _ in range(1):
            self.out.write_nowait(1.0)
        # harmless: 0
"""


class Sink(Component):
    """Reads three samples in each cycle."""

    into = InPort(float)

    def on_execute(self) -> None:
        for _ in range(3):
            if self.into.is_new:
                self.into.read_nowait()


@asynccontextmanager
async def system(file: Source, busy: float) -> AsyncIterator[Kernel]:
    """A writer of 200 Hz that works for a time, and a reader of 50 Hz that loses a quarter of what is written."""
    async with Kernel() as kernel:
        worker: Any = await kernel.create(file.get("Worker"), "worker", busy=busy)
        sink = await kernel.create(Sink, "sink")
        await kernel.connect(worker.out, sink.into, length=4)
        await kernel.start(PeriodicContext(rate=50.0, name="reading"), sink, activate=True)
        await kernel.start(PeriodicContext(rate=200.0, name="working"), worker, activate=True)
        await kernel.sleep(0.3)
        yield kernel


@pytest.mark.parametrize("busy", [0.0, 0.0015])
async def test_harmless_code_is_kept_though_two_processes_begin_to_spin_in_its_window(
    busy: float, source: Make
) -> None:
    file = source(WORKER)
    async with system(file, busy) as kernel:
        for number in range(20):
            file.replace(f"harmless: {number}", f"harmless: {number + 1}")
            old = kernel.components["worker"]
            reload = asyncio.ensure_future(kernel.reload("Worker", window=WINDOW))
            await kernel.sleep(WINDOW)
            async with spinning():
                await reload
            assert kernel.components["worker"] is not old
            await kernel.sleep(0.2)


@pytest.mark.parametrize("beside", [False, True])
async def test_code_that_more_than_doubles_the_drops_of_an_edge_is_taken_back_also_beside_processes_that_spin(
    beside: bool, source: Make
) -> None:
    file = source(WORKER)
    async with system(file, 0.0) as kernel, AsyncExitStack() as stack:
        if beside:
            await stack.enter_async_context(spinning())
            await kernel.sleep(0.2)
        old = kernel.components["worker"]
        # Far more than twice as many: a machine that is busier meanwhile lets fewer be written, and so be dropped.
        file.replace("range(1)", "range(4)")
        for _ in range(20):
            with pytest.raises(ComponentError, match=r"worker\.out-sink\.into: \d+ of \d+ samples were dropped in"):
                await kernel.reload("Worker", window=WINDOW)
            assert kernel.components["worker"] is old
            await kernel.sleep(0.2)
