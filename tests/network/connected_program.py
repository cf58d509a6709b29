"""A process of its own with the readers of many connectors: `python connected_program.py HOST:PORT COMPONENTS`.

For each line of its input it prints how many connectors it has and how many samples it has read, and ends with it.
"""

from __future__ import annotations

import asyncio
import sys

from aiorts import Component, InPort, Kernel
from aiorts.types import TimedLong


class Sink(Component):
    inp = InPort(TimedLong)


async def main(address: str, count: int) -> None:
    async with Kernel("reader", services={"zenoh": {"listen": address, "host": "far", "insecure": True}}) as kernel:
        sinks = [await kernel.add(Sink(f"s{number}")) for number in range(count)]
        read = 0
        print("ready", flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            for sink in sinks:
                while sink.inp.is_new:
                    sink.inp.read_nowait()
                    read += 1
            print(len(kernel.connectors), read, flush=True)


asyncio.run(main(sys.argv[1], int(sys.argv[2])))
