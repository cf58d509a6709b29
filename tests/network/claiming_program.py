"""A process of its own whose kernel claims a name: `python claiming_program.py NAME HOST listen|connect HOST:PORT`.

It prints how it stands with its name each time that this changes, and what it warns of; nobody ends it.
"""

from __future__ import annotations

import asyncio
import logging
import sys

from aiorts import Kernel
from aiorts_zenoh import Network


async def main(name: str, host: str, way: str, address: str) -> None:
    logging.basicConfig(stream=sys.stdout, format="%(message)s", level=logging.WARNING)
    async with Kernel(name, services={"zenoh": {way: address, "host": host, "insecure": True}}) as kernel:
        network, before = kernel.service(Network), ""
        while True:
            if (now := network.report()["name"]) != before:
                print(f"standing: {now}", flush=True)
                before = now
            await asyncio.sleep(0.02)


asyncio.run(main(*sys.argv[1:]))
