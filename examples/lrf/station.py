"""Asks for the calibration, judges the poses and hands them to those that need them; then the one map is drawn up."""

from __future__ import annotations

from math import degrees, hypot, remainder, tau

import numpy as np

from aiorts import Component, InPort, Param, Required, Synchronizer
from aiorts.types import Pose2D, TimedPoint2D
from calibration import Calibrating
from room import POSES
from transform import Placing


class Operator(Component):
    """Has tape-measured one range finder. Exit status 1 when one of the others is not where it is said to be."""

    calibration = Required[Calibrating]()
    west = Required[Placing](timeout=10.0)
    north = Required[Placing](timeout=10.0)
    east = Required[Placing](timeout=10.0)

    within = Param(0.005, gt=0.0, unit="m")
    within_degrees = Param(0.2, gt=0.0)

    def on_activated(self) -> None:
        self.poses: list[Pose2D] = []

    async def on_execute(self) -> None:
        """Hands the poses out each time, so that a range finder that was started again has its own soon."""
        if not self.poses:
            self.poses = await self.calibrated()
        for transform, pose in zip((self.west, self.north, self.east), self.poses, strict=True):
            await transform.proxy.place(pose)

    async def calibrated(self) -> list[Pose2D]:
        goal = await self.calibration.proxy.calibrate(POSES["west"])
        async for count in goal:
            print(f"{count} matches", flush=True)
        poses = await goal.result()
        wrong = [name for name, pose in zip(POSES, poses, strict=True) if not self.is_right(name, pose)]
        if wrong:
            self.kernel.request_stop(1)
        return poses

    def is_right(self, name: str, pose: Pose2D) -> bool:
        """Print where it is, in digits that are the same wherever this runs, and how far that is from the truth."""
        true = POSES[name]
        away = hypot(pose.position.x - true.position.x, pose.position.y - true.position.y)
        turned = degrees(abs(remainder(pose.heading - true.heading, tau)))
        right = away <= self.within and turned <= self.within_degrees
        print(
            f"{name:5}{pose.position.x:14.10f} m{pose.position.y:14.10f} m{degrees(pose.heading):16.10f} deg:"
            f" {away * 1000.0:.2f} mm and {turned:.3f} deg {'off' if right else 'WRONG'}",
            flush=True,
        )
        return right


class Map(Component):
    """Where the target is, as each of the three has it; ends the run when it has seen that for long enough."""

    west = InPort(TimedPoint2D, unit="m")
    north = InPort(TimedPoint2D, unit="m")
    east = InPort(TimedPoint2D, unit="m")

    matches = Param(300, gt=0, doc="how many points it has in the end")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.sync = Synchronizer(self.west, self.north, self.east, policy="exact", length=256)
        self.points: list[list[complex]] = []

    def on_execute(self) -> None:
        for match in self.sync.drain():
            self.points.append([complex(point.data.x, point.data.y) for point in match])
            if len(self.points) == self.matches:
                points = np.array(self.points)
                apart = np.abs(points - points.mean(axis=1, keepdims=True))
                rms = np.sqrt((apart**2).mean()) * 1000.0
                print(f"on one map: {self.matches} points, {rms:.2f} mm from the middle of the three (rms)", flush=True)
                self.kernel.request_stop(0)
