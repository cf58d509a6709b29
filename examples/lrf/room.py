"""What would be bricks and legs: a room, somebody who walks in it, and where the range finders really are.

A point is a complex number, in metres, and so is a direction, of length 1. Only the simulated range finders and who
judges the result know of this file.
"""

from __future__ import annotations

from math import pi, radians, sin
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from aiorts.types import Point2D, Pose2D

Points: TypeAlias = npt.NDArray[np.complex128]
Lengths: TypeAlias = npt.NDArray[np.float64]

POSES: Final = {
    "west": Pose2D(Point2D(-3.9, -0.6), radians(10.0)),
    "north": Pose2D(Point2D(0.8, 2.9), radians(-95.0)),
    "east": Pose2D(Point2D(3.9, 0.4), radians(172.0)),
}
"""Range finder -> where it hangs and which way it looks, on the map."""
HALF: Final = 4.0 + 3.0j
"""The corner of the room; its middle is the map's origin."""
RADIUS: Final = 0.2
"""Of whoever walks there."""
PERIOD: Final = 25_000_000
"""Nanoseconds from scan to scan."""
LAP: Final = 300
"""Scans until the walker is where he was. The noise is that of the place in the lap, so that all laps are alike."""


def walker(number: int) -> complex:
    """Where he is at this scan: on an eight that lies on its side."""
    turn = 2.0 * pi * (number % LAP) / LAP
    return complex(2.4 * sin(turn), 1.4 * sin(2.0 * turn))


def distances(eye: complex, rays: Points, target: complex) -> Lengths:
    """How far each ray goes from `eye`: to the walker, or to the wall."""
    walls = np.minimum(
        (np.copysign(HALF.real, rays.real) - eye.real) / rays.real,
        (np.copysign(HALF.imag, rays.imag) - eye.imag) / rays.imag,
    )
    seen = np.conj(rays) * (target - eye)  # ahead of each ray, and beside it
    depth = RADIUS**2 - seen.imag**2
    return np.where((depth > 0.0) & (seen.real > 0.0), seen.real - np.sqrt(np.maximum(depth, 0.0)), walls)
