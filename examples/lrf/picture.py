"""Draws the map, and how far the three are from each other on it, as SVG: from a run of system.toml.

Run: python examples/lrf/picture.py

It prints the picture of the guide, aiorts/guide/pages/howto/calibration.svg.
"""

from __future__ import annotations

import contextlib
import io
from cmath import rect
from pathlib import Path
from typing import Any

import numpy as np

from aiorts import Kernel
from aiorts.system import build, load
from aiorts.testing import simulate
from aiorts.types import Point2D, Pose2D
from room import HALF, POSES, Points

COLOURS = {"west": "#0550ae", "north": "#1a7f37", "east": "#b35900"}
METRE, MILLIMETRE = 50.0, 12.0
"""Units of the picture."""
ROOM, REST = 220.0 + 190.0j, 600.0 + 190.0j
"""Where the middles of the two drawings are."""
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#333}.a{fill:none;stroke:#999}"
    ".p{fill:none;stroke-width:2.5;stroke-linecap:round;stroke-opacity:.6}"
)


async def run() -> tuple[Points, dict[str, Pose2D]]:
    """The points on the map, one column for each range finder, and where these are by their configuration sets."""
    async with Kernel() as kernel:
        await build(kernel, load(Path(__file__).with_name("system.toml")))
        await kernel.wait_stop_requested()
        components: Any = kernel.components
        sets = {place: components[f"{place}_transform"].configuration.values for place in POSES}
        poses = {place: Pose2D(Point2D(one["x"], one["y"]), one["heading"]) for place, one in sets.items()}
        return np.array(components["map"].points), poses


def at(middle: complex, point: complex, scale: float) -> str:
    """A point of a drawing whose y axis goes up, on the page, whose y axis goes down."""
    place = middle + scale * point.conjugate()
    return f"{place.real:.1f} {place.imag:.1f}"


def dots(colour: str, middle: complex, points: Points, scale: float) -> str:
    steps = "".join(f"M{at(middle, point, scale)}h0" for point in points)
    return f'<path class="p" stroke="{colour}" d="{steps}"/>'


def drawn() -> str:
    with contextlib.redirect_stdout(io.StringIO()):
        points, poses = simulate(run())
    rest = (points - points.mean(axis=1, keepdims=True)) * 1000.0
    lines = [
        '<svg xmlns="http://www.w3.org/2000/svg" width="780" height="400" viewBox="0 0 780 400">',
        f"<style>{STYLE}</style>",
        '<rect width="780" height="400" rx="6" fill="#fff"/>',
        f'<path class="a" d="M{at(ROOM, -HALF, METRE)}H420V40H20Z"/>',
        '<text x="20" y="368">one map: the walker, as each of the three sees him</text>',
    ]
    for column, (place, colour) in enumerate(COLOURS.items()):
        position = complex(poses[place].position.x, poses[place].position.y)
        x, y = at(ROOM, position, METRE).split()
        ahead = at(ROOM, position + rect(0.5, poses[place].heading), METRE)
        lines += [
            f'<circle cx="{x}" cy="{y}" r="6" fill="{colour}"/><path d="M{x} {y}L{ahead}" stroke="{colour}"/>',
            dots(colour, ROOM, points[column::3, column], METRE),
            dots(colour, REST, rest[:, column], MILLIMETRE),
            f'<text x="{x}" y="{float(y) - 10.0:.1f}" text-anchor="middle">{place}</text>',
        ]
    for radius in (5, 10):
        x, y = at(REST, radius * 1j, MILLIMETRE).split()
        lines += [
            f'<circle class="a" cx="{REST.real:g}" cy="{REST.imag:g}" r="{radius * MILLIMETRE:g}"/>',
            f'<text x="{x}" y="{float(y) - 3.0:.1f}" text-anchor="middle">{radius} mm</text>',
        ]
    lines += [f'<text x="{REST.real:g}" y="368" text-anchor="middle">each one, from the middle of the three</text>']
    return "\n".join([*lines, "</svg>\n"])


if __name__ == "__main__":
    print(drawn(), end="")
