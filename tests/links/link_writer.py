"""A process of its own whose kernel writes numbers to another kernel: `python link_writer.py KERNEL COUNT BYTES`."""

from __future__ import annotations

import asyncio
import sys
import time

from aiorts import Component, Kernel, OutPort
from aiorts.types import TimedOctetSeq


class Source(Component):
    out = OutPort(TimedOctetSeq)


async def main(kernel: str, count: int, size: int) -> None:
    async with Kernel("writer") as here:
        source = await here.add(Source())
        connector = await here.connect(source.out, f"{kernel}/sink0.inp", full="block", timeout=None, length=64)
        payload, worst = bytes(size), 0.0

        async def watch() -> None:
            nonlocal worst
            while True:
                began = time.monotonic()
                await asyncio.sleep(0.001)
                worst = max(worst, time.monotonic() - began - 0.001)

        task = asyncio.ensure_future(watch())
        for number in range(count):
            await source.out.write(TimedOctetSeq(tm=number, data=payload))
        while connector.statistics.in_flight or connector.statistics.buffered:
            await asyncio.sleep(0.01)
        task.cancel()
        ledger = connector.statistics
        print(ledger.written, ledger.acknowledged, dict(ledger.dropped), ledger.balanced, f"{worst:.3f}", flush=True)


asyncio.run(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
