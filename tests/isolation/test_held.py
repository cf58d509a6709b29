"""A hook holds the process of its component: which one, for how long, and who is blamed at the end."""

from __future__ import annotations

import asyncio

import pytest
from anyio import sleep

from aiorts import EventContext, Kernel
from aiorts.types import TimedLong
from isolation.isolated_parts import Blocked, Scale, Source
from isolation.test_isolated import until

pytestmark = pytest.mark.anyio


async def _blocked(kernel: Kernel, seconds: float) -> tuple[Source, Blocked]:
    source = await kernel.add(Source("source"))
    blocked = await kernel.create_isolated(Blocked, "blocked", seconds=seconds)
    await kernel.connect(source.out, "blocked.inp")
    await kernel.start(EventContext(name="apart"), blocked, activate=True)
    return source, blocked


@pytest.mark.slow
async def test_a_process_that_hooks_hold_one_after_another_is_busy_since_the_one_that_runs_began() -> None:
    async with Kernel() as kernel:
        source, blocked = await _blocked(kernel, 0.8)
        for value in range(8):
            source.out.write_nowait(TimedLong(0, value))
        busy = []
        for _ in range(60):
            await sleep(0.1)
            busy.append(blocked.busy)
        assert max(busy) > 0.5
        assert max(busy[30:]) < 2.0  # and not for as long as there are samples


@pytest.mark.slow
async def test_who_is_killed_at_the_end_since_another_used_up_the_time_is_not_blamed(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with Kernel() as kernel:
        others = []
        for number in range(3):
            others.append(await kernel.create_isolated(Scale, f"scale{number}"))
            await kernel.start(EventContext(name=f"other{number}"), others[-1], activate=True)
        source, blocked = await _blocked(kernel, 30.0)
        source.out.write_nowait(TimedLong(0, 1))
        await until(lambda: blocked.busy)
    # What waits for the process's end goes on a little longer than the kernel.
    await until(lambda: not any(task.get_name().startswith("aiorts") for task in asyncio.all_tasks()))
    killed = [(record.getMessage(), record.name) for record in caplog.records if "killed: " in record.getMessage()]
    assert any("a hook has held it for" in text for text, _ in killed)
    others = [text for text, _ in killed if not text.startswith("killed: a hook has held it for")]
    assert all("others used up the time (blocked: a hook has held it for " in text for text in others), killed
