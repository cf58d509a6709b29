"""A component in ten lines and the main program that runs it, all in one file.

Run: python examples/hello/hello.py
"""

from __future__ import annotations

from aiorts import Component, Kernel, OutPort, PeriodicContext, run
from aiorts.types import TimedString


class Hello(Component):
    """Says hello in every tick."""

    greeting = OutPort(TimedString)

    async def on_execute(self) -> None:
        await self.greeting.write(TimedString(self.clock.time_ns(), "hello, world"))


async def main() -> None:
    async with Kernel() as kernel:
        hello = await kernel.create(Hello)
        show = await kernel.create("FlexiDump", inputs=["TimedString"], names=["hello"])
        await kernel.connect(hello.greeting, show.ports["hello"])
        await kernel.start(PeriodicContext(rate=10.0), hello, show, activate=True)
        await kernel.sleep(0.25)


if __name__ == "__main__":
    run(main)
