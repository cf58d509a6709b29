"""Readers of samples that are held back, for their own reader takes nothing: the kernel ends in order all the same."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest

from aiorts.types import TimedDouble
from control_parts import WAIT, Counter, controlled

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.slow(kept_by="sessions/test_session.py::test_what_waits_is_kept_in_order_or_missing"),
]
READERS = {
    "print": ("print", "src/quick.out"),
    "filter": ("flexidump", "-p", "TimedDouble", "--connect", "src/quick.out"),
}


@asynccontextmanager
async def reader(*words: str) -> AsyncIterator[Process]:
    """A command that begins to take samples; nobody takes what it prints."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "aiorts", *words, stdin=DEVNULL, stdout=PIPE, stderr=PIPE, limit=1 << 10
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def taps(kernel: Any, count: int) -> None:
    async with asyncio.timeout(WAIT):
        while len(kernel.profile().services.get("tool", {}).get("connectors", ())) != count:
            await asyncio.sleep(0.02)


async def end_of(process: Process) -> tuple[list[float], int, str]:
    """The numbers that were printed, how many samples are said to be lost, and all that was said."""
    async with asyncio.timeout(WAIT):
        out, err = (text.decode() for text in await process.communicate())
    numbers = [float(number) for number in re.findall(r"(\d+\.\d+)\}?$", out, re.MULTILINE)]
    lost = re.search(r"(\d+) samples were dropped", err)
    return numbers, int(lost[1]) if lost else 0, err


@pytest.mark.parametrize("words", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("count", "pause"), [(3_000, 0.005), (60_000, 0.0)])
async def test_all_is_printed_or_counted_though_the_source_ended_before_the_reader_went_on(
    words: tuple[str, ...], count: int, pause: float
) -> None:
    async with AsyncExitStack() as stack:
        async with controlled("src") as kernel:
            quick = await kernel.create(Counter, "quick")
            process = await stack.enter_async_context(reader(*words))
            await taps(kernel, 1)
            for number in range(count):
                quick.out.write_nowait(TimedDouble(data=float(number)))
                if number % 40 == 0:
                    await asyncio.sleep(pause)
        numbers, lost, said = await end_of(process)
    assert process.returncode == 0, said
    assert numbers == sorted(set(numbers))
    assert len(numbers) + lost == count, (said, numbers[-3:])
    assert not pause or lost < count // 2


@pytest.mark.parametrize(("words", "status"), [(READERS["filter"], 1), (READERS["print"], 5)], ids=["filter", "print"])
async def test_one_that_was_stopped_for_too_long_is_cut_off_and_told_so(
    words: tuple[str, ...], status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts.control.server.connection.STALL_SECONDS", 0.5)
    async with controlled("src") as kernel:
        quick = await kernel.create(Counter, "quick")
        async with reader(*words) as process:
            await taps(kernel, 1)
            process.send_signal(signal.SIGSTOP)
            async with asyncio.timeout(WAIT):
                while kernel.profile().services.get("tool"):
                    for _ in range(40):
                        quick.out.write_nowait(TimedDouble(data=1.0))
                    await asyncio.sleep(0.001)
            process.send_signal(signal.SIGCONT)
            _, _, said = await end_of(process)
    assert process.returncode == status, said
    assert "runs on, and has cut off this process" in said
