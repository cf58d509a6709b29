"""Where the robot is, from the counts of its two wheels alone."""

from __future__ import annotations

from math import cos, pi, sin

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import Point2D, Pose2D, TimedPose2D, TimedShortSeq


class Odometry(Component):
    """Adds up the way of each wheel. x is ahead, y to the right, and the heading grows clockwise, as on a compass."""

    encoders = InPort(TimedShortSeq, unit="count", shape=(2,))
    pose = OutPort(TimedPose2D, doc="in the unit of the wheels, mm; heading in rad")

    wheel = Param(72.0, gt=0.0, unit="mm", doc="diameter")
    counts = Param(508.8, gt=0.0, doc="counts in one turn of a wheel")
    base = Param(235.0, gt=0.0, unit="mm", doc="from wheel to wheel")

    def on_activated(self) -> None:
        self.last: tuple[int, int] | None = None
        self.x = self.y = self.heading = 0.0

    async def on_execute(self) -> None:
        for sample in self.encoders.drain():
            left, right = (int(count) for count in sample.data)
            if self.last is not None:
                self.move(steps(self.last[0], left), steps(self.last[1], right))
            self.last = left, right
            await self.pose.write(TimedPose2D(sample.tm, Pose2D(Point2D(self.x, self.y), self.heading)))

    def move(self, left: int, right: int) -> None:
        way = self.wheel * pi / self.counts
        turn = (left - right) * way / self.base
        ahead = (left + right) * way / 2
        self.x += ahead * cos(self.heading + turn / 2)
        self.y += ahead * sin(self.heading + turn / 2)
        self.heading += turn


def steps(old: int, new: int) -> int:
    """Counts from old to new, the short way round: the counter has 16 bits and wraps."""
    return (new - old + 2**15) % 2**16 - 2**15
