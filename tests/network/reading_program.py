"""A process of its own whose kernel prints what it reads: `python reading_program.py HOST:PORT`; nobody ends it."""

from __future__ import annotations

import asyncio
import os
import sys

from aiorts import Component, InPort, Kernel
from aiorts.types import TimedLong


class Sink(Component):
    inp = InPort(TimedLong, length=1_000)


async def main(address: str) -> None:
    async with Kernel("reader", services={"zenoh": {"listen": address, "host": "far", "insecure": True}}) as kernel:
        sink = await kernel.add(Sink("sink"))
        while True:
            number = (await sink.inp.read(timeout=60.0)).tm
            os.write(1, b"%d\n" % number)  # whole: it may be killed at any moment


asyncio.run(main(sys.argv[1]))
