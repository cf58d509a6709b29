"""What a recording says of its system may be asked for in a thread, while components come."""

from __future__ import annotations

import asyncio
import sys

from aiorts import Component, Kernel
from aiorts_flexi.about import about
from aiorts_flexi.logger import FlexiLogger


async def test_it_is_told_while_components_come(tmp_path: object) -> None:
    interval = sys.getswitchinterval()
    async with Kernel() as kernel:
        for _ in range(200):
            await kernel.create(Component)
        logger = await kernel.create(FlexiLogger, inputs=("TimedLong",), logfile=f"{tmp_path}/run.mcap")
        sys.setswitchinterval(1e-5)
        try:
            telling = asyncio.create_task(asyncio.to_thread(lambda: [about(logger, 1) for _ in range(30)]))
            while not telling.done():
                await kernel.create(Component)
                await asyncio.sleep(0.001)
        finally:
            sys.setswitchinterval(interval)
        assert len((await telling)[-1]["components"]) > 200
