"""Piles of groups of bands, above and next to one another: the whole has about a screen's proportions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Final

from aiorts.layout import BAND_GAP, GROUP_GAP, GROUP_HEAD, Edge, Key, Layout, Point, Spot, columns

_WIDE: Final = 1.55
"""Width of the room for the scene, where its height is 1."""
_MOST: Final = 8
"""The most piles that are tried."""
_GOOD: Final = 0.7
"""Earlier piles are kept if they reach this part of the largest scale: users find things where they stood."""


def placed(
    spots: Sequence[Spot],
    edges: Sequence[Edge],
    groups: Mapping[Key, str],
    units: Mapping[str, str],
    kept: Mapping[str, int] | None = None,
) -> Layout:
    """A layout of as many piles as show the whole at the largest scale.

    Args:
        groups: the group of each band.
        units: the unit of each group; the groups of a unit stay together in one pile.
        kept: the piles of groups that were laid out before; they stay, unless others show the whole far larger.
    """
    layout = Layout()
    size = layout.sketch(spots, edges, groups)
    heights: dict[str, float] = {}
    for band, place in layout.bands.items():
        unit = units[layout.groups[band]]
        heights[unit] = heights.get(unit, GROUP_GAP + GROUP_HEAD) + place.height + BAND_GAP
    linked = _linked(layout, edges, units)
    wanted, best = dict[str, int](), _scale(size)
    for count in range(2, min(len(heights), _MOST) + 1):
        if size[0] > _WIDE * size[1]:
            break  # more piles are wider still
        piles = _dealt(linked, heights, count, units)
        size = layout.sketch(spots, edges, groups, piles)
        if _scale(size) > best:
            wanted, best = piles, _scale(size)
    if kept:
        before = _as_before(kept, heights, units)
        if _scale(layout.sketch(spots, edges, groups, before)) >= _GOOD * best:
            wanted = before
    layout.place(spots, edges, groups, wanted)
    return layout


def _as_before(kept: Mapping[str, int], heights: Mapping[str, float], units: Mapping[str, str]) -> dict[str, int]:
    """The earlier piles, without those that are empty now; new units are in the lowest."""
    before = {units[group]: pile for group, pile in kept.items() if units.get(group) in heights}
    left = sorted({*before.values()}) or [0]
    pile = {unit: left.index(one) for unit, one in before.items()}
    tops = [sum(heights[unit] for unit, at in pile.items() if at == one) for one in range(len(left))]
    for unit in (one for one in heights if one not in pile):
        pile[unit] = tops.index(min(tops))
        tops[pile[unit]] += heights[unit]
    return {group: pile[unit] for group, unit in units.items() if unit in pile}


def _scale(size: Point) -> float:
    """The scale at which a screen shows all of a layout of this size."""
    return min(_WIDE / size[0], 1 / max(1.0, size[1]))


def _linked(layout: Layout, edges: Sequence[Edge], units: Mapping[str, str]) -> list[str]:
    """The units that edges join to others, ordered so that edges lead forwards, where they can."""
    between = []
    for edge in edges:
        source, target = (units[layout.groups[layout.spots[key].band]] for key in (edge.source, edge.target))
        if source != target:
            between.append(Edge(edge.key, (source,), "", (target,), ""))
    ends = dict.fromkeys(key for edge in between for key in (edge.source, edge.target))
    return [unit for (unit,), _ in sorted(columns(ends, between).items(), key=lambda one: one[1])]


def _dealt(linked: Sequence[str], heights: Mapping[str, float], count: int, units: Mapping[str, str]) -> dict[str, int]:
    """The pile of each group, the highest pile as low as possible; groups that edges join follow one another."""
    pile, tops = dict[str, int](), [0.0] * count
    if linked:
        tall, wanted = [heights[unit] for unit in linked], min(count, len(linked))
        sums = sorted({total for at in range(len(tall)) for total in accumulate(tall[at:])})
        most = next(one for one in sums if one >= max(tall) and _piles(tall, one, wanted)[-1] < wanted)
        pile = dict(zip(linked, _piles(tall, most, wanted), strict=True))
    for unit, at in pile.items():
        tops[at] += heights[unit]
    for unit in sorted((one for one in heights if one not in pile), key=lambda one: -heights[one]):
        pile[unit] = tops.index(min(tops))
        tops[pile[unit]] += heights[unit]
    return {group: pile[unit] for group, unit in units.items() if unit in pile}


def _piles(tall: Sequence[float], most: float, count: int) -> list[int]:
    """The pile of each unit where none is higher than `most`, and there are at least `count`."""
    found, pile, height = list[int](), 0, 0.0
    for at, one in enumerate(tall):
        if height and (height + one > most or count - 1 - pile >= len(tall) - at):
            pile, height = pile + 1, 0.0
        height += one
        found.append(pile)
    return found
