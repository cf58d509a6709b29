"""A process of its own that writes a number every 10 ms: `python writing_program.py HOST:PORT CERTIFICATES [NAME]`.

It prints what it warns of; nobody ends it.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from pathlib import Path

from aiorts import Component, Kernel, OutPort
from aiorts.types import TimedLong


class Source(Component):
    out = OutPort(TimedLong)


async def main(address: str, certificates: str, name: str = "writer") -> None:
    logging.basicConfig(stream=sys.stdout, format="%(message)s", level=logging.WARNING)
    near = {"connect": address, "host": "near", "certificates": Path(certificates)}
    async with Kernel(name, services={"zenoh": near}) as kernel:
        source = await kernel.add(Source("source"))
        await kernel.connect(source.out, "far/reader/sink.inp", length=1_000)
        number = 0
        while True:
            source.out.write_nowait(TimedLong(number, number))
            number += 1
            await asyncio.sleep(0.01)


asyncio.run(main(*sys.argv[1:]))
