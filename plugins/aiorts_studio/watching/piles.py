"""Groups of bands above one another and beside: the whole has about a screen's proportions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from typing import Final

from aiorts.layout import BAND_GAP, GROUP_GAP, GROUP_HEAD, Edge, Key, Layout, Spot, columns

_WIDE: Final = 1.55
"""Width of the room for the scene, where its height is 1."""
_MOST: Final = 8
"""Piles that are tried."""


def placed(spots: Sequence[Spot], edges: Sequence[Edge], groups: Mapping[Key, str], units: Mapping[str, str]) -> Layout:
    """A layout of as many piles as show the whole at the largest scale.

    Args:
        groups: of each band, its group.
        units: of each group, what stays together in one pile with it.
    """
    layout = Layout()
    layout.place(spots, edges, groups)
    heights: dict[str, float] = {}
    for band, place in layout.bands.items():
        unit = units[layout.groups[band]]
        heights[unit] = heights.get(unit, GROUP_GAP + GROUP_HEAD) + place.height + BAND_GAP
    order = _in_order(heights, layout, edges, units)
    tried = {1: _scale(layout)}
    for count in range(2, min(len(order), _MOST) + 1):
        layout.place(spots, edges, groups, _dealt(order, heights, count, units))
        tried[count] = _scale(layout)
    best = max(tried, key=lambda count: (tried[count], -count))
    if best != len(tried):
        layout.place(spots, edges, groups, _dealt(order, heights, best, units))
    return layout


def _scale(layout: Layout) -> float:
    """The scale at which a screen shows all of a layout."""
    right = max((one.x + one.w for one in layout.spots.values()), default=1.0)
    bottom = max((one.top + one.height for one in layout.bands.values()), default=1.0)
    return min(_WIDE / right, 1 / bottom)


def _in_order(heights: Iterable[str], layout: Layout, edges: Sequence[Edge], units: Mapping[str, str]) -> list[str]:
    """The units in an order in which edges between them lead forwards, where they can."""
    between = []
    for edge in edges:
        source, target = (units[layout.groups[layout.spots[key].band]] for key in (edge.source, edge.target))
        between.append(Edge(edge.key, (source,), "", (target,), ""))
    depth = columns(((unit,) for unit in heights), between)
    return sorted(heights, key=lambda unit: depth[unit,])


def _dealt(order: Sequence[str], heights: Mapping[str, float], count: int, units: Mapping[str, str]) -> dict[str, int]:
    """The pile of each group: units that follow one another, and the highest pile as low as can be."""
    tall = [heights[unit] for unit in order]
    sums = sorted({total for at in range(len(tall)) for total in accumulate(tall[at:])})
    most = next(one for one in sums if _piles(tall, one, count)[-1] < count)
    pile = dict(zip(order, _piles(tall, most, count), strict=True))
    return {group: pile[unit] for group, unit in units.items() if unit in pile}


def _piles(tall: Sequence[float], most: float, count: int) -> list[int]:
    """The pile of each unit where none is higher than `most`; as many of them as wanted, where there are enough."""
    found, pile, height = list[int](), 0, 0.0
    for at, one in enumerate(tall):
        left = len(tall) - at
        if height and (height + one > most or count - 1 - pile >= left):
            pile, height = pile + 1, 0.0
        height += one
        found.append(pile)
    return found if max(tall, default=0.0) <= most else [*found[:-1], count]
