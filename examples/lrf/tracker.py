"""Finds what moves in the scans of one range finder: what is nearer than all that was ever seen behind it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import Point2D, RangeData, TimedPoint2D


class Tracker(Component):
    """Sends where the middle of the one moving target is, as the range finder sees it: x ahead, y to the left."""

    scan = InPort(RangeData, unit="m")
    track = OutPort(TimedPoint2D, unit="m")

    radius = Param(0.2, gt=0.0, unit="m", doc="of the target")
    margin = Param(0.3, gt=0.0, unit="m", doc="how much nearer than the background it is at the least")
    learn = Param(80, gt=0, doc="scans in which it only learns the background; the target has to move meanwhile")

    def on_activated(self) -> None:
        self.background: npt.NDArray[np.float64] = np.zeros(1)
        self.scans = 0

    async def on_execute(self) -> None:
        for scan in self.scan.drain():
            near = scan.ranges < self.background - self.margin
            self.background = np.maximum(self.background, scan.ranges)
            self.scans += 1
            if self.scans > self.learn and np.count_nonzero(near) >= 3:
                angles = np.linspace(scan.config.minAngle, scan.config.maxAngle, len(scan.ranges))
                middle = middle_of((scan.ranges * np.exp(1j * angles))[near], self.radius)
                await self.track.write(TimedPoint2D(scan.tm, Point2D(middle.real, middle.imag)))


def middle_of(points: npt.NDArray[np.complex128], radius: float) -> complex:
    """The middle of the circle that is nearest to points of its near side, in the sense of least squares."""
    middle = points.mean() * (1.0 + radius / abs(points.mean()))
    for _ in range(50):  # each time the rest is about 0.6 of what it was
        spokes = points - middle
        middle = (points - radius * spokes / np.abs(spokes)).mean()
    return complex(middle)
