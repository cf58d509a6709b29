"""Boxes, bands, edges and routes: the parts of a picture."""

from __future__ import annotations

from itertools import pairwise
from typing import Final, TypeAlias

from aiorts.late import dataclass
from aiorts.layout.detour import Point

Key: TypeAlias = tuple[str, ...]
"""The name of a box, a band or an edge."""

HEAD: Final = 52.0
"""Height of a box above its ports."""
ROW: Final = 24.0
"""Height of a port."""


@dataclass(slots=True)
class Spot:
    """A box, and its place.

    Args:
        key: its name.
        band: the key of its band.
        inputs, outputs: the names of its ports at the left and at the right, from the top.
        title, kind: texts at its head.
        w: its width; 0: what its texts need.
    """

    key: Key
    band: Key
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    title: str = ""
    kind: str = ""
    column: int = 0
    x: float = 0.0
    y: float = 0.0
    w: float = 0.0
    h: float = 0.0

    def __post_init__(self) -> None:
        sides = [max((len(name) * 7.2 for name in side), default=0.0) for side in (self.inputs, self.outputs)]
        wanted = max(len(self.title) * 8.4 + 64, len(self.kind) * 7.0 + 64, sum(sides) + 48)
        self.w = self.w or min(320.0, max(152.0, wanted))
        self.h = HEAD + ROW * max(1, len(self.inputs), len(self.outputs)) + 8

    def port_y(self, name: str, *, out: bool) -> float:
        """The height of a port below the top of the box."""
        names = self.outputs if out else self.inputs
        return HEAD + ROW * ((names.index(name) if name in names else 0) + 0.5)


@dataclass(frozen=True, slots=True)
class Edge:
    """An edge from a port at the right of a box to one at the left of another."""

    key: Key
    source: Key
    out: str
    target: Key
    into: str


@dataclass(frozen=True, slots=True)
class Route:
    """The way of an edge: its corners, and where its figures end."""

    points: tuple[Point, ...]
    label: Point


@dataclass(frozen=True, slots=True)
class Band:
    """The place of a band, from the top down."""

    top: float
    height: float


def meets(route: Route, spot: Spot) -> bool:
    """Whether an edge runs through a box."""
    left, right, top, bottom = spot.x + 0.5, spot.x + spot.w - 0.5, spot.y + 0.5, spot.y + spot.h - 0.5
    return any(
        max(ax, bx) > left and min(ax, bx) < right and max(ay, by) > top and min(ay, by) < bottom
        for (ax, ay), (bx, by) in pairwise(route.points)
    )
