"""A kernel of its own that reads numbers: `python link_reader.py FILE LOOP` writes each to FILE, as 8 bytes."""

from __future__ import annotations

import struct
import sys

from aiorts import Component, InPort, Kernel, run
from aiorts.types import TimedOctetSeq


class Sink(Component):
    inp = InPort(TimedOctetSeq)


async def main(file: str) -> None:
    with open(file, "ab", buffering=0) as out:
        async with Kernel("reader", services={"links": {}}) as kernel:
            sink = await kernel.add(Sink("sink"))
            while True:
                first = await sink.inp.read()
                numbers = [first.tm, *(sample.tm for sample in sink.inp.drain())]
                out.write(struct.pack(f"<{len(numbers)}Q", *numbers))


run(lambda: main(sys.argv[1]), loop=sys.argv[2])
