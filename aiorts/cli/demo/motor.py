"""A motor, its speed controller and a source of targets: three components, and a main program that runs them.

Run it: python motor.py
"""

from __future__ import annotations

from aiorts import Component, InPort, Kernel, OutPort, Param, PeriodicContext, run
from aiorts.types import TimedDouble

RATE = 100.0  # Hz: cycles in a second


class Motor(Component):
    """A motor whose speed follows its voltage and its load."""

    voltage = InPort(TimedDouble, unit="V")
    speed = OutPort(TimedDouble, unit="rad/s")
    load = Param(0.0, ge=0.0, le=10.0, unit="N m", doc="what brakes it")
    inertia = Param(0.3, gt=0.0, unit="s", doc="time constant")

    def on_activated(self) -> None:
        self.volts = self.turning = 0.0

    async def on_execute(self) -> None:  # one tick of its execution context
        self.turning += (15.0 * self.volts - 12.0 * self.load - self.turning) / self.inertia / RATE
        await self.speed.write(TimedDouble(self.clock.time_ns(), self.turning))

    def on_state_update(self) -> None:  # the same tick, after every component's on_execute
        if (sample := self.voltage.latest) is not None:
            self.volts = sample.data


class Control(Component):
    """A proportional and integral controller: computes the voltage that brings the speed to its target."""

    target = InPort(TimedDouble, unit="rad/s")
    speed = InPort(TimedDouble, unit="rad/s")
    voltage = OutPort(TimedDouble, unit="V")
    gain = Param(0.15, ge=0.0, le=10.0)
    settling = Param(0.2, gt=0.0, unit="s", doc="time of the integral part")
    most = Param(24.0, gt=0.0, unit="V")

    def on_activated(self) -> None:
        self.wanted = self.integral = 0.0

    async def on_execute(self) -> None:
        if (target := self.target.latest) is not None:
            self.wanted = target.data
        if (now := self.speed.latest) is None:
            return
        error = self.wanted - now.data
        volts = self.gain * (error + self.integral / self.settling)
        if abs(volts) < self.most:  # at the limit the integral waits
            self.integral += error / RATE
        await self.voltage.write(TimedDouble(now.tm, max(-self.most, min(self.most, volts))))


class Steps(Component):
    """Sends a new target now and then, and finishes after the last one."""

    target = OutPort(TimedDouble, unit="rad/s")
    targets: tuple[float, ...] = Param((150.0, 250.0, 50.0), unit="rad/s")
    every = Param(1.0, gt=0.0, unit="s")

    def on_activated(self) -> None:
        self.cycle = 0

    async def on_execute(self) -> None:
        number, at = divmod(self.cycle, max(1, round(self.every * RATE)))
        self.cycle += 1
        if number == len(self.targets):
            self.finish()
        elif at == 0:
            await self.target.write(TimedDouble(self.clock.time_ns(), self.targets[number]))


async def main() -> None:
    async with Kernel() as kernel:  # also inside any asyncio application of yours
        motor, control, steps = Motor("motor0"), Control("control0"), Steps("steps0")
        for component in (motor, control, steps):
            await kernel.add(component)
        await kernel.connect(steps.target, control.target)
        await kernel.connect(motor.speed, control.speed, subscription="new", push="new")
        await kernel.connect(control.voltage, motor.voltage, subscription="new", push="new")
        show = await kernel.create("FlexiDump", inputs=["TimedDouble"], names=["speed"], rate_limit=5.0)
        await kernel.connect(motor.speed, show.ports["speed"])
        await kernel.start(PeriodicContext(rate=RATE), steps, motor, control, show, activate=True)
        await kernel.sleep(steps.every * len(steps.targets))


if __name__ == "__main__":
    run(main)
