"""The column of each box, its place in the stack of boxes there, and where a graph that is too wide goes on below.

This file decides which box stands before, above or below another; it knows no coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import ceil, sqrt
from typing import Final, TypeAlias

from aiorts.layout.boxes import Edge, Key, Spot

Shelf: TypeAlias = "list[list[Spot]]"
"""A row of a band: stacks of boxes, from the left."""

STEP: Final = 16.0
"""Between the heights at which edges run across columns."""
_NARROW: Final = 12
"""The most columns of a graph that is never folded."""
_WIDEST: Final = 0.9
"""The most columns, as a part of the square root of the number of boxes."""
_SHARE: Final = 0.6
"""The part of the edges across columns that find no room between boxes."""


def columns(keys: Iterable[Key], edges: Sequence[Edge]) -> dict[Key, int]:
    """The column of each box: the longest way from a box that nothing leads to, ways back left out.

    A box that nothing leads to stands right before the first that it leads to.
    """
    after: dict[Key, list[Key]] = {key: [] for key in keys}
    for edge in edges:
        if edge.source != edge.target:
            after[edge.source].append(edge.target)
    order, back = _depth_first(after)
    found = dict.fromkeys(after, 0)
    for key in order:
        for other in after[key]:
            if (key, other) not in back:
                found[other] = max(found[other], found[key] + 1)
    led_to = {other for key in after for other in after[key]}
    for key in after.keys() - led_to:
        found[key] = max(0, min((found[other] for other in after[key]), default=1) - 1)
    return found


def _depth_first(after: Mapping[Key, Sequence[Key]]) -> tuple[list[Key], set[tuple[Key, Key]]]:
    """The boxes in an order in which edges lead forwards, and the edges that lead back all the same."""
    leads_to = {other for targets in after.values() for other in targets}
    starts = [*(key for key in after if key not in leads_to), *after]
    state: dict[Key, int] = {}
    order: list[Key] = []
    back: set[tuple[Key, Key]] = set()
    for start in starts:
        if start in state:
            continue
        state[start] = 1
        stack = [(start, iter(after[start]))]
        while stack:
            key, rest = stack[-1]
            other = next(rest, None)
            if other is None:
                state[key] = 2
                order.append(key)
                stack.pop()
            elif other not in state:
                state[other] = 1
                stack.append((other, iter(after[other])))
            elif state[other] == 1:
                back.add((key, other))
    return order[::-1], back


def put_near(cells: Mapping[tuple[Key, int], list[Spot]], ranks: Mapping[Key, int], edges: Sequence[Edge]) -> None:
    """Put each box near its neighbours: by the mean place of those before it, then of those after it, and again."""
    near: dict[Key, list[Key]] = {key: [] for key in ranks}
    for edge in edges:
        near[edge.source].append(edge.target)
        near[edge.target].append(edge.source)
    place = {one.key: float(i) for stack in cells.values() for i, one in enumerate(stack)}
    before, after = (
        {key: [other for other in near[key] if (ranks[other] < rank) is first] for key, rank in ranks.items()}
        for first in (True, False)
    )
    stacks = [stack for _, stack in sorted(cells.items(), key=lambda cell: cell[0][1])]
    for sides, ordered in [(before, stacks), (after, stacks[::-1])] * 3:
        for stack in ordered:
            if len(stack) < 2:
                continue
            wanted = dict[Key, float]()
            for one in stack:
                found = [place[other] for other in sides[one.key]]
                wanted[one.key] = sum(found) / len(found) if found else place[one.key]
            stack.sort(key=lambda one: (wanted[one.key], one.key))
            place.update((one.key, float(i)) for i, one in enumerate(stack))


def shelves_of(cells: Mapping[tuple[Key, int], list[Spot]], count: int) -> tuple[dict[Key, list[Shelf]], bool]:
    """The shelves of each band, from the top; each box gets its column. And whether the graph is folded.

    A graph with more columns than look well is folded: a band begins at the left, has no empty column, puts the
    boxes of a high stack into several columns, and goes on below.
    """
    widest, ranks = max(_NARROW, round(sqrt(count) * _WIDEST)), sorted({rank for _, rank in cells})
    folded = len(ranks) > widest
    sizes: dict[Key, int] = {}
    for (band, _), stack in cells.items():
        sizes[band] = sizes.get(band, 0) + len(stack)
    found: dict[Key, dict[int, Shelf]] = {}
    used = dict[Key, int]()
    for (band, rank), stack in sorted(cells.items(), key=lambda cell: cell[0][1]):
        highest = -(-sizes[band] // widest) + 1 if folded else len(stack)
        for first in range(0, len(stack), highest):
            place = used.get(band, 0) if folded else rank
            used[band] = place + 1
            part = stack[first : first + highest]
            for one in part:
                one.column = place % widest
            found.setdefault(band, {}).setdefault(place // widest, []).append(part)
    return {band: list(shelves.values()) for band, shelves in found.items()}, folded


def rooms_below(shelves: Mapping[Key, Sequence[Shelf]], edges: Sequence[Edge]) -> dict[tuple[Key, int], float]:
    """The room below each shelf for the edges that come across columns to its boxes."""
    homes = {
        one.key: ((band, number), one.column)
        for band, found in shelves.items()
        for number, shelf in enumerate(found)
        for stack in shelf
        for one in stack
    }
    counts: dict[tuple[Key, int], dict[int, int]] = {}
    for edge in edges:
        first, (home, column) = homes[edge.source][1], homes[edge.target]
        known = counts.setdefault(home, {})
        for over in range(min(first + 1, column), max(first, column - 1) + 1) if first != column - 1 else ():
            known[over] = known.get(over, 0) + 1
    return {home: STEP * ceil(_SHARE * max(known.values(), default=0)) for home, known in counts.items()}
