"""What a recording says of its system may be asked for in a thread, while components come."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, Kernel
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import about_system


@pytest.mark.anyio
async def test_it_is_told_while_components_come(tmp_path: Path) -> None:
    interval = sys.getswitchinterval()
    async with Kernel() as kernel:
        for _ in range(200):
            await kernel.create(Component)
        logger = await kernel.create(FlexiLogger, inputs=("TimedLong",), logfile=str(tmp_path / "run.mcap"))

        def tell() -> list[dict[str, Any]]:
            return [about_system(kernel, logger.name, 1) for _ in range(30)]

        sys.setswitchinterval(1e-5)
        try:
            telling = asyncio.get_running_loop().run_in_executor(None, tell)
            while not telling.done():
                await kernel.create(Component)
                await asyncio.sleep(0.001)
        finally:
            sys.setswitchinterval(interval)
        assert len((await telling)[-1]["components"]) > 200
