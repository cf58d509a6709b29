"""The force controlled manipulator of the RT-Middleware paper: four components that compute it, and a wall.

An operator pushes a joystick; a damper controller turns that push and the measured contact force into a velocity of
the tip (M x'' + D x' = F); the arm turns the velocity into joint angles and its tip meets a wall; a force sensor
measures what the wall answers. At rest the wall answers exactly what the operator pushes.

    force sensor --force--> damper controller --velocity--> manipulator --tip--> force sensor
    joystick ----push-----^

One context runs the four in this order: force sensor, joystick, damper controller, manipulator. The hooks are plain
`def` and wait for nothing: they run in every kind of context, in a thread and in virtual time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aiorts import Component, Connector, InPort, OutPort, Param
from aiorts.types import Point2D, TimedDoubleSeq, TimedPoint2D, TimedVector2D, TimedVelocity2D, Vector2D, Velocity2D

if TYPE_CHECKING:
    from aiorts import Kernel

PERIOD: Final = 0.002
"""Seconds of a cycle, as in the paper."""

CALIBRATION: Final = np.array(
    [
        [21.3, -0.4, 1.1, -20.8, 0.7, -0.9],
        [0.6, 24.1, -0.8, 0.5, -23.7, 1.2],
        [38.2, 0.9, 37.5, -0.7, 38.9, 36.8],
        [0.11, 1.02, -0.06, 0.09, 0.98, -0.04],
        [-0.97, 0.05, 0.13, 1.01, -0.08, 0.10],
        [0.52, 0.55, -0.49, 0.51, 0.53, -0.56],
    ]
)
"""Newton and newton metres for each millivolt of the six strain gauges."""


class LowPass:
    """A second-order low-pass: two equal first-order stages. Works on numbers and on arrays.

    Args:
        cutoff: Hz of each stage. period: seconds between two samples.
    """

    def __init__(self, cutoff: float, period: float) -> None:
        self._share = 1.0 - math.exp(-2.0 * math.pi * cutoff * period)
        self._first: Any = 0.0
        self._second: Any = 0.0

    def __call__(self, value: Any) -> Any:
        """Filter the next value; an array as result is new each time, so that a record may own it."""
        self._first = self._first + self._share * (value - self._first)
        self._second = self._second + self._share * (self._first - self._second)
        return self._second


class ForceSensor(Component):
    """Six strain gauges on the wrist, a calibration matrix and a low-pass: the wrench (fx, fy, fz, mx, my, mz)."""

    tip = InPort(TimedPoint2D, unit="m")
    force = OutPort(TimedDoubleSeq)
    wall = Param(0.45, unit="m", doc="where the wall stands, along x")
    stiffness = Param(2000.0, unit="N/m", ge=0.0, doc="of the wall")
    cutoff = Param(100.0, unit="Hz", gt=0.0, le=200.0)
    resolution = Param(0.0005, unit="mV", gt=0.0, doc="one step of the converter")

    def on_activated(self) -> None:
        self._gauges = np.linalg.inv(CALIBRATION)
        self._filter = LowPass(self.cutoff, PERIOD)
        self._cycle = 0

    def on_execute(self) -> None:
        sample = self.tip.latest
        depth = 0.0 if sample is None else max(0.0, sample.data.x - self.wall)
        counts = self._converted(-self.stiffness * depth)
        wrench = self._filter(CALIBRATION @ (counts * self.resolution))
        self.force.write_nowait(TimedDoubleSeq(self.clock.time_ns(), wrench))

    def _converted(self, force_x: float) -> Any:
        """The counts that the converter reads: all six gauges with 50 Hz hum, in steps of the resolution."""
        wrench = np.array((force_x, 0.0, 0.0, 0.0, 0.0, 0.0))
        hum = 0.001 * math.sin(2.0 * math.pi * 50.0 * self._cycle * PERIOD)
        self._cycle += 1
        return np.rint((self._gauges @ wrench + hum) / self.resolution)


class Joystick(Component):
    """Two axes of ten bits, a dead band and a low-pass: the push of the operator, who begins after `begin` seconds."""

    push = OutPort(TimedVector2D, unit="N")
    begin = Param(0.1, unit="s", ge=0.0)
    forward = Param(400, ge=-511, le=511, doc="counts of the x axis while the operator pushes")
    scale = Param(0.025, unit="N", doc="for one count")
    dead = Param(12, ge=0, doc="counts round the middle that mean nothing")

    def on_activated(self) -> None:
        self._x, self._y = LowPass(5.0, PERIOD), LowPass(5.0, PERIOD)
        self._cycle = 0

    def on_execute(self) -> None:
        time = self._cycle * PERIOD
        self._cycle += 1
        tremor = round(4.0 * math.sin(2.0 * math.pi * 9.0 * time))
        x = self._x(self._alive((self.forward if time >= self.begin else 0) + tremor))
        y = self._y(self._alive(tremor))
        self.push.write_nowait(TimedVector2D(self.clock.time_ns(), Vector2D(x, y)))

    def _alive(self, counts: int) -> float:
        """The force of one axis, N."""
        return self.scale * counts if abs(counts) > self.dead else 0.0


class DamperController(Component):
    """A virtual mass and damper pushed by both forces: M x'' + D x' = F, integrated once in each cycle.

    `push_x` and `force_x` are the forces along x of the last cycle, N.
    """

    push = InPort(TimedVector2D, unit="N")
    force = InPort(TimedDoubleSeq)
    velocity = OutPort(TimedVelocity2D, unit="m/s")
    mass = Param(2.0, unit="kg", gt=0.0)
    damping = Param(80.0, unit="N s/m", ge=0.0)
    fastest = Param(0.5, unit="m/s", gt=0.0)

    def on_activated(self) -> None:
        self._vx = self._vy = 0.0
        self.push_x = self.force_x = 0.0

    def on_execute(self) -> None:
        push, wrench = self.push.latest, self.force.latest
        if push is None or wrench is None:
            return
        fx, fy = wrench.data[:2].tolist()
        self.push_x, self.force_x = push.data.x, fx
        self._vx = self._step(self._vx, push.data.x + fx)
        self._vy = self._step(self._vy, push.data.y + fy)
        self.velocity.write_nowait(TimedVelocity2D(wrench.tm, Velocity2D(self._vx, self._vy, 0.0)))

    def _step(self, velocity: float, force: float) -> float:
        """The velocity after one cycle; implicit in the damping, so that any D is stable."""
        faster = (velocity + force * PERIOD / self.mass) / (1.0 + self.damping * PERIOD / self.mass)
        return max(-self.fastest, min(self.fastest, faster))


class Manipulator(Component):
    """An arm of two joints in a plane: velocities by the damped inverse of its Jacobian, the tip by its kinematics."""

    velocity = InPort(TimedVelocity2D, unit="m/s")
    tip = OutPort(TimedPoint2D, unit="m")
    joints = OutPort(TimedDoubleSeq, unit="rad")
    upper = Param(0.3, unit="m", gt=0.0)
    lower = Param(0.3, unit="m", gt=0.0)
    shoulder = Param(0.9, unit="rad", doc="at the start")
    elbow = Param(-1.8, unit="rad", doc="at the start")
    lag = Param(0.004, unit="s", ge=0.0, doc="time constant of the joint servos")

    def on_activated(self) -> None:
        self._q1, self._q2 = self.shoulder, self.elbow
        self._w1 = self._w2 = 0.0

    def on_execute(self) -> None:
        sample = self.velocity.latest
        tm = self.clock.time_ns() if sample is None else sample.tm
        wanted1, wanted2 = (0.0, 0.0) if sample is None else self._inverse(sample.data.vx, sample.data.vy)
        share = PERIOD / (PERIOD + self.lag)
        self._w1 += share * (wanted1 - self._w1)
        self._w2 += share * (wanted2 - self._w2)
        self._q1 += self._w1 * PERIOD
        self._q2 += self._w2 * PERIOD
        self.joints.write_nowait(TimedDoubleSeq(tm, [self._q1, self._q2]))
        self.tip.write_nowait(TimedPoint2D(tm, self._forward()))

    def _forward(self) -> Point2D:
        """The position of the tip."""
        both = self._q1 + self._q2
        return Point2D(
            self.upper * math.cos(self._q1) + self.lower * math.cos(both),
            self.upper * math.sin(self._q1) + self.lower * math.sin(both),
        )

    def _inverse(self, vx: float, vy: float) -> tuple[float, float]:
        """Joint velocities: (J^T J + c I)^-1 J^T v, which stays small where the arm is stretched out."""
        both = self._q1 + self._q2
        c, d = -self.lower * math.sin(both), self.lower * math.cos(both)
        a, b = c - self.upper * math.sin(self._q1), d + self.upper * math.cos(self._q1)
        # J = [[a, c], [b, d]]
        m11, m12, m22 = a * a + b * b + 1e-6, a * c + b * d, c * c + d * d + 1e-6
        r1, r2 = a * vx + b * vy, c * vx + d * vy
        determinant = m11 * m22 - m12 * m12
        return (m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant


@dataclass(frozen=True, slots=True)
class Cell:
    """The four components, connected."""

    sensor: ForceSensor
    joystick: Joystick
    damper: DamperController
    arm: Manipulator
    connectors: tuple[Connector, ...]

    @property
    def members(self) -> tuple[Component, ...]:
        """The components in the order of execution."""
        return self.sensor, self.joystick, self.damper, self.arm

    @property
    def settled(self) -> bool:
        """Whether the arm rests at the wall: both forces are there and differ by less than 5 %."""
        push, force = self.damper.push_x, self.damper.force_x
        return push > 1.0 and abs(push + force) < 0.05 * push


async def assemble(
    kernel: Kernel, sensor: ForceSensor | None = None, *, wall: float = 0.45, begin: float = 0.1
) -> Cell:
    """Add the four components to `kernel` and connect them; start a context with `Cell.members` afterwards.

    Args:
        sensor: a force sensor of your own. wall: where the wall stands, m. begin: when the operator pushes, s.
    """
    force = await kernel.add(ForceSensor("force_sensor") if sensor is None else sensor, wall=wall)
    joystick = await kernel.add(Joystick("joystick"), begin=begin)
    damper = await kernel.add(DamperController("damper"))
    arm = await kernel.add(Manipulator("manipulator"))
    pairs: tuple[tuple[Any, Any], ...] = (
        (force.force, damper.force),
        (joystick.push, damper.push),
        (damper.velocity, arm.velocity),
        (arm.tip, force.tip),
    )
    connectors = [await kernel.connect(one, two, length=1) for one, two in pairs]
    return Cell(force, joystick, damper, arm, tuple(connectors))
