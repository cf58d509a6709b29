"""What the server takes while nobody looks."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from campaign import CAMPAIGN, time_limit
from control_parts import WAIT, running
from studio_page import paging
from studio_parts import resident, seconds_of, serving

pytestmark = pytest.mark.row(120)
ROOMBA = str(Path(__file__).parents[2] / "examples/roomba/system.toml")
SECONDS = 600.0 if CAMPAIGN else 20.0


@pytest.mark.slow
@pytest.mark.timeout(time_limit(700))
def test_a_server_without_a_page_idles_and_does_not_grow(runtime: str) -> None:
    """At most 0.5 % of a core, and in ten minutes no memory more; before, a page was open and was closed."""

    async def look() -> None:
        await client.enter()
        async with paging(client) as page:
            await page.whole("odometry")

    with running("robot", ROOMBA), serving() as (process, client):
        asyncio.run(asyncio.wait_for(look(), WAIT))
        time.sleep(2.0)  # the page's end is over
        before, used = resident(process.pid), seconds_of(process.pid)
        began = time.monotonic()
        time.sleep(SECONDS)
        share = (seconds_of(process.pid) - used) / (time.monotonic() - began)
        grown = resident(process.pid) - before
    print(f"{SECONDS:g} s without a page: {share:.2%} of a core, {grown / 1024:+.0f} KiB of {before >> 20} MiB")
    assert share <= (0.005 if CAMPAIGN else 0.01)
    assert grown < 1 << 20
