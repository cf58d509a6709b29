"""The three devices: force sensor, joystick, arm. Each knows its hardware's wires and nothing of the other two."""

from __future__ import annotations

from typing import Protocol

from aiorts import Component, InPort, OutPort, Param, Provided, Required
from aiorts.types import TimedBoolean, TimedDouble


class Brake(Protocol):
    """What stops the arm."""

    async def engage(self) -> float:
        """Close the brake; it stays closed until the arm is activated again. Returns how fast the arm was, m/s."""
        ...


class ForceSensor(Component):
    """A strain gauge behind the tool: volts become newtons."""

    gauge = InPort(TimedDouble, unit="V")
    force = OutPort(TimedDouble, unit="N")

    scale = Param(20.0, gt=0.0, unit="N/V", doc="from the gauge's calibration")

    def on_activated(self) -> None:
        self.newtons = 0.0

    def on_execute(self) -> None:
        if (reading := self.gauge.latest) is not None:
            self.newtons = self.scale * reading.data
        self.force.write_nowait(TimedDouble(self.clock.time_ns(), self.newtons))


class Joystick(Component):
    """An operator by the book: pushes, pulls back, and in the middle of that presses the red button."""

    push = OutPort(TimedDouble, unit="N")
    button = OutPort(TimedBoolean)
    brake = Required[Brake](timeout=0.1, doc="what the red button closes")

    newtons = Param(10.0, unit="N", doc="how hard it is pushed, and pulled")
    pull_after = Param(500, gt=0, unit="ticks")
    press_after = Param(600, gt=0, unit="ticks")

    def on_activated(self) -> None:
        self.ticks = 0

    async def on_execute(self) -> None:
        now_ns, pulls, presses = self.clock.time_ns(), self.ticks >= self.pull_after, self.ticks >= self.press_after
        self.push.write_nowait(TimedDouble(now_ns, -self.newtons if pulls else self.newtons))
        self.button.write_nowait(TimedBoolean(now_ns, presses))
        if self.ticks == self.press_after:
            await self.brake.proxy.engage()
        self.ticks += 1


class Arm(Component):
    """Hands the speed to the drive and reads the encoder; the brake wins over both."""

    command = InPort(TimedDouble, unit="m/s")
    encoder = InPort(TimedDouble, unit="m/s")
    drive = OutPort(TimedDouble, unit="m/s")
    clamp = OutPort(TimedBoolean, doc="closes the brake's jaws and takes the current from the drive")
    speed = OutPort(TimedDouble, unit="m/s")
    brake = Provided[Brake]()

    def on_activated(self) -> None:
        self.measured = 0.0
        self.clamp.write_nowait(TimedBoolean(self.clock.time_ns(), False))

    async def engage(self) -> float:
        self.clamp.write_nowait(TimedBoolean(self.clock.time_ns(), True))
        return self.measured

    def on_execute(self) -> None:
        if (reading := self.encoder.latest) is not None:
            self.measured = reading.data
        self.speed.write_nowait(TimedDouble(self.clock.time_ns(), self.measured))
        if (wanted := self.command.latest) is not None:
            self.drive.write_nowait(wanted)
