"""What the server takes for 1,000 components, and what a kernel suffers from being watched; `-s` prints the figures."""

from __future__ import annotations

import asyncio
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import studio_measured
from aiorts.sessions import entries
from campaign import CAMPAIGN, time_limit
from control_parts import WAIT, running, until
from studio_measured import COMPONENTS, large, load, slower
from studio_page import ALL, Seen, paging
from studio_parts import Site, seconds_of, serving

pytestmark = [pytest.mark.slow, pytest.mark.row(120)]
SECONDS = 20.0 if CAMPAIGN else 5.0


async def share(page: Seen, pid: int) -> float:
    """The part of a core that the server takes while a page takes what it is told."""

    async def take() -> None:
        while True:
            await page.next()

    taking = asyncio.create_task(take())
    await asyncio.sleep(2.0)
    used, began = seconds_of(pid), time.monotonic()
    await asyncio.sleep(SECONDS)
    found = (seconds_of(pid) - used) / (time.monotonic() - began)
    taking.cancel()
    return found


@pytest.mark.timeout(time_limit(300))
def test_a_thousand_components_are_told_soon_and_watched_at_little_cost(runtime: str, tmp_path: Path) -> None:
    """The first picture within 0.7 s of the server's time and the layout's; then 30 % of a core, 5 % of 30 boxes."""

    async def look(client: Site, pid: int) -> None:
        await client.enter()
        used, began = seconds_of(pid), time.monotonic()
        async with paging(client) as page:
            await page.until(lambda: len(page.boxes) == COMPONENTS and len(page.edges) == 2 * COMPONENTS, 3 * WAIT)
            first, first_wall = seconds_of(pid) - used, time.monotonic() - began
            await page.whole("node0")
            far = await share_of(page, pid, ALL, 0.2)
            all_ = await share_of(page, pid, ALL, 1.0)
            left, top = next((one["x"], one["y"]) for one in page.boxes.values() if one["name"] == "node300")
            rect = [left - 400.0, top - 400.0, left + 2600.0, top + 2200.0]
            seen = sum(rect[0] < one["x"] < rect[2] and rect[1] < one["y"] < rect[3] for one in page.boxes.values())
            near = await share_of(page, pid, rect, 1.0)
        print(f"first picture: {first:.2f} s of the server, {first_wall:.2f} s by the clock; load {load():.1f} a core")
        print(f"of a core: far view {far:.1%}, all in near view {all_:.1%}, {seen} boxes in view {near:.1%}")
        assert first < (0.7 + 0.35) * slower()
        assert max(far, all_) < 0.3 * slower()
        assert near < 0.05 * slower()

    async def share_of(page: Seen, pid: int, rect: list[float], scale: float) -> float:
        await page.say("view", rect=rect, scale=scale)
        return await share(page, pid)

    with running("large", str(large(tmp_path))), serving("large") as (process, client):
        asyncio.run(look(client, process.pid))


@contextmanager
def punctual() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, studio_measured.__file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "runs\n"
        until(lambda: any(one.name == "punctual" for one in entries()))
        yield process
    finally:
        process.kill()
        process.communicate(timeout=WAIT)


def p99(process: subprocess.Popen[str]) -> int:
    """How late 99 of 100 cycles were at most since this was asked last, in ns."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return int(process.stdout.readline())


@pytest.mark.timeout(time_limit(400))
def test_contexts_that_are_watched_are_as_punctual(runtime: str) -> None:
    """Ten contexts at 100 Hz, five alternating pairs: the p99 of lateness stays within 1.2 times of unwatched."""

    async def compare(client: Site, process: subprocess.Popen[str]) -> list[tuple[int, int]]:
        await client.enter()
        found = []
        for _ in range(5 if CAMPAIGN else 2):
            p99(process)
            await asyncio.sleep(SECONDS)
            unwatched = p99(process)
            async with paging(client) as page:
                await page.whole("punctual0")
                p99(process)
                taking = asyncio.create_task(take(page))
                await asyncio.sleep(SECONDS)
                found.append((unwatched, p99(process)))
                taking.cancel()
            await asyncio.sleep(1.0)
        return found

    async def take(page: Seen) -> None:
        while True:
            await page.next()

    with punctual() as process, serving("punctual") as (_, client):
        pairs = asyncio.run(compare(client, process))
    ratio = statistics.median(watched / unwatched for unwatched, watched in pairs)
    said = ", ".join(f"{unwatched / 1e6:.2f} / {watched / 1e6:.2f}" for unwatched, watched in pairs)
    print(f"p99 unwatched / watched, ms: {said}; ratio {ratio:.2f}; load {load():.1f} a core")
    assert ratio < 1.2 * slower()
