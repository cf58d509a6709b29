"""A kernel inside an asyncio application of your own: it takes no loop, no signal and no logging from you.

Run: python examples/embedding/asyncio_app.py
"""

from __future__ import annotations

import asyncio

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext
from aiorts.types import TimedDouble


class Controller(Component):
    """Steers towards `setpoint`."""

    measured = InPort(TimedDouble, unit="m")
    command = OutPort(TimedDouble, unit="m/s")
    setpoint = Param(1.0, unit="m")
    gain = Param(5.0, ge=0.0, le=10.0)

    async def on_execute(self) -> None:
        if (sample := self.measured.latest) is not None:
            await self.command.write(TimedDouble(sample.tm, self.gain * (self.setpoint - sample.data)))


class Cart(Component):
    """Moves as it is told: 10 ms in every tick."""

    command = InPort(TimedDouble, unit="m/s")
    place = OutPort(TimedDouble, unit="m")
    x = 0.0

    async def on_execute(self) -> None:
        if (sample := self.command.latest) is not None:
            self.x += 0.01 * sample.data
        await self.place.write(TimedDouble(self.clock.time_ns(), self.x))


async def other_work() -> str:
    """What else your application does, on the same loop."""
    await asyncio.sleep(0.5)
    return "the rest of the application went on meanwhile"


async def main() -> None:
    async with Kernel() as kernel:
        controller = await kernel.create(Controller)
        cart = await kernel.create(Cart)
        await kernel.connect(controller.command, cart.command, subscription="new")
        await kernel.connect(cart.place, controller.measured, subscription="new")
        await kernel.start(PeriodicContext(rate=100.0), cart, controller, activate=True)

        print(await other_work())
        print(f"after half a second at {cart.x:.1f} m")
        await controller.configure(setpoint=2.0)
        await kernel.sleep(1.5)
        print(f"after another at {cart.x:.1f} m")


if __name__ == "__main__":
    asyncio.run(main())
