"""The controller: lets the arm give way like a mass on a damper. It asks no clock, so its answers can be repeated.

The law is that of admittance control: the tool is to move as a mass M with a damper D would, pushed by the operator and
pushed back by what it touches,

    M dv/dt + D v = push - force.

D alone is the generalised damper of D. E. Whitney, "Force Feedback Control of Manipulator Fine Motions", Journal of
Dynamic Systems, Measurement, and Control 99(2), 1977; with M it is an impedance as in N. Hogan, "Impedance Control: An
Approach to Manipulation", same journal 107(1), 1985. At rest force = push: it holds the force that the operator asks
for. Against something of stiffness K it is an oscillator of damping ratio D / (2 sqrt(M K)).
"""

from __future__ import annotations

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble


class Damper(Component):
    """Turns two forces into a speed, once in each tick: the same forces, tick by tick, give the same speeds."""

    push = InPort(TimedDouble, unit="N", doc="what the operator wants the tool to push with")
    force = InPort(TimedDouble, unit="N", doc="what it does push with")
    command = OutPort(TimedDouble, unit="m/s", doc="speed of the tool")

    mass = Param(2.0, gt=0.0, unit="kg", doc="M, what the tool feels like")
    damping = Param(200.0, ge=0.0, unit="N s/m", doc="D")
    limit = Param(0.25, gt=0.0, unit="m/s", doc="never faster")
    period = Param(0.002, gt=0.0, unit="s", doc="of a tick")

    def on_activated(self) -> None:
        rate = self.context.rate  # None where somebody else drives: a simulator has no rate of its own
        if rate is not None and abs(rate * self.period - 1.0) > 1e-6:
            raise ValueError(f"period = {self.period:g} s, but {self.context.name} runs at {rate:g} Hz")
        self.speed = 0.0

    def on_execute(self) -> None:
        push, force = self.push.latest, self.force.latest
        if push is None or force is None:
            return
        # Implicit Euler: stable with any damping. The period is the nominal one: a tick that came late is one tick.
        speed = self.speed + (push.data - force.data) * self.period / self.mass
        speed /= 1.0 + self.damping * self.period / self.mass
        self.speed = max(-self.limit, min(self.limit, speed))
        self.command.write_nowait(TimedDouble(force.tm, self.speed))
