"""Readers of samples that are held back, for their own reader takes nothing: the kernel ends in order all the same."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections import deque
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.sessions.ahead import Waiting
from aiorts.types import TimedDouble
from control_parts import WAIT, Counter, controlled

pytestmark = pytest.mark.anyio
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


@given(st.lists(st.one_of(st.just("take"), st.integers(0, 3)), max_size=60), st.integers(1, 5))
def test_what_waits_is_kept_in_order_or_missing(actions: list[str | int], room: int) -> None:
    """Against a plain list: `take`, or an item before which the kernel dropped so many."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("aiorts.sessions.ahead.ITEMS", room)
        waiting, kept, came, taken, missed = Waiting(), deque[int](), 0, 0, 0
        for action in actions:
            if action == "take":
                if kept:
                    answer = waiting.take()
                    assert answer["item"] == kept.popleft()
                    taken, missed = taken + 1, missed + answer["missed"]
                continue
            came += 1 + int(action)
            if len(kept) < room:
                kept.append(came)
            waiting.put({"item": came, "missed": int(action)}, 10, bounded=True)
        while kept:
            answer = waiting.take()
            assert answer["item"] == kept.popleft()
            taken, missed = taken + 1, missed + answer["missed"]
        waiting.put({"end": None, "missed": 0}, 10, bounded=True)
        missed += waiting.take()["missed"] + waiting.missed_last()
    assert taken + missed == came
