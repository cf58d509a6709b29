"""Draws a system as SVG: a lane for each context, a column for each step from the sources, boxes with ports, arrows.

The same picture gives the same text. `_Layout` computes the places; the functions write them down.
"""

from __future__ import annotations

from dataclasses import field
from itertools import pairwise
from typing import Final

from aiorts.late import dataclass
from aiorts.system.draw.layout import Box, Picture, Pin

_ROW: Final = 18
_HEAD: Final = 42
_GAP_X: Final = 84
_GAP_Y: Final = 22
_LANE_PAD: Final = 26
_EDGE: Final = 16
_CHAR: Final = 6.8
"""Average width of a character of a port's name, in pixels, rounded up."""
_SWEEPS: Final = 8
_LANES: Final = ("#eef4fb", "#f1f8ee", "#fdf5e9", "#f6f0fa", "#eef8f7", "#fbf0f0")
_STYLE: Final = (
    "text{font-family:'DejaVu Sans',Verdana,sans-serif;font-size:11px;fill:#1f2933}"
    ".lane{stroke:#c5d0db}.title{font-size:12px;fill:#52606d}.name{font-size:13px;font-weight:bold}"
    ".type{font-size:10px;fill:#616e7c}.box{fill:#ffffff;stroke:#486581;stroke-width:1.3}"
    ".rule{stroke:#d9e2ec}.wire{fill:none;stroke:#52606d;stroke-width:1.4}"
    ".label{font-size:9px;fill:#7b4b00}"
    ".paper{fill:#ffffff;fill-opacity:0.8}.in{fill:#2680c2}.out{fill:#c65d21}"
)


def svg(seen: Picture) -> str:
    """The picture as an SVG document."""
    layout = _Layout(seen)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{layout.width:.0f}" height="{layout.height:.0f}" '
        f'viewBox="0 0 {layout.width:.0f} {layout.height:.0f}">',
        f"<style>{_STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0.5 L8,4 L0,7.5 z" fill="#52606d"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for number, (group, depth) in enumerate(layout.groups):
        top, height = layout.extent(number)
        left = _EDGE * (0.5 + depth * 0.75)
        shade = sum(not one for _, one in layout.groups[: number + 1]) - 1 + depth
        lines.append(
            f'<rect class="lane" x="{left:g}" y="{top:.0f}" width="{layout.width - 2 * left:.0f}" '
            f'height="{height:.0f}" rx="8" fill="{_LANES[shade % len(_LANES)]}"/>'
        )
        lines.append(f'<text class="title" x="{left + 12:g}" y="{top + 17:.0f}">{_escaped(group.title)}</text>')
    labels = []
    for number, arrow in enumerate(seen.arrows):
        way, (x, y) = layout.way(number)
        what = f"{'.'.join(arrow.source)} → {'.'.join(arrow.target)}" + (f" ({arrow.label})" if arrow.label else "")
        lines.append(f'<path class="wire" marker-end="url(#tip)" d="{way}"><title>{_escaped(what)}</title></path>')
        if arrow.label:
            width = len(arrow.label) * 5.6 + 4
            labels.append(
                f'<rect class="paper" x="{x - width:.0f}" y="{y - 9:.0f}" width="{width:.0f}" height="11" rx="2"/>'
                f'<text class="label" x="{x - 2:.0f}" y="{y:.0f}" text-anchor="end">{_escaped(arrow.label)}</text>'
            )
    for spot in layout.spots.values():
        if spot.box is not None:
            lines += _box(spot.box, spot)
    return "\n".join([*lines, *labels, "</svg>"]) + "\n"


def _escaped(text: str) -> str:
    """Text for XML. Not `xml.sax.saxutils`: it imports `urllib`, which would slow down every start."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _box(box: Box, spot: _Spot) -> list[str]:
    x, y, middle = spot.x, spot.y, spot.x + spot.width / 2
    lines = [
        f'<rect class="box" x="{x:.1f}" y="{y:.1f}" width="{spot.width:.1f}" height="{spot.height:.1f}" rx="5"/>',
        f'<text class="name" x="{middle:.1f}" y="{y + 17:.1f}" text-anchor="middle">{_escaped(box.name)}</text>',
        f'<text class="type" x="{middle:.1f}" y="{y + 32:.1f}" text-anchor="middle">{_escaped(box.type)}</text>',
    ]
    if box.pins:
        end = x + spot.width
        lines.append(
            f'<line class="rule" x1="{x:.1f}" x2="{end:.1f}" y1="{y + _HEAD - 4:.1f}" y2="{y + _HEAD - 4:.1f}"/>'
        )
    for pin in box.pins:
        where = _pin_y(spot, pin.name, pin.out)
        edge, text = (x + spot.width, x + spot.width - 8) if pin.out else (x, x + 8)
        side = "end" if pin.out else "start"
        lines.append(f'<circle class="{"out" if pin.out else "in"}" cx="{edge:.1f}" cy="{where:.1f}" r="3.5"/>')
        lines.append(f'<text x="{text:.1f}" y="{where + 4:.1f}" text-anchor="{side}">{_escaped(pin.name)}</text>')
        if pin.type:
            beside = text + (-1 if pin.out else 1) * (len(pin.name) * _CHAR + 10)
            place = f'x="{beside:.1f}" y="{where + 4:.1f}" text-anchor="{side}"'
            lines.append(f'<text class="type" {place}>{_escaped(pin.type)}</text>')
    return lines


@dataclass(slots=True)
class _Spot:
    """The place of a box, or of an arrow on its way through a column (then without a box)."""

    key: str
    box: Box | None
    lane: int
    column: int
    width: float
    height: float
    x: float = 0.0
    y: float = 0.0
    before: list[str] = field(default_factory=list)
    after: list[str] = field(default_factory=list)

    @property
    def middle(self) -> float:
        return self.y + self.height / 2


class _Layout:
    """Places boxes: columns by the longest way from a source, lanes by context, ordered so that few arrows cross."""

    def __init__(self, seen: Picture) -> None:
        self._seen = seen
        self.groups = [pair for group in seen.groups for pair in group.flat()]
        """The lanes: contexts, and after each the composites in it, with how deep they lie."""
        lane_of = {box.name: number for number, (group, _) in enumerate(self.groups) for box in group.boxes}
        self._columns = _columns(seen)
        self.spots: dict[str, _Spot] = {}
        for box in seen.boxes:
            width, height = _size(box)
            self.spots[box.name] = _Spot(box.name, box, lane_of[box.name], self._columns[box.name], width, height)
        self._chains = [self._chain(number) for number in range(len(seen.arrows))]
        self._order()
        self._place()

    def _chain(self, number: int) -> list[str]:
        """The spots of an arrow: its ends, and one in each column between them."""
        arrow = self._seen.arrows[number]
        here, there = arrow.source[0], arrow.target[0]
        first, last = self._columns[here], self._columns[there]
        keys = [here]
        for column in range(first + 1, last):
            key = f"{number}/{column}"
            self.spots[key] = _Spot(key, None, self.spots[there].lane, column, 0.0, 6.0)
            keys.append(key)
        keys.append(there)
        if last > first:
            for one, other in pairwise(keys):
                self.spots[one].after.append(other)
                self.spots[other].before.append(one)
        return keys

    def _order(self) -> None:
        """Move each spot near its neighbours: sweep in both directions and sort by their mean place."""
        self._cells: dict[tuple[int, int], list[_Spot]] = {}
        for spot in self.spots.values():
            self._cells.setdefault((spot.column, spot.lane), []).append(spot)
        columns = max((spot.column for spot in self.spots.values()), default=0) + 1
        self._count = columns
        ranks = {spot.key: float(number) for number, spot in enumerate(self.spots.values())}
        for sweep in range(_SWEEPS):
            order = range(columns) if sweep % 2 == 0 else range(columns - 1, -1, -1)
            for column in order:
                place = 0
                for lane in range(len(self.groups)):
                    cell = self._cells.get((column, lane), [])
                    wanted = {
                        spot.key: _mean([ranks[key] for key in (spot.before if sweep % 2 == 0 else spot.after)])
                        for spot in cell
                    }
                    cell.sort(
                        key=lambda spot: (ranks[spot.key] if wanted[spot.key] is None else wanted[spot.key], spot.key)
                    )
                    for spot in cell:
                        ranks[spot.key] = float(place + 1000 * lane)
                        place += 1

    def _place(self) -> None:
        widths = [0.0] * self._count
        for spot in self.spots.values():
            widths[spot.column] = max(widths[spot.column], spot.width)
        lefts = []
        gap = max(_GAP_X, *(len(arrow.label) * 5.6 + 40 for arrow in self._seen.arrows), 0.0)
        x = float(_EDGE * 3)
        for width in widths:
            lefts.append(x)
            x += width + gap
        self.width = max(x - gap + _EDGE * 3, 240.0)
        self.lanes: list[tuple[float, float]] = []
        y = float(_EDGE / 2)
        for lane in range(len(self.groups)):
            cells = [self._cells.get((column, lane), []) for column in range(self._count)]
            tall = max((sum(one.height + _GAP_Y for one in cell) - _GAP_Y for cell in cells if cell), default=0.0)
            for column, cell in enumerate(cells):
                here = y + _LANE_PAD + (tall - (sum(one.height + _GAP_Y for one in cell) - _GAP_Y)) / 2
                for spot in cell:
                    spot.x = lefts[column] + (widths[column] - spot.width) / 2
                    spot.y = here
                    here += spot.height + _GAP_Y
            height = tall + _LANE_PAD + _EDGE
            self.lanes.append((y, height))
            y += height + _EDGE / 2
        self.height = max(y, 60.0)
        self._lefts, self._widths = lefts, widths

    def extent(self, number: int) -> tuple[float, float]:
        """Top and height of a lane, with the lanes inside it."""
        top, height = self.lanes[number]
        depth = self.groups[number][1]
        for inner in range(number + 1, len(self.groups)):
            if self.groups[inner][1] <= depth:
                break
            height = sum(self.lanes[inner]) - top + _EDGE / 2
        return top, height

    def way(self, number: int) -> tuple[str, tuple[float, float]]:
        """The path of an arrow and the place of its label."""
        arrow = self._seen.arrows[number]
        source, target = self.spots[arrow.source[0]], self.spots[arrow.target[0]]
        x, y = source.x + source.width, _pin_y(source, arrow.source[1], out=True)
        end = target.x - 3, _pin_y(target, arrow.target[1], out=False)
        if target.column <= source.column:
            return self._back(x, y, end, source, target)
        text = f"M{x:.1f},{y:.1f}"
        points = []
        for key in self._chains[number][1:-1]:
            spot = self.spots[key]
            left = self._lefts[spot.column]
            points.append((left, left + self._widths[spot.column], spot.middle))
        for left, right, middle in points:
            text += f" {_curve(x, y, left, middle)} L{right:.1f},{middle:.1f}"
            x, y = right, middle
        return f"{text} {_curve(x, y, *end)}", (end[0] - 8, end[1] - 5)

    def _back(
        self, x: float, y: float, end: tuple[float, float], source: _Spot, target: _Spot
    ) -> tuple[str, tuple[float, float]]:
        """The path of an arrow backwards: out to the right, below both boxes, and in from the left."""
        low = max(source.y + source.height, target.y + target.height) + _GAP_Y / 2
        reach = _GAP_X / 2.6
        text = (
            f"M{x:.1f},{y:.1f} C{x + reach:.1f},{y:.1f} {x + reach:.1f},{low:.1f} {x:.1f},{low:.1f} "
            f"L{end[0]:.1f},{low:.1f} C{end[0] - reach:.1f},{low:.1f} {end[0] - reach:.1f},{end[1]:.1f} "
            f"{end[0]:.1f},{end[1]:.1f}"
        )
        return text, (end[0] + reach + 40, low - 4)


def _columns(seen: Picture) -> dict[str, int]:
    """The column of each box: the longest way to it, without the arrows that close a cycle."""
    after: dict[str, list[str]] = {box.name: [] for box in seen.boxes}
    for arrow in seen.arrows:
        after[arrow.source[0]].append(arrow.target[0])
    finished: dict[str, None] = {}
    back: set[tuple[str, str]] = set()
    for root in after:
        if root in finished:
            continue
        way = {root: iter(after[root])}
        while way:
            name = next(reversed(way))
            following = next(way[name], None)
            if following is None:
                del way[name]
                finished[name] = None
            elif following in way:
                back.add((name, following))
            elif following not in finished:
                way[following] = iter(after[following])
    columns = dict.fromkeys(after, 0)
    for name in reversed(finished):
        for following in after[name]:
            if (name, following) not in back:
                columns[following] = max(columns[following], columns[name] + 1)
    return columns


def _size(box: Box) -> tuple[float, float]:
    ins = [pin for pin in box.pins if not pin.out]
    outs = [pin for pin in box.pins if pin.out]
    sides = [max((_text_width(pin) for pin in side), default=0.0) for side in (ins, outs)]
    width = max(sum(sides) + 34, len(box.name) * 9.0 + 20, len(box.type) * _CHAR + 20, 90.0)
    return width, _HEAD + max(len(ins), len(outs)) * _ROW + (4 if box.pins else -4)


def _text_width(pin: Pin) -> float:
    return len(pin.name) * _CHAR + 10 + len(pin.type) * _CHAR


def _pin_y(spot: _Spot, name: str, out: bool) -> float:
    pins = [pin.name for pin in spot.box.pins if pin.out is out] if spot.box is not None else []
    return spot.y + _HEAD + _ROW * (pins.index(name) + 0.5 if name in pins else 0)


def _curve(x: float, y: float, to_x: float, to_y: float) -> str:
    reach = max(24.0, (to_x - x) / 2)
    return f"C{x + reach:.1f},{y:.1f} {to_x - reach:.1f},{to_y:.1f} {to_x:.1f},{to_y:.1f}"


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
