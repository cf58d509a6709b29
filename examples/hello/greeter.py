"""A component in ten lines: a parameter, an out-port, and what it does in each tick of whoever runs it."""

from __future__ import annotations

from aiorts import Component, OutPort, Param
from aiorts.types import TimedString


class Hello(Component):
    """Says hello three times."""

    greeting = OutPort(TimedString)
    whom = Param("world")
    said = 0

    async def on_execute(self) -> None:
        self.said += 1
        await self.greeting.write(TimedString(self.clock.time_ns(), f"hello, {self.whom}"))
        if self.said == 3:
            self.finish()
