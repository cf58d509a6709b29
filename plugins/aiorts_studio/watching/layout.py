"""The places of boxes in bands and columns, and the ways of edges round them.

A column holds boxes that are as far from a source, a band those of one context. Bands of a group stand above one
another, and so do the groups of a pile; piles stand side by side, with an empty column between them. Edges run along
the axes in the room between boxes: down in the channel right of a column, and across columns at a height that is free
in all of them. So no edge runs through a box. `place` lays all out; `add`, `remove` and `route` change one thing, and
nothing else moves.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, TypeAlias

from aiorts_studio.watching.detour import Point, Rect, around, room

Key: TypeAlias = tuple[str, ...]
"""The name of a box, a band or an edge."""

HEAD: Final = 52.0
"""Height of a box above its ports."""
ROW: Final = 24.0
"""Height of a port."""
GAP: Final = 40.0
"""Between two boxes of a column."""
TRACK: Final = 12.0
"""Between two edges that run side by side."""
LABEL: Final = 104.0
"""Room for the figures of an edge before its in-port."""
BAND_HEAD: Final = 48.0
BAND_FOOT: Final = 32.0
_FOOT: Final = BAND_FOOT - ROW
"""The least room below the boxes of a band: each may have one port more, and no other moves."""
_NEAR: Final = GAP - ROW
"""The least room between two boxes of a column."""
BAND_GAP: Final = 12.0
GROUP_HEAD: Final = 44.0
"""Height of the title of a group of bands."""
GROUP_GAP: Final = 28.0
LEFT: Final = 28.0
_BESIDE: Final = LEFT + 20.0
"""Between the boxes, or the edges, at the side of a pile and the empty column beside it."""
_EMPTY: Final = 56.0
"""Width of the empty column between two piles."""
_STEP: Final = 16.0
_CLEAR: Final = 14.0
"""Between a column and the first edge that runs down beside it."""
_WIDER: Final = _CLEAR - 6.0
"""By how much a box that comes later may be wider than its column: edges run down right of it all the same."""
_MARGIN: Final = 10.0
"""Between an edge that runs across, and the boxes above and below it."""
_FARTHEST: Final = 4_000


@dataclass(slots=True)
class Spot:
    """A box, and its place.

    Args:
        key: its name.
        band: the key of its band.
        inputs, outputs: the names of its ports at the left and at the right, from the top.
        title, kind: texts at its head; they make it wide enough.
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
        self.w = min(320.0, max(152.0, wanted))
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


@dataclass(slots=True)
class Layout:
    """The places of all boxes and bands.

    Attributes:
        spots: the boxes by their keys.
        bands: the bands by their keys, in order.
        groups: of each band, the key of the group that it stands in.
        piles: of each group, the number of the pile that it stands in, from the left; one that is not here is in the
            last.
        moved: the places that boxes were wished to by `move`.
    """

    spots: dict[Key, Spot] = field(default_factory=dict)
    bands: dict[Key, Band] = field(default_factory=dict)
    groups: dict[Key, str] = field(default_factory=dict)
    piles: dict[str, int] = field(default_factory=dict)
    moved: dict[Key, Point] = field(default_factory=dict)
    _spans: list[tuple[int, int]] = field(default_factory=lambda: [(0, 0)])
    """By pile: its first column, and the one behind its last."""
    _loose: dict[Key, tuple[int, ...]] = field(default_factory=dict)
    """The boxes that `move` has put, which stand in no column, and the columns in which they are in the way."""
    _lefts: list[float] = field(default_factory=list)
    _widths: list[float] = field(default_factory=list)
    _taken: dict[int, list[Point]] = field(default_factory=dict)
    """By column: from where to where there are boxes, in order."""
    _tracks: dict[int, dict[Key, tuple[int, float, float]]] = field(default_factory=dict)
    """By channel: the track of each edge, and from where to where the edge uses it."""
    _runs: dict[int, dict[Key, tuple[int, int]]] = field(default_factory=dict)
    """By height in steps: the columns over which an edge runs there."""
    _heights: dict[Key, int] = field(default_factory=dict)
    """The height in steps at which an edge runs across columns."""

    def pile_of(self, band: Key) -> int:
        """The number of the pile that a band stands in."""
        return self.piles.get(self.groups.get(band, ""), len(self._spans) - 1)

    def room_of(self, pile: int) -> tuple[float, float]:
        """From where to where boxes and edges of a pile may be: to the empty columns at both of its sides."""
        first, end = self._spans[pile]
        left = self._lefts[first - 1] if pile else float("-inf")
        return left, self._lefts[end] if pile + 1 < len(self._spans) else float("inf")

    def place(
        self,
        spots: Sequence[Spot],
        edges: Sequence[Edge],
        groups: Mapping[Key, str],
        piles: Mapping[str, int] | None = None,
    ) -> None:
        """Place everything again.

        Args:
            groups: of each band, the group that it stands in; bands of one group follow one another.
            piles: of each group, the number of its pile, from 0 without gaps; None: there is one pile.
        """
        self.spots = {one.key: one for one in spots}
        self.groups, self.piles = dict(groups), dict(piles or {})
        self._loose.clear()
        for made in (self.bands, self._lefts, self._widths, self._taken, self._tracks, self._runs, self._heights):
            made.clear()
        self._spans = [(0, 0)] * (max(self.piles.values(), default=0) + 1)
        count = 0
        for pile in range(len(self._spans)):
            own = {one.key for one in spots if self.pile_of(one.band) == pile}
            found = columns(
                [key for key in self.spots if key in own],
                [edge for edge in edges if edge.source in own and edge.target in own],
            )
            first = count + (pile > 0)
            for key, column in found.items():
                self.spots[key].column = first + column
            count = first + max(found.values(), default=0) + 1
            self._spans[pile] = first, count
        cells: dict[tuple[Key, int], list[Spot]] = {}
        for one in spots:
            cells.setdefault((one.band, one.column), []).append(one)
        self._put_columns(spots, edges, count)
        self._order(cells, edges)
        order = sorted(dict.fromkeys(groups), key=lambda band: list(dict.fromkeys(groups.values())).index(groups[band]))
        for band in order:
            stacks = [cells.get((band, column), []) for column in range(count)]
            tall = max(0.0, *(sum(one.h + GAP for one in stack) - GAP for stack in stacks))
            top = self._begin(band)
            self.bands[band] = Band(top, BAND_HEAD + tall + BAND_FOOT)
            for stack in stacks:
                y = top + BAND_HEAD + (tall - sum(one.h + GAP for one in stack) + GAP) / 2
                for one in stack:
                    one.x, one.y = self._lefts[one.column] + (self._widths[one.column] - one.w) / 2, y
                    y += one.h + GAP
        for one in spots:
            insort(self._taken.setdefault(one.column, []), (one.y, one.y + one.h))

    def _begin(self, band: Key) -> float:
        """The top of a band that comes below all others of its pile."""
        last = self._last(self.pile_of(band))
        if last is None:
            return GROUP_HEAD
        top = self.bands[last].top + self.bands[last].height
        return top + (BAND_GAP if self.groups.get(last) == self.groups.get(band) else GROUP_GAP + GROUP_HEAD)

    def _last(self, pile: int) -> Key | None:
        return next((band for band in reversed(self.bands) if self.pile_of(band) == pile), None)

    def _put_columns(self, spots: Sequence[Spot], edges: Sequence[Edge], count: int) -> None:
        leaving = [0] * count
        for edge in edges:
            first, last = self.spots[edge.source].column, self.spots[edge.target].column
            leaving[first] += 1
            leaving[max(last - 1, 0)] += last > first + 1 or 0 < last <= first
        x = LEFT
        for column in range(count):
            self._lefts.append(x)
            width = _EMPTY if self._is_empty(column) else 0.0
            self._widths.append(max((one.w for one in spots if one.column == column), default=width))
            # Not all edges run beside one another: half as many tracks are enough nearly always, else some share one.
            x += self._widths[column] + self._before(column + 1) + TRACK * (leaving[column] * 0.5 + 2)
            if self._is_empty(column) and not leaving[column]:
                x += _BESIDE - LABEL - TRACK * 2

    def _is_empty(self, column: int) -> bool:
        """Whether a column lies between two piles."""
        return any(column == first - 1 for first, _ in self._spans[1:])

    def _before(self, column: int) -> float:
        """The room between the edges that run down before a column, and its boxes."""
        return _BESIDE - TRACK * 2 if self._is_empty(column) else LABEL

    def _order(self, cells: dict[tuple[Key, int], list[Spot]], edges: Sequence[Edge]) -> None:
        """Put each box near its neighbours: by the mean place of those before it, then of those after it, and again."""
        near: dict[Key, list[Key]] = {key: [] for key in self.spots}
        for edge in edges:
            near[edge.source].append(edge.target)
            near[edge.target].append(edge.source)
        place = {one.key: float(i) for stack in cells.values() for i, one in enumerate(stack)}
        for sweep in range(6):
            forwards = sweep % 2 == 0
            for (_, column), stack in sorted(cells.items(), key=lambda cell: cell[0][1], reverse=not forwards):
                keys = dict(place)
                for one in stack:
                    if found := [place[n] for n in near[one.key] if (self.spots[n].column < column) is forwards]:
                        keys[one.key] = sum(found) / len(found)
                stack.sort(key=lambda one: (keys[one.key], str(one.key)))
                place.update((one.key, float(i)) for i, one in enumerate(stack))

    # -- one more, and nothing else moves --------------------------------------------------------------------------

    def add(self, spot: Spot, group: str, before: Iterable[Key] = (), after: Iterable[Key] = ()) -> bool:
        """Place one box more, or one that has other ports now: at its old place where that has room.

        Args:
            group: of its band, where that is new.
            before, after: the boxes whose edges lead to it, and those that its own lead to.

        Returns:
            Whether it has a place. Else its band is new and cannot stand at the end: all are to be placed anew.
        """
        old = self.spots.get(spot.key)
        self.remove(spot.key)
        if spot.band not in self.bands:
            is_new = group not in self.groups.values()
            self.groups[spot.band] = group
            last = self._last(self.pile_of(spot.band))
            if last is not None and not is_new and self.groups[last] != group:
                return False
            self.bands[spot.band] = Band(self._begin(spot.band), BAND_HEAD + spot.h + BAND_FOOT)
        pile = self.pile_of(spot.band)
        first, end = self._spans[pile]
        sources, targets = (
            [one for key in side if (one := self.spots.get(key)) is not None and first <= one.column < end]
            for side in (before, after)
        )
        wish = [one.y for one in (*sources, *targets)]
        if old is not None and old.band == spot.band:
            spot.column, wish = old.column, [old.y]
        elif sources:
            spot.column = max(one.column for one in sources) + 1
        elif targets:
            spot.column = max(first, min(one.column for one in targets) - 1)
        else:
            spot.column = first
        band = self.bands[spot.band]
        wish = wish or [band.top + BAND_HEAD]
        y = None
        while y is None:  # the next column where this one is full; behind the last there is always room
            if spot.column >= self._spans[pile][1]:
                if pile + 1 < len(self._spans):
                    return False  # another pile stands there
                spot.column = len(self._lefts)
                self._begin_column(spot.w)
            if spot.w <= self._widths[spot.column] + _WIDER:
                low, high = band.top + BAND_HEAD, band.top + band.height - _FOOT
                y = self._free(spot.column, sum(wish) / len(wish), spot.h, low, high)
            if y is None:
                if spot.column == len(self._lefts) - 1 and band.height < BAND_HEAD + spot.h + _FOOT:
                    return False  # higher than its band
                spot.column += 1
        spot.y, spot.x = y, self._lefts[spot.column] + max(0.0, (self._widths[spot.column] - spot.w) / 2)
        self.spots[spot.key] = spot
        insort(self._taken.setdefault(spot.column, []), (spot.y, spot.y + spot.h))
        return True

    def _begin_column(self, width: float) -> None:
        """Add a column at the right: one more of the last pile."""
        self._lefts.append(self._lefts[-1] + self._widths[-1] + LABEL + TRACK * 8 if self._lefts else LEFT)
        self._widths.append(width)
        self._spans[-1] = self._spans[-1][0], len(self._lefts)

    def move(self, key: Key, x: float, y: float) -> None:
        """Put a box at a place, `x` and `y` of its corner at the top left, or where its band has room next to it."""
        spot = self.spots[key]
        self.remove(key)
        self.moved[key] = x, y
        band, (left, right) = self.bands[spot.band], self.room_of(self.pile_of(spot.band))
        within = (left + _EMPTY, band.top + BAND_HEAD, right - _BESIDE, band.top + band.height - _FOOT)
        place = room((spot.w, spot.h), (x, y), within, map(_rect, self.spots.values()))
        if place is not None:
            spot.x, spot.y = place
        self.spots[key] = spot
        self._loose[key] = self._covered(spot)
        for column in self._loose[key]:
            insort(self._taken.setdefault(column, []), (spot.y, spot.y + spot.h))

    def _covered(self, spot: Spot) -> tuple[int, ...]:
        """The columns in which, or beside which, a box stands: no edge runs across there at its height."""
        first, end = self._spans[self.pile_of(spot.band)]
        rights = [self._lefts[column] + self._widths[column] for column in range(first, end)]
        begins, ends = [float("-inf"), *rights[:-1]], [*self._lefts[first + 1 : end], float("inf")]
        return tuple(
            column
            for column, begin, finish in zip(range(first, end), begins, ends, strict=True)
            if spot.x < finish and spot.x + spot.w > begin
        )

    def remove(self, key: Key) -> None:
        """Forget a box; its room is free again."""
        spot = self.spots.pop(key, None)
        if spot is not None:
            for column in self._loose.pop(key, (spot.column,)):
                if (spot.y, spot.y + spot.h) in self._taken.get(column, ()):
                    self._taken[column].remove((spot.y, spot.y + spot.h))

    def _free(self, column: int, wanted: float, size: float, low: float, high: float) -> float | None:
        """The place nearest to `wanted` for a box of this height; None where there is none."""
        margin = _NEAR
        taken = [one for one in self._taken.get(column, ()) if one[1] > low and one[0] < high]
        ends = [(low - margin, low - margin), *taken, (high + margin, high + margin)]
        room = [(end + margin, begin - margin - size) for (_, end), (begin, _) in pairwise(ends)]
        found = [min(max(wanted, first), last) for first, last in room if first <= last]
        return min(found, key=lambda y: abs(y - wanted), default=None)

    # -- edges -----------------------------------------------------------------------------------------------------

    def route(self, edge: Edge) -> Route:
        """The way of an edge. Each has its own: connectors of one out-port have rates and losses of their own."""
        route = self._along(edge)
        ends = {edge.source, edge.target} & self._loose.keys()
        in_the_way = self.spots.values() if ends else (self.spots[key] for key in self._loose)
        if not any(meets(route, spot) for spot in in_the_way):
            return route
        self.forget(edge.key)
        points = around(route.points[0], route.points[-1], map(_rect, self.spots.values()))
        return route if points is None else Route(points, route.label)

    def _along(self, edge: Edge) -> Route:
        """The way through the channels between columns."""
        source, target = self.spots[edge.source], self.spots[edge.target]
        x1, y1 = source.x + source.w, source.y + source.port_y(edge.out, out=True)
        x2, y2 = target.x - 7, target.y + target.port_y(edge.into, out=False)
        first, last = source.column, target.column - 1
        if last == first:
            x = self._track(first, edge.key, y1, y2)
            points = [(x1, y1), (x, y1), (x, y2), (x2, y2)]
        else:
            height = self._run((first + 1, last) if last > first else (last + 1, first), edge.key, y1, y2)
            x, other = self._track(first, edge.key, y1, height), self._track(last, (*edge.key, "end"), height, y2)
            points = [(x1, y1), (x, y1), (x, height), (other, height), (other, y2), (x2, y2)]
        kept = tuple(
            (round(x, 1), round(y, 1))
            for i, (x, y) in enumerate(points)
            if i in (0, len(points) - 1) or _turns(points, i)
        )
        return Route(kept, (round(x2 - 7, 1), round(y2, 1)))

    def _track(self, channel: int, key: Key, y1: float, y2: float) -> float:
        """The x of a vertical in a channel: the first track on which no other edge is beside it."""
        known, low, high = self._tracks.setdefault(channel, {}), min(y1, y2), max(y1, y2)
        known.pop(key, None)
        used = {track for track, begin, end in known.values() if begin <= high + 8 and end >= low - 8}
        track = next(one for one in range(len(used) + 1) if one not in used)
        known[key] = track, low, high
        if channel < 0:
            return self._lefts[0] - LABEL - TRACK * (track + 1)
        right = self._lefts[channel] + self._widths[channel]
        after = channel + 1
        room = self._lefts[after] - right - self._before(after) - _CLEAR if after < len(self._lefts) else 1e6
        return right + _CLEAR + (track * TRACK) % max(room, TRACK)  # more than there is room for: over one another

    def _run(self, over: tuple[int, int], key: Key, y1: float, y2: float) -> float:
        """A height that is free in all columns of a run, near to one of its ends: then it has a bend less."""
        if (before := self._heights.pop(key, None)) is not None:
            self._runs[before].pop(key, None)
        merged: list[list[float]] = []
        taken = (pair for column in range(over[0], over[1] + 1) for pair in self._taken.get(column, ()))
        for begin, end in sorted(taken):
            if merged and begin - 2 * _MARGIN <= merged[-1][1]:
                merged[-1][1] = max(merged[-1][1], end)
            else:
                merged.append([begin, end])
        begins = [one[0] for one in merged]
        for away in range(_FARTHEST):
            for wanted in (y1, y2) if away == 0 else (y2 - away * _STEP, y2 + away * _STEP):
                at = bisect_left(begins, wanted + _MARGIN) - 1
                height = round(wanted / _STEP)
                runs = self._runs.setdefault(height, {})
                free = at < 0 or merged[at][1] + _MARGIN <= wanted
                if free and all(end < over[0] or begin > over[1] for begin, end in runs.values()):
                    runs[key] = over
                    self._heights[key] = height
                    return wanted
        return y2

    def forget(self, key: Key) -> None:
        """Give the room of an edge free."""
        for tracks in self._tracks.values():
            tracks.pop(key, None)
            tracks.pop((*key, "end"), None)
        if (height := self._heights.pop(key, None)) is not None:
            self._runs[height].pop(key, None)


def _rect(spot: Spot) -> Rect:
    return spot.x, spot.y, spot.x + spot.w, spot.y + spot.h


def meets(route: Route, spot: Spot) -> bool:
    """Whether an edge runs through a box."""
    left, right, top, bottom = spot.x + 0.5, spot.x + spot.w - 0.5, spot.y + 0.5, spot.y + spot.h - 0.5
    return any(
        max(ax, bx) > left and min(ax, bx) < right and max(ay, by) > top and min(ay, by) < bottom
        for (ax, ay), (bx, by) in pairwise(route.points)
    )


def columns(keys: Iterable[Key], edges: Sequence[Edge]) -> dict[Key, int]:
    """The column of each box: the longest way from a box that nothing leads to, ways back left out."""
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


def _turns(points: Sequence[Point], at: int) -> bool:
    (ax, ay), (bx, by), (cx, cy) = points[at - 1 : at + 2]
    return not (ay == by == cy or ax == bx == cx)
