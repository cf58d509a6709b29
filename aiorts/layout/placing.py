"""The places of boxes in bands and columns, and the ways of edges round them.

A column holds boxes at one distance from a source, a band those of one context. Bands of a group stand above one
another, and so do the groups of a pile; piles stand side by side, with an empty column between them. Edges run along
the axes in the room between boxes: down in the channel right of a column, and across columns at a height that is free
in all of them. So no edge runs through a box. `place` lays all out; `add`, `remove` and `route` change one thing, and
nothing else moves.

A pile with more columns than its number of boxes wants is folded: the boxes of each band go on in rows below, like
lines of a text. So 1,000 boxes of two in-ports and two out-ports in 40 bands, with 2,000 edges, become 9,800 x 21,300
pixels.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from itertools import accumulate, pairwise
from typing import Final, TypeAlias

from aiorts.late import dataclass
from aiorts.layout.boxes import HEAD, ROW, Band, Edge, Key, Route, Spot, meets
from aiorts.layout.detour import Point, Rect, around, room
from aiorts.layout.stacking import STEP, Shelf, columns, put_near, rooms_below, shelves_of

_Way: TypeAlias = "tuple[float, float, float, int, int | None]"
"""The heights of an edge at its source, between, and at its target; its track at the source, and at the target, if it
is another."""
_Blocks: TypeAlias = "tuple[list[float], list[float]]"
"""The tops of stretches, in order, and the end of each."""

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
"""Between the boxes, or the edges, at the side of a pile and the empty column next to it."""
_EMPTY: Final = 56.0
"""Width of the empty column between two piles."""
_CLEAR: Final = 14.0
"""Between a column and the first edge that runs down next to it."""
_WIDER: Final = _CLEAR - 6.0
"""The most by which a box added later may be wider than its column: edges still run down at its right."""
_MARGIN: Final = 10.0
"""Between an edge that runs across, and the boxes above and below it."""
_FARTHEST: Final = 4_000
_SPARE: Final = 2
"""Tracks of a channel for edges that come later."""


@dataclass(slots=True)
class Layout:
    """The places of all boxes and bands.

    Attributes:
        spots: the boxes by their keys.
        bands: the bands by their keys, in order.
        groups: of each band, the key of the group that it stands in.
        piles: of each group, the number of the pile that it stands in, from the left; one that is not here is in the
            last.
        moved: the places that `move` was asked for.
        label: the room for the figures of an edge before its in-port.
    """

    spots: dict[Key, Spot] = field(default_factory=dict)
    bands: dict[Key, Band] = field(default_factory=dict)
    groups: dict[Key, str] = field(default_factory=dict)
    piles: dict[str, int] = field(default_factory=dict)
    moved: dict[Key, Point] = field(default_factory=dict)
    label: float = LABEL
    _spans: list[tuple[int, int]] = field(default_factory=lambda: [(0, 0)])
    """By pile: its first column, and the column after its last."""
    _loose: dict[Key, tuple[int, ...]] = field(default_factory=dict)
    """The boxes that `move` has placed outside of columns, and the columns that each of them blocks."""
    _lefts: list[float] = field(default_factory=list)
    _widths: list[float] = field(default_factory=list)
    _taken: dict[int, list[Point]] = field(default_factory=dict)
    """By column: the ranges of height that boxes take, in order."""
    _tracks: dict[int, dict[Key, tuple[int, float, float]]] = field(default_factory=dict)
    """By channel: the track of each edge, and the range of height in which the edge uses it."""
    _runs: dict[int, dict[Key, tuple[int, int]]] = field(default_factory=dict)
    """By height in steps: the columns over which an edge runs there."""
    _heights: dict[Key, int] = field(default_factory=dict)
    """The height in steps at which an edge runs across columns."""
    _ways: dict[Key, _Way] = field(default_factory=dict)
    """The ways of edges between the boxes as they stand."""
    _blocks: dict[tuple[int, int], _Blocks] = field(default_factory=dict)
    """By the first and the last of some columns: the ranges of height in which boxes are in the way there."""

    @property
    def right(self) -> float:
        """The right end of the bands."""
        return max((one.x + one.w for one in self.spots.values()), default=200.0) + LEFT

    def pile_of(self, band: Key) -> int:
        """The number of the pile that a band stands in."""
        return self.piles.get(self.groups.get(band, ""), len(self._spans) - 1)

    def corner(self, band: Key) -> Point:
        """The left and the top of a band that was placed."""
        return self._lefts[self._spans[self.pile_of(band)][0]], self.bands[band].top

    def room_of(self, pile: int) -> tuple[float, float]:
        """The range across in which boxes and edges of a pile may be: up to the empty columns at its sides."""
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
        self._stack(spots, edges, groups, piles)
        self._put_columns(edges)

    def sketch(
        self,
        spots: Sequence[Spot],
        edges: Sequence[Edge],
        groups: Mapping[Key, str],
        piles: Mapping[str, int] | None = None,
    ) -> Point:
        """The width and the height that `place` would come to, the width by estimate: no edge is routed.

        The bands get their places; the boxes get none across, so that nothing else can be asked before `place`.
        """
        self._stack(spots, edges, groups, piles)
        widths, tracks = self._column_widths(), _tracks_wanted(self.spots, edges)
        rooms = [self._room_before(column, tracks.get(column - 1, 0)) for column in range(1, len(widths))]
        bottom = max((one.top + one.height for one in self.bands.values()), default=0.0)
        return LEFT + sum(widths) + sum(rooms), bottom

    def _stack(
        self,
        spots: Sequence[Spot],
        edges: Sequence[Edge],
        groups: Mapping[Key, str],
        piles: Mapping[str, int] | None,
    ) -> None:
        """Find the column of each box, its height, and the places of bands."""
        self.spots = {one.key: one for one in spots}
        self.groups, self.piles = dict(groups), dict(piles or {})
        self._loose.clear()
        for made in (self.bands, self._lefts, self._widths, self._taken, self._tracks, self._runs, self._heights):
            made.clear()
        self._forget_ways()
        self._spans = []
        shelves: dict[Key, list[Shelf]] = {}
        rooms: dict[tuple[Key, int], float] = {}
        first = 0
        for pile in range(max(self.piles.values(), default=0) + 1):
            own = {one.key: one for one in spots if self.piles.get(groups[one.band], 0) == pile}
            inner = [edge for edge in edges if edge.source in own and edge.target in own]
            ranks = columns(own, inner)
            cells: dict[tuple[Key, int], list[Spot]] = {}
            for one in own.values():
                cells.setdefault((one.band, ranks[one.key]), []).append(one)
            put_near(cells, ranks, inner)
            found, folded = shelves_of(cells, len(own))
            for one in own.values():
                one.column += first
            shelves |= found
            rooms |= rooms_below(found, inner) if folded else {}
            end = max((one.column for one in own.values()), default=first) + 1
            self._spans.append((first, end))
            first = end + 1
        order = list(dict.fromkeys(groups.values()))
        for band in sorted(groups, key=lambda band: order.index(groups[band])):
            top = self._begin(band)
            bottom = top + BAND_HEAD
            for number, shelf in enumerate(shelves.get(band, ())):
                bottom = self._put_shelf(shelf, bottom) + rooms.get((band, number), 0.0) + GAP
            self.bands[band] = Band(top, max(bottom - GAP, top + BAND_HEAD) + BAND_FOOT - top)

    def _begin(self, band: Key) -> float:
        """The top of a band that comes below all others of its pile."""
        last = self._last(self.pile_of(band))
        if last is None:
            return GROUP_HEAD
        top = self.bands[last].top + self.bands[last].height
        return top + (BAND_GAP if self.groups.get(last) == self.groups.get(band) else GROUP_GAP + GROUP_HEAD)

    def _put_shelf(self, shelf: Sequence[Sequence[Spot]], top: float) -> float:
        """Put boxes into their columns below a height, each column in the middle; return their lower end."""
        tall = max(sum(one.h + GAP for one in stack) - GAP for stack in shelf)
        for stack in shelf:
            y = top + (tall - sum(one.h + GAP for one in stack) + GAP) / 2
            for one in stack:
                one.y = y
                y += one.h + GAP
                insort(self._taken.setdefault(one.column, []), (one.y, one.y + one.h))
        return top + tall

    def _last(self, pile: int) -> Key | None:
        return next((band for band in reversed(self.bands) if self.pile_of(band) == pile), None)

    def _is_empty(self, column: int) -> bool:
        """Whether a column lies between two piles."""
        return any(column == first - 1 for first, _ in self._spans[1:])

    def _before(self, column: int) -> float:
        """The room between the edges that run down before a column, and its boxes."""
        return _BESIDE - TRACK * 2 if self._is_empty(column) else self.label

    def _column_widths(self) -> list[float]:
        """The width of each column: that of its widest box."""
        widths = [_EMPTY if self._is_empty(column) else 0.0 for column in range(self._spans[-1][1])]
        for one in self.spots.values():
            widths[one.column] = max(widths[one.column], one.w)
        return widths

    def _room_before(self, column: int, tracks: int) -> float:
        """The room between a column and the one before, with so many tracks of edges."""
        if self._is_empty(column - 1) and not tracks:
            return _BESIDE
        return _CLEAR + self._before(column) + TRACK * (tracks + _SPARE)

    def _put_columns(self, edges: Sequence[Edge]) -> None:
        """Put columns next to one another, with room for as many tracks between them as edges take there."""
        self._widths += self._column_widths()
        self._lefts += [LEFT] * len(self._widths)
        for edge in edges:
            self._find_way(edge)  # which track it takes depends on heights alone
        for column in range(1, len(self._widths)):
            tracks = max((track + 1 for track, _, _ in self._tracks.get(column - 1, {}).values()), default=0)
            room = self._room_before(column, tracks)
            self._lefts[column] = self._lefts[column - 1] + self._widths[column - 1] + room
        for one in self.spots.values():
            one.x = self._lefts[one.column] + (self._widths[one.column] - one.w) / 2

    # -- one more, and nothing else moves --------------------------------------------------------------------------

    def add(self, spot: Spot, group: str, before: Iterable[Key] = (), after: Iterable[Key] = ()) -> bool:
        """Place a new box, or a box whose ports changed; such a box keeps its place if there is room.

        Args:
            group: the group of its band, where that is new.
            before, after: the boxes whose edges lead to it, and those that its own lead to.

        Returns:
            Whether it has a place. Else its band is new and cannot stand at the end: all are to be placed again.
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
        wanted = [one.y for one in (*sources, *targets)]
        if old is not None and old.band == spot.band:
            spot.column, wanted = old.column, [old.y]
        elif sources:
            spot.column = max(one.column for one in sources) + 1
        elif targets:
            spot.column = max(first, min(one.column for one in targets) - 1)
        else:
            spot.column = first
        band = self.bands[spot.band]
        wanted = wanted or [band.top + BAND_HEAD]
        y = None
        while y is None:  # the next column where this one is full; behind the last there is always room
            if spot.column >= self._spans[pile][1]:
                if pile + 1 < len(self._spans):
                    return False  # another pile stands there
                spot.column = len(self._lefts)
                self._begin_column(spot.w)
            if spot.w <= self._widths[spot.column] + _WIDER:
                low, high = band.top + BAND_HEAD, band.top + band.height - _FOOT
                y = self._free(spot.column, sum(wanted) / len(wanted), spot.h, low, high)
            if y is None:
                if spot.column == len(self._lefts) - 1 and band.height < BAND_HEAD + spot.h + _FOOT:
                    return False  # higher than its band
                spot.column += 1
        spot.y, spot.x = y, self._lefts[spot.column] + max(0.0, (self._widths[spot.column] - spot.w) / 2)
        self._put(spot, None)
        return True

    def _begin_column(self, width: float) -> None:
        """Add a column at the right: one more of the last pile."""
        self._lefts.append(self._lefts[-1] + self._widths[-1] + self.label + TRACK * 8 if self._lefts else LEFT)
        self._widths.append(width)
        self._spans[-1] = self._spans[-1][0], len(self._lefts)

    def move(self, places: Mapping[Key, Point]) -> None:
        """Put boxes at places, those of their corners at the top left, or where their bands have room next to these.

        Where a pile has no room for one of them, all that are to be moved in it stay.
        """
        piles: dict[int, dict[Key, Spot]] = {}
        for key in places:
            piles.setdefault(self.pile_of(self.spots[key].band), {})[key] = self.spots[key]
        self.moved.update(places)
        for spots in piles.values():
            before = {key: (one.column, one.x, one.y, self._loose.get(key)) for key, one in spots.items()}
            for key in spots:
                self.remove(key)
            if all(self._put_near(one, *places[key]) for key, one in spots.items()):
                continue
            for key in spots:
                self.remove(key)
            for key, one in spots.items():
                one.column, one.x, one.y, loose = before[key]
                self._put(one, loose)

    def _put_near(self, spot: Spot, x: float, y: float) -> bool:
        """Put a box at a place or next to it, in its band; False: there is no room."""
        pile, band = self.pile_of(spot.band), self.bands[spot.band]
        low, high = band.top + BAND_HEAD, band.top + band.height - _FOOT
        for column in range(*self._spans[pile]):
            left = self._lefts[column] + max(0.0, (self._widths[column] - spot.w) / 2)
            if abs(left - x) < 1.0 and self._free(column, y, spot.h, low, high) == y:
                spot.column, spot.x, spot.y = column, left, y  # as one that was laid out
                self._put(spot, None)
                return True
        begin, end = self.room_of(pile)
        within = (begin + _EMPTY, low, end - _BESIDE, high)
        place = room((spot.w, spot.h), (x, y), within, map(_rect, self.spots.values()))
        if place is None:
            return False
        spot.x, spot.y = place
        self._put(spot, self._covered(spot))
        return True

    def _put(self, spot: Spot, loose: tuple[int, ...] | None) -> None:
        """Put a box at its own coordinates: in its column, or in the way of others in these."""
        self.spots[spot.key] = spot
        self._forget_ways()
        if loose is not None:
            self._loose[spot.key] = loose
        for column in (spot.column,) if loose is None else loose:
            insort(self._taken.setdefault(column, []), (spot.y, spot.y + spot.h))

    def _covered(self, spot: Spot) -> tuple[int, ...]:
        """The columns in which, or next to which, a box stands: no edge runs across there at its height."""
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
            self._forget_ways()
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
        x1, x2 = source.x + source.w, target.x - 7
        y1, height, y2, track, other = self._ways.get(edge.key) or self._find_way(edge)
        x = self._x_of(source.column, track)
        if other is None:
            points = [(x1, y1), (x, y1), (x, y2), (x2, y2)]
        else:
            beyond = self._x_of(target.column - 1, other)
            points = [(x1, y1), (x, y1), (x, height), (beyond, height), (beyond, y2), (x2, y2)]
        kept = tuple(
            (round(x, 1), round(y, 1))
            for i, (x, y) in enumerate(points)
            if i in (0, len(points) - 1) or _turns(points, i)
        )
        return Route(kept, (round(x2 - 7, 1), round(y2, 1)))

    def _find_way(self, edge: Edge) -> _Way:
        """The heights and the tracks of an edge; they hold until a box comes, goes or is moved."""
        source, target = self.spots[edge.source], self.spots[edge.target]
        y1 = source.y + source.port_y(edge.out, out=True)
        y2 = target.y + target.port_y(edge.into, out=False)
        first, last = source.column, target.column - 1
        height, other = y2, None
        if last != first:
            height = self._run((first + 1, last) if last > first else (last + 1, first), edge.key, y1, y2)
            other = self._track(last, (*edge.key, "end"), height, y2)
        way = self._ways[edge.key] = y1, height, y2, self._track(first, edge.key, y1, height), other
        return way

    def _track(self, channel: int, key: Key, y1: float, y2: float) -> int:
        """The first track of a channel on which no other edge runs along this one."""
        known, low, high = self._tracks.setdefault(channel, {}), min(y1, y2), max(y1, y2)
        known.pop(key, None)
        used = {track for track, begin, end in known.values() if begin <= high + 8 and end >= low - 8}
        track = next(one for one in range(len(used) + 1) if one not in used)
        known[key] = track, low, high
        return track

    def _x_of(self, channel: int, track: int) -> float:
        """The x of a vertical on a track of a channel."""
        if channel < 0:
            return self._lefts[0] - self.label - TRACK * (track + 1)
        right = self._lefts[channel] + self._widths[channel]
        after = channel + 1
        room = self._lefts[after] - right - self._before(after) - _CLEAR if after < len(self._lefts) else 1e6
        return right + _CLEAR + (track * TRACK) % max(room, TRACK)  # tracks without room lie over others

    def _run(self, over: tuple[int, int], key: Key, y1: float, y2: float) -> float:
        """A height that is free in all columns of a run, near to one of its ends: then it has a bend less."""
        if (before := self._heights.pop(key, None)) is not None:
            self._runs[before].pop(key, None)
        begins, ends = self._blocks_of(over)
        for away in range(_FARTHEST):
            for wanted in (y1, y2) if away == 0 else (y2 - away * STEP, y2 + away * STEP):
                at = bisect_left(begins, wanted + _MARGIN) - 1
                if at >= 0 and ends[at] + _MARGIN > wanted:
                    continue
                height = round(wanted / STEP)
                runs = self._runs.setdefault(height, {})
                if all(end < over[0] or begin > over[1] for begin, end in runs.values()):
                    runs[key] = over
                    self._heights[key] = height
                    return wanted
        return y2

    def _blocks_of(self, over: tuple[int, int]) -> _Blocks:
        """The ranges of height in which boxes are in the way in these columns; those without room between are one."""
        if (known := self._blocks.get(over)) is not None:
            return known
        begins, ends = list[float](), list[float]()
        for begin, end in sorted(pair for at in range(over[0], over[1] + 1) for pair in self._taken.get(at, ())):
            if ends and begin - 2 * _MARGIN <= ends[-1]:
                ends[-1] = max(ends[-1], end)
            else:
                begins.append(begin)
                ends.append(end)
        self._blocks[over] = begins, ends
        return begins, ends

    def _forget_ways(self) -> None:
        """Forget the ways of edges: boxes stand elsewhere, and each way is sought again when it is asked for."""
        self._blocks.clear()
        self._ways.clear()

    def forget(self, key: Key) -> None:
        """Free the room of an edge."""
        self._ways.pop(key, None)
        for tracks in self._tracks.values():
            tracks.pop(key, None)
            tracks.pop((*key, "end"), None)
        if (height := self._heights.pop(key, None)) is not None:
            self._runs[height].pop(key, None)


def _rect(spot: Spot) -> Rect:
    return spot.x, spot.y, spot.x + spot.w, spot.y + spot.h


def _tracks_wanted(spots: Mapping[Key, Spot], edges: Iterable[Edge]) -> dict[int, int]:
    """By channel, the most edges that run down it side by side, as if each kept the height of its in-port elsewhere."""
    turns: dict[int, list[tuple[float, int]]] = {}
    for edge in edges:
        source, target = spots[edge.source], spots[edge.target]
        y1, y2 = source.y + HEAD, target.y + HEAD
        turns.setdefault(source.column, []).extend(((min(y1, y2) - 8, 1), (max(y1, y2) + 8, -1)))
        if target.column != source.column + 1:
            turns.setdefault(target.column - 1, []).extend(((y2 - STEP, 1), (y2 + STEP, -1)))
    return {channel: max(accumulate(by for _, by in sorted(found))) for channel, found in turns.items()}


def _turns(points: Sequence[Point], at: int) -> bool:
    (ax, ay), (bx, by), (cx, cy) = points[at - 1 : at + 2]
    return not (ay == by == cy or ax == bx == cx)
