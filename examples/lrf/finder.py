"""The range finder, which is simulated: one scan of the room every 25 ms, with noise."""

from __future__ import annotations

from math import radians

import numpy as np

from aiorts import Component, OutPort, Param
from aiorts.types import RangeData, RangerConfig
from room import LAP, PERIOD, POSES, distances, walker

BEAMS = 667
CONFIG = RangerConfig(
    minAngle=radians(-120.0), maxAngle=radians(120.0), angularRes=radians(240.0 / (BEAMS - 1)), frequency=1e9 / PERIOD
)
ANGLES = np.linspace(CONFIG.minAngle, CONFIG.maxAngle, BEAMS)
AT_ONCE = 32
"""Scans in a cycle at the most, where it is late: for so many there is room in its connection."""


class RangeFinder(Component):
    """Measures at whole multiples of 25 ms of the clock, as all range finders do: that is how their tracks match."""

    scan = OutPort(RangeData, unit="m")

    place = Param("west", choices=tuple(POSES), doc="which of them this one is")
    noise = Param(0.01, ge=0.0, unit="m", doc="standard deviation")
    seed = Param(1, ge=0)

    def on_activated(self) -> None:
        self.next = self.clock.time_ns() // PERIOD + 1

    async def on_execute(self) -> None:
        for _ in range(min(AT_ONCE, self.clock.time_ns() // PERIOD + 1 - self.next)):
            await self.scan.write(self.measure(self.next))
            self.next += 1

    def measure(self, number: int) -> RangeData:
        pose = POSES[self.place]
        eye, rays = complex(pose.position.x, pose.position.y), np.exp(1j * (pose.heading + ANGLES))
        noise = np.random.default_rng([self.seed, [*POSES].index(self.place), number % LAP]).normal(size=BEAMS)
        return RangeData(number * PERIOD, distances(eye, rays, walker(number)) + self.noise * noise, config=CONFIG)
