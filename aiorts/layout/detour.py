"""Ways round boxes that were placed by hand, and places for these.

Pure geometry of rectangles: left, top, right, bottom.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from heapq import heappop, heappush
from typing import Final, TypeAlias

Point: TypeAlias = tuple[float, float]
Rect: TypeAlias = tuple[float, float, float, float]

_CLEAR: Final = 14.0
"""Pixels from a port to the first bend."""
_BESIDE: Final = 8.0
"""Pixels between a box and an edge along its side."""
_GAPS: Final = (34.0, 16.0)
"""The least room between two boxes, across and down, in which edges run."""
_TURN: Final = 24.0
"""The extra pixels of way that are accepted to save one bend."""
_REACH: Final = 250.0
"""Pixels that an edge may go beyond both of its ends."""
_MOST: Final = 120
"""The most boxes among which a way is searched; with more, the search would be too slow for a user who drags a box."""
_NEAR: Final = 500.0
"""The most pixels, across or down, from the wanted place of a box to the one that it gets."""


def around(start: Point, end: Point, boxes: Iterable[Rect]) -> tuple[Point, ...] | None:
    """The corners of a way that leaves to the right, arrives from the left and meets no box; None: there is none."""
    first, last = (start[0] + _CLEAR, start[1]), (end[0] - _CLEAR, end[1])
    every = list(boxes)
    near = _within(_hull([(*first, *first), (*last, *last)], _REACH), every)
    in_the_way = _within(_hull(near, _BESIDE), every) if near else []
    if len(in_the_way) > _MOST:
        return None
    xs = sorted({first[0], last[0], *(x for one in near for x in (one[0] - _BESIDE, one[2] + _BESIDE))})
    ys = sorted({first[1], last[1], *(y for one in near for y in (one[1] - _BESIDE, one[3] + _BESIDE))})
    begin, goal = (xs.index(first[0]), ys.index(first[1])), (xs.index(last[0]), ys.index(last[1]))
    queue = [(0.0, 0.0, begin, (1, 0))]
    came: dict[tuple[tuple[int, int], tuple[int, int]], tuple[tuple[int, int], tuple[int, int]]] = {}
    known = {(begin, (1, 0)): 0.0}
    while queue:
        _, cost, at, heading = heappop(queue)
        if at == goal:
            return _corners(start, end, [(xs[i], ys[j]) for i, j in _back(came, at, heading)])
        if cost > known[at, heading]:
            continue
        for turn in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            i, j = at[0] + turn[0], at[1] + turn[1]
            if turn == (-heading[0], -heading[1]) or not (0 <= i < len(xs) and 0 <= j < len(ys)):
                continue
            here, there = (xs[at[0]], ys[at[1]]), (xs[i], ys[j])
            if any(_meets(here, there, one) for one in in_the_way):
                continue
            more = abs(there[0] - here[0]) + abs(there[1] - here[1]) + _TURN * (turn != heading)
            more += _TURN * ((i, j) == goal and turn != (1, 0))
            if cost + more < known.get(((i, j), turn), float("inf")):
                known[(i, j), turn] = cost + more
                came[(i, j), turn] = at, heading
                left_over = abs(there[0] - last[0]) + abs(there[1] - last[1])
                heappush(queue, (cost + more + left_over, cost + more, (i, j), turn))
    return None


def room(size: Point, wanted: Point, within: Rect, boxes: Iterable[Rect]) -> Point | None:
    """The place next to a wanted one where a box overlaps no other, within a rectangle; None where there is none."""
    width, height = size
    across, down = _GAPS
    left, top, right, bottom = within[0], within[1], within[2] - width, within[3] - height
    if right < left or bottom < top:
        return None
    x, y = min(max(wanted[0], left), right), min(max(wanted[1], top), bottom)
    left, top, right, bottom = max(left, x - _NEAR), max(top, y - _NEAR), min(right, x + _NEAR), min(bottom, y + _NEAR)
    near = _within((left - across, top - down, right + width + across, bottom + height + down), boxes)
    xs = {x, *(at for one in near for at in (one[0] - width - across, one[2] + across) if left <= at <= right)}
    ys = {y, *(at for one in near for at in (one[1] - height - down, one[3] + down) if top <= at <= bottom)}
    for _, at, high in sorted((abs(at - x) + abs(high - y), at, high) for at in xs for high in ys):
        if not _within((at - across, high - down, at + width + across, high + height + down), near):
            return at, high
    return None


def _within(rect: Rect, boxes: Iterable[Rect]) -> list[Rect]:
    """The boxes that lie in a rectangle, wholly or in part."""
    left, top, right, bottom = rect
    return [one for one in boxes if one[0] < right and one[2] > left and one[1] < bottom and one[3] > top]


def _hull(rects: Sequence[Rect], more: float) -> Rect:
    """The rectangle around others, and `more` at each side."""
    lefts, tops, rights, bottoms = zip(*rects, strict=True)
    return min(lefts) - more, min(tops) - more, max(rights) + more, max(bottoms) + more


def _meets(one: Point, other: Point, box: Rect) -> bool:
    (ax, ay), (bx, by) = one, other
    slack = _BESIDE / 2
    across = max(ax, bx) > box[0] - slack and min(ax, bx) < box[2] + slack
    return across and max(ay, by) > box[1] - slack and min(ay, by) < box[3] + slack


def _back(
    came: dict[tuple[tuple[int, int], tuple[int, int]], tuple[tuple[int, int], tuple[int, int]]],
    at: tuple[int, int],
    heading: tuple[int, int],
) -> list[tuple[int, int]]:
    found = [at]
    while (at, heading) in came:
        at, heading = came[at, heading]
        found.append(at)
    return found[::-1]


def _corners(start: Point, end: Point, way: Sequence[Point]) -> tuple[Point, ...]:
    """The ends of a way, and the points at which it turns."""
    points = [start, *way, end]
    kept = [points[0]]
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        if not (before[0] == here[0] == after[0] or before[1] == here[1] == after[1]):
            kept.append(here)
    return (*kept, points[-1])
