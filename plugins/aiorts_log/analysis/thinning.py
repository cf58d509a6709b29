"""Selects fewer points that draw the same picture: every peak and every gap stays.

For a curve over time it keeps the first and last point and the least and greatest value of each piece; for a path, the
points that are visibly apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


def thinned(times: Sequence[float], values: Sequence[float], pieces: int) -> list[int]:
    """The numbers of the points to draw, in order; all of them when there are at most four for each piece.

    Args:
        pieces: number of pieces of the time axis; twice as many as there are pixels is more than can be seen.
    """
    count = len(times)
    if count <= 4 * pieces or not count:
        return list(range(count))
    begin, span = times[0], times[-1] - times[0]
    if span <= 0:
        return list(range(0, count, -(-count // (4 * pieces))))
    kept: list[int] = []
    start = 0
    while start < count:
        limit = begin + span * (math.floor((times[start] - begin) / span * pieces) + 1) / pieces
        stop = start + 1
        while stop < count and times[stop] < limit:
            stop += 1
        kept += _of_piece(values, start, stop)
        start = stop
    return kept


def _of_piece(values: Sequence[float], start: int, stop: int) -> list[int]:
    """First, least, greatest and last of the points of a piece, and the first NaN, where the curve has a hole."""
    found = {start, stop - 1}
    # A NaN is not equal to itself.
    numbers = [i for i in range(start, stop) if values[i] == values[i]]
    if numbers:
        found |= {min(numbers, key=values.__getitem__), max(numbers, key=values.__getitem__)}
    if len(numbers) < stop - start:
        found.add(next(i for i in range(start, stop) if values[i] != values[i]))
    return sorted(found)


def thinned_path(xs: Sequence[float], ys: Sequence[float], cells: int) -> list[int]:
    """The numbers of points on a path that are more than the path's size divided by `cells` from the last one kept."""
    pairs = [(x, y) for x, y in zip(xs, ys, strict=True) if math.isfinite(x) and math.isfinite(y)]
    if not pairs:
        return []
    size = max(
        max(x for x, _ in pairs) - min(x for x, _ in pairs),
        max(y for _, y in pairs) - min(y for _, y in pairs),
    )
    least = size / cells
    kept: list[int] = []
    last: tuple[float, float] | None = None
    for i, (x, y) in enumerate(zip(xs, ys, strict=True)):
        if not (math.isfinite(x) and math.isfinite(y)):
            if last is not None:
                kept.append(i)  # keeps the hole
            last = None
        elif last is None or math.hypot(x - last[0], y - last[1]) > least:
            kept.append(i)
            last = x, y
    if kept[-1] != len(xs) - 1:
        kept.append(len(xs) - 1)
    return kept
