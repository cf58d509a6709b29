"""Puts the track of one range finder into the map that all share, once it knows where that range finder is."""

from __future__ import annotations

from cmath import rect
from typing import Protocol

from aiorts import Component, InPort, OutPort, Param, Provided, idempotent
from aiorts.types import Point2D, Pose2D, TimedPoint2D


class Placing(Protocol):
    """What somebody asks for who knows where the range finder is."""

    @idempotent
    async def place(self, pose: Pose2D) -> None:
        """Put the pose into the configuration set "calibrated" and make that the active one."""
        ...


class Transform(Component):
    """Sends nothing in its set "default": a range finder that hangs anywhere has nothing to say about the map."""

    track = InPort(TimedPoint2D, unit="m")
    mapped = OutPort(TimedPoint2D, unit="m")
    placing = Provided[Placing]()

    x = Param(0.0, unit="m")
    y = Param(0.0, unit="m")
    heading = Param(0.0, unit="rad", doc="anticlockwise from the x axis of the map")

    async def place(self, pose: Pose2D) -> None:
        values = {"x": pose.position.x, "y": pose.position.y, "heading": pose.heading}
        await self.configuration.merge({"calibrated": values}, active="calibrated")

    async def on_execute(self) -> None:
        for track in self.track.drain():
            if self.configuration.active != "default":
                point = complex(self.x, self.y) + rect(1.0, self.heading) * complex(track.data.x, track.data.y)
                await self.mapped.write(TimedPoint2D(track.tm, Point2D(point.real, point.imag)))
