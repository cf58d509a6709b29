"""What the controller of pid.py moves: a cart that does as it is told."""

from __future__ import annotations

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble


class Plant(Component):
    """A cart on a rail: its position is the sum of the speeds it was told."""

    input = InPort(TimedDouble, unit="m/s")
    output = OutPort(TimedDouble, unit="m")
    start = Param(1.0, unit="m")

    def on_activated(self) -> None:
        self.position = self.start

    async def on_execute(self) -> None:
        if (speed := self.input.latest) is not None:
            self.position += speed.data / (self.context.rate or 1.0)
        await self.output.write(TimedDouble(0, self.position))

    def on_deactivated(self) -> None:
        print(f"{self.name} is at {self.position:.3f} m")
