"""Where range finders are, from the tracks of one target that all of them saw at the same moments."""

from __future__ import annotations

from cmath import phase
from typing import Protocol

import numpy as np
import numpy.typing as npt

from aiorts import Component, Goal, InPort, Param, Provided, Synchronizer
from aiorts.types import Point2D, Pose2D, TimedPoint2D


class Calibrating(Protocol):
    """What somebody asks for who knows where one range finder is."""

    async def calibrate(self, west: Pose2D) -> Goal[int, list[Pose2D]]:
        """The poses of west, north and east, of which the first is known. Feedback: each hundred matches."""
        ...


class Calibration(Component):
    """Gathers tracks that belong together by their stamps while a goal runs, and ends it when they are enough."""

    west = InPort(TimedPoint2D, unit="m")
    north = InPort(TimedPoint2D, unit="m")
    east = InPort(TimedPoint2D, unit="m")
    service = Provided[Calibrating]()

    matches = Param(300, gt=2, doc="how many make a calibration")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.sync = Synchronizer(self.west, self.north, self.east, policy="exact", length=256)
        self.goal: Goal[int, list[Pose2D]] = Goal()

    def calibrate(self, west: Pose2D) -> Goal[int, list[Pose2D]]:
        if self.goal.state == "running":
            raise RuntimeError("it calibrates already")
        self.origin, self.goal = west, Goal()
        self.stamps: list[int] = []
        self.tracks: list[list[complex]] = []
        return self.goal

    def on_execute(self) -> None:
        for match in self.sync.drain():
            if self.goal.state == "running":
                self.gather(match)
        if self.goal.state == "running" and self.goal.cancel_requested:
            self.goal.cancelled()

    def gather(self, match: tuple[TimedPoint2D, TimedPoint2D, TimedPoint2D]) -> None:
        self.stamps.append(match[0].tm)
        self.tracks.append([complex(track.data.x, track.data.y) for track in match])
        if len(self.stamps) == self.matches:
            steps = np.diff(self.stamps)
            lost = round((steps / steps.min() - 1.0).sum())
            print(f"calibrated from {self.matches} matches; {lost} scans in between were lost", flush=True)
            self.goal.succeed(poses_of(np.array(self.tracks).T, self.origin))
        elif len(self.stamps) % 100 == 0:
            self.goal.feedback(len(self.stamps))


def poses_of(tracks: npt.NDArray[np.complex128], first: Pose2D) -> list[Pose2D]:
    """The poses of all sensors, of which the first one's is known; one row of `tracks` for each.

    Each is registered to the first one, in closed form: the turn and the way that make the squares of the distances
    between the same points least. A third sensor has nothing to add to what two say of each other, where all err alike.
    """
    onto = complex(first.position.x, first.position.y) + np.exp(1j * first.heading) * tracks[0]
    poses = []
    for track in tracks:
        turn = np.vdot(track - track.mean(), onto - onto.mean())
        turn /= abs(turn)
        position = onto.mean() - turn * track.mean()
        poses.append(Pose2D(Point2D(position.real, position.imag), phase(turn)))
    return poses
