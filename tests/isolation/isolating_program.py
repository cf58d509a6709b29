"""A program that runs a kernel with two isolated components; one starts a process with a session of its own."""

from __future__ import annotations

import asyncio

from aiorts import EventContext, Kernel
from aiorts.types import TimedLong
from isolation.isolated_parts import Scale, Sink, Source


async def main() -> None:
    """Run until it is killed."""
    async with Kernel() as kernel:
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        for name in ("one", "other"):
            component = await kernel.create_isolated(Scale, name)
            await kernel.start(EventContext(name=f"of_{name}"), component, activate=True)
        await kernel.connect(source.out, "other.inp")
        await kernel.connect("other.out", sink.inp)
        source.out.write_nowait(TimedLong(0, -7))
        await sink.inp.read(timeout=20)
        print("ready", flush=True)
        await asyncio.sleep(100)


if __name__ == "__main__":
    asyncio.run(main())
