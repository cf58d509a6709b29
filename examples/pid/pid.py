"""The component of the README's first minute.

Run: aiorts run examples/pid/system.toml --set pid0.gain=3.0 --simulate --for 5
"""

from __future__ import annotations

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble


class Pid(Component):
    """Proportional controller."""

    measured = InPort(TimedDouble, unit="m")
    command = OutPort(TimedDouble, unit="m/s")
    setpoint = Param(0.0, unit="m")
    gain = Param(1.0, ge=0.0, le=10.0)

    async def on_execute(self) -> None:  # one tick of its execution context
        if (sample := self.measured.latest) is not None:
            await self.command.write(TimedDouble(sample.tm, self.gain * (self.setpoint - sample.data)))
