"""A machine that is busy: two processes that never wait."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

_SPIN = "import time\nend = time.monotonic() + 120\nwhile time.monotonic() < end: pass"


@asynccontextmanager
async def spinning() -> AsyncIterator[None]:
    """Two processes that spin, each for two minutes at the most."""
    made: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        made.extend(subprocess.Popen([sys.executable, "-c", _SPIN]) for _ in range(2))

    def end() -> None:
        for process in made:
            process.kill()
            process.wait(30.0)

    try:
        await asyncio.to_thread(start)
        yield
    finally:
        await asyncio.to_thread(end)
