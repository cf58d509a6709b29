"""What would be steel: an arm with its drive and brake, and a wall that its tool touches. Simulated, in SI units.

The tool is a mass on a drive that follows a speed (a PI loop inside the drive, 5 kHz). The wall is a spring and a
damper that push and never pull; the brake is dry friction. `World` moves as far as its clock did, so that whoever comes
late finds it further on; `Simulator` is a `World` that gives everybody else the beat.
"""

from __future__ import annotations

from dataclasses import dataclass

from aiorts import Component, ExternalContext, InPort, OutPort, Param
from aiorts.types import TimedBoolean, TimedDouble

STEP = 0.0002
"""Seconds of a step of the equations, about."""
VOLT = 20.0
"""N that bend the strain gauge by one volt."""


@dataclass(slots=True)
class Tool:
    """The moving part: `depth` is how far it is in the wall (m), `speed` is towards it (m/s), `force` is on it (N)."""

    mass: float
    stiffness: float
    wall_damping: float
    brake_force: float
    depth: float = 0.0
    speed: float = 0.0
    wound: float = 0.0
    force: float = 0.0
    peak: float = 300.0
    """N, the most that the drive has."""
    bandwidth: float = 400.0
    """rad/s, of the drive's loop."""

    def advance(self, seconds: float, wanted: float, clamped: bool) -> None:
        """Let time pass while the drive is to follow `wanted` m/s, or is without current and clamped."""
        steps = max(1, round(seconds / STEP))
        for _ in range(steps):
            self._step(seconds / steps, wanted, clamped)

    def _step(self, dt: float, wanted: float, clamped: bool) -> None:
        self.force = self.contact()
        if clamped:
            self.wound = 0.0
            speed = self.speed - self.force * dt / self.mass
            grip = self.brake_force * dt / self.mass  # dry friction takes away so much speed, and never more than all
            self.speed = speed - max(-grip, min(grip, speed))
        else:
            error = wanted - self.speed
            thrust = 2.0 * self.mass * self.bandwidth * error + self.wound
            if abs(thrust) < self.peak:
                self.wound += self.mass * self.bandwidth**2 * error * dt
            thrust = max(-self.peak, min(self.peak, thrust))
            self.speed += (thrust - self.force) * dt / self.mass
        self.depth += self.speed * dt

    def contact(self) -> float:
        """What the wall pushes back with, N."""
        if self.depth <= 0.0:
            return 0.0
        return max(0.0, self.stiffness * self.depth + self.wall_damping * self.speed)


class World(Component):
    """The hardware's side of the wires."""

    drive = InPort(TimedDouble, unit="m/s")
    clamp = InPort(TimedBoolean)
    gauge = OutPort(TimedDouble, unit="V", doc="strain gauge, 16 bits over +-5 V")
    encoder = OutPort(TimedDouble, unit="m/s")
    touch = OutPort(TimedDouble, unit="N", doc="what the wall feels; no wire, for the record only")

    mass = Param(4.0, gt=0.0, unit="kg")
    stiffness = Param(5000.0, gt=0.0, unit="N/m", doc="of the wall")
    wall_damping = Param(5.0, ge=0.0, unit="N s/m")
    brake_force = Param(400.0, ge=0.0, unit="N")

    def on_activated(self) -> None:
        self.tool = Tool(self.mass, self.stiffness, self.wall_damping, self.brake_force)
        self.last_ns = self.clock.monotonic_ns()

    async def on_execute(self) -> None:
        now_ns = self.clock.monotonic_ns()
        wanted, clamped = self.drive.latest, self.clamp.latest
        self.tool.advance(
            (now_ns - self.last_ns) / 1e9,
            0.0 if wanted is None else wanted.data,
            clamped is not None and clamped.data,
        )
        self.last_ns = now_ns
        stamp, volts = self.clock.time_ns(), max(-5.0, min(5.0, self.tool.force / VOLT))
        self.gauge.write_nowait(TimedDouble(stamp, round(volts / 10.0 * 65536) * 10.0 / 65536))
        self.encoder.write_nowait(TimedDouble(stamp, self.tool.speed))
        self.touch.write_nowait(TimedDouble(stamp, self.tool.force))


class Simulator(World):
    """Owns time as OpenHRP3 does: after each step of the world the controllers have exactly one tick."""

    drives = Param("loop", doc="the external context to tick")

    async def on_execute(self) -> None:
        await super().on_execute()
        context = self.kernel.contexts[self.drives]
        assert isinstance(context, ExternalContext)
        await context.tick()
