"""Draws a system as SVG: a frame for each context and composite, boxes with ports, and edges round the boxes.

The same picture gives the same text. `aiorts.layout` decides the places; the functions here write the SVG.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import Final

from aiorts.layout import BAND_FOOT, HEAD, Edge, Key, Layout, Place, Places, Point, Route, Spot
from aiorts.system.draw.picture import Arrow, Box, Picture, Pin

_CHAR: Final = 6.8
"""Average width of a character of a port's name, in pixels, rounded up."""
_LABEL_CHAR: Final = 5.6
_LONGEST: Final = 44
"""The most characters of a label at an arrow; the whole label is in the title that shows under the pointer."""
_EDGE: Final = 16.0
_INSET: Final = 8.0
"""The distance between the frame of a context and that of a composite in it."""
_BEND: Final = 6.0
_ABOVE: Final = 40.0
"""Boxes whose left sides are nearer than this stand above one another, not side by side."""
_WIDEST: Final = 4.0
"""The greatest factor by which the distance between boxes exceeds that in the studio."""
_LANES: Final = ("#eef4fb", "#f1f8ee", "#fdf5e9", "#f6f0fa", "#eef8f7", "#fbf0f0")
_STYLE: Final = (
    "text{font-family:'DejaVu Sans',Verdana,sans-serif;font-size:11px;fill:#1f2933}"
    ".lane{stroke:#c5d0db}.title{font-size:12px;fill:#52606d}.name{font-size:13px;font-weight:bold}"
    ".type{font-size:10px;fill:#616e7c}.box{fill:#ffffff;stroke:#486581;stroke-width:1.3}"
    ".rule{stroke:#d9e2ec}.wire{fill:none;stroke:#52606d;stroke-width:1.4}"
    ".label{font-size:9px;fill:#7b4b00}"
    ".paper{fill:#ffffff;fill-opacity:0.8}.in{fill:#2680c2}.out{fill:#c65d21}"
)


def svg(seen: Picture, stored: Places | None = None) -> str:
    """The picture as an SVG document.

    Args:
        stored: the places of boxes in the studio, which this drawing keeps; new boxes are placed next to them.
    """
    labels = _labels(seen)
    layout = Layout(label=max(0, *map(len, labels.values()), 0) * _LABEL_CHAR + 2 * _EDGE)
    edges = [_edge(number, arrow) for number, arrow in enumerate(seen.arrows)]
    lanes = [pair for group in seen.groups for pair in group.flat()]
    spots = [_spot(box, (str(number),)) for number, (group, _) in enumerate(lanes) for box in group.boxes]
    layout.place(spots, edges, {(str(number),): "" for number in range(len(lanes))})
    if stored is not None:
        _restore(layout, spots, edges, stored)
    routes = [layout.route(edge) for edge in edges]
    bends = [x for route in routes for x, _ in route.points]
    left = min(0.0, *bends, *(one.x - _EDGE for one in spots), 0.0) - _EDGE
    right = max(layout.right, *bends, 0.0) + _EDGE
    heights = [y for route in routes for _, y in route.points]
    top = min((*(band.top for band in layout.bands.values()), *heights), default=0.0)
    bottom = max((*(band.top + band.height for band in layout.bands.values()), *heights), default=0.0)
    extents = list(_extents(layout, [depth for _, depth in lanes], left, right))
    x, y, width, height = left - _EDGE / 2, top - _EDGE / 2, right - left + _EDGE, bottom - top + _EDGE
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="{x:.0f} {y:.0f} {width:.0f} {height:.0f}">',
        f"<style>{_STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0.5 L8,4 L0,7.5 z" fill="#52606d"/></marker></defs>',
        f'<rect x="{x:.0f}" y="{y:.0f}" width="100%" height="100%" fill="#ffffff"/>',
    ]
    shade = -1
    for (group, depth), (fx, fy, fw, fh) in zip(lanes, extents, strict=True):
        shade += not depth
        lines.append(
            f'<rect class="lane" x="{fx:g}" y="{fy:g}" width="{fw:.0f}" height="{fh:.0f}" rx="8" '
            f'fill="{_LANES[(shade + depth) % len(_LANES)]}"/>'
        )
        lines.append(f'<text class="title" x="{fx + 12:g}" y="{fy + 17:g}">{_escaped(group.title)}</text>')
    for arrow, route in zip(seen.arrows, routes, strict=True):
        lines.append(_wire(arrow, route))
    boxes = {box.name: box for box in seen.boxes}
    for spot in spots:
        lines += _box(boxes[spot.title], spot)
    ends = {arrow.target: route.label for arrow, route in zip(seen.arrows, routes, strict=True)}
    for target, text in labels.items():
        lines += _label(text, ends[target])
    return "\n".join([*lines, "</svg>"]) + "\n"


def _escaped(text: str) -> str:
    """Escape a text for XML. `xml.sax.saxutils` is not used: it imports `urllib`, which would slow down every start."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


# -- what is placed ----------------------------------------------------------------------------------------------------


def _spot(box: Box, band: Key) -> Spot:
    inputs, outputs = (tuple(pin.name for pin in box.pins if pin.out is out) for out in (False, True))
    sides = [max((_text_width(pin) for pin in box.pins if pin.out is out), default=0.0) for out in (False, True)]
    width = max(sum(sides) + 34, len(box.name) * 9.0 + 20, len(box.type) * _CHAR + 20, 90.0)
    return Spot((box.name,), band, inputs, outputs, box.name, w=width)


def _text_width(pin: Pin) -> float:
    return len(pin.name) * _CHAR + 10 + len(pin.type) * _CHAR


def _restore(layout: Layout, spots: Sequence[Spot], edges: Sequence[Edge], stored: Places) -> None:
    """Put boxes in their stored places, farther apart if they are wider than in the studio."""
    known = {spot.key: stored.boxes[spot.title] for spot in spots if spot.title in stored.boxes}
    if not known:
        return
    wider = _stretch([(spot, known[spot.key]) for spot in spots if spot.key in known], layout.label)
    places = {}
    for key, place in known.items():
        left, top = layout.corner(layout.spots[key].band)
        places[key] = left + place.x * wider, top + place.y
    new = [spot for spot in spots if spot.key not in known]
    for spot in new:
        layout.remove(spot.key)
    layout.move(places)
    for spot in new:
        sources = [edge.source for edge in edges if edge.target == spot.key]
        targets = [edge.target for edge in edges if edge.source == spot.key]
        if not layout.add(spot, layout.groups[spot.band], sources, targets):
            layout.place(spots, edges, dict(layout.groups))  # there is no room: the others give way
            layout.move(places)
            return


def _stretch(placed: Sequence[tuple[Spot, Place]], label: float) -> float:
    """The factor for horizontal distances at which boxes side by side have room."""
    found = 1.0
    for (one, here), (other, there) in permutations(placed, 2):
        beside = here.y < there.y + other.h and there.y < here.y + one.h
        if one.band == other.band and beside and there.x - here.x > _ABOVE:
            found = max(found, (one.w + label + _EDGE) / (there.x - here.x))
    return min(found, _WIDEST)


def _edge(number: int, arrow: Arrow) -> Edge:
    (source, out), (target, into) = arrow.source, arrow.target
    return Edge((str(number),), (source,), out, (target,), into)


def _labels(seen: Picture) -> dict[tuple[str, str], str]:
    """The text before each in-port that has one: the options of the arrows that end there."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for arrow in seen.arrows:
        if arrow.label:
            found.setdefault(arrow.target, {})[arrow.label] = None
    texts = {target: " | ".join(labels) for target, labels in found.items()}
    return {target: text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…" for target, text in texts.items()}


def _extents(
    layout: Layout, depths: Sequence[int], left: float, right: float
) -> Iterator[tuple[float, float, float, float]]:
    """Left, top, width and height of each frame; a frame reaches to the foot of the last frame inside it."""
    bands: Sequence[tuple[float, float]] = [(band.top, band.height) for band in layout.bands.values()]
    for number, depth in enumerate(depths):
        last = number
        while last + 1 < len(depths) and depths[last + 1] > depth:
            last += 1
        inset, top = _INSET * depth, bands[number][0]
        foot = sum(bands[last]) - min(inset, BAND_FOOT / 2)
        yield left + inset, top, right - left - 2 * inset, foot - top


# -- what is written ---------------------------------------------------------------------------------------------------


def _wire(arrow: Arrow, route: Route) -> str:
    what = f"{'.'.join(arrow.source)} → {'.'.join(arrow.target)}" + (f" ({arrow.label})" if arrow.label else "")
    way = _rounded(route.points)
    return f'<path class="wire" marker-end="url(#tip)" d="{way}"><title>{_escaped(what)}</title></path>'


def _rounded(points: Sequence[Point]) -> str:
    """The path of a line through these points, with rounded corners."""
    text = f"M{_at(points[0])}"
    for i in range(1, len(points) - 1):
        before, here, after = points[i - 1 : i + 2]
        text += f"L{_at(_towards(here, before))}Q{_at(here)} {_at(_towards(here, after))}"
    return f"{text}L{_at(points[-1])}"


def _towards(here: Point, other: Point) -> Point:
    away = max(abs(other[0] - here[0]), abs(other[1] - here[1]))
    part = min(_BEND, away / 2) / (away or 1.0)
    return here[0] + (other[0] - here[0]) * part, here[1] + (other[1] - here[1]) * part


def _at(point: Point) -> str:
    return f"{point[0]:.1f},{point[1]:.1f}"


def _label(text: str, end: Point) -> Iterator[str]:
    x, y, width = end[0] - 2, end[1] - 4, len(text) * _LABEL_CHAR + 4
    yield f'<rect class="paper" x="{x - width + 2:.0f}" y="{y - 9:.0f}" width="{width:.0f}" height="11" rx="2"/>'
    yield f'<text class="label" x="{x:.0f}" y="{y:.0f}" text-anchor="end">{_escaped(text)}</text>'


def _box(box: Box, spot: Spot) -> Iterator[str]:
    x, y, middle, end = spot.x, spot.y, spot.x + spot.w / 2, spot.x + spot.w
    yield f'<rect class="box" x="{x:.1f}" y="{y:.1f}" width="{spot.w:.1f}" height="{spot.h:.1f}" rx="5"/>'
    yield f'<text class="name" x="{middle:.1f}" y="{y + 19:.1f}" text-anchor="middle">{_escaped(box.name)}</text>'
    yield f'<text class="type" x="{middle:.1f}" y="{y + 35:.1f}" text-anchor="middle">{_escaped(box.type)}</text>'
    if box.pins:
        rule = y + HEAD - 7
        yield f'<line class="rule" x1="{x:.1f}" x2="{end:.1f}" y1="{rule:.1f}" y2="{rule:.1f}"/>'
    for pin in box.pins:
        where = y + spot.port_y(pin.name, out=pin.out)
        edge, text = (end, end - 8) if pin.out else (x, x + 8)
        side = "end" if pin.out else "start"
        yield f'<circle class="{"out" if pin.out else "in"}" cx="{edge:.1f}" cy="{where:.1f}" r="3.5"/>'
        yield f'<text x="{text:.1f}" y="{where + 4:.1f}" text-anchor="{side}">{_escaped(pin.name)}</text>'
        if pin.type:
            beside = text + (-1 if pin.out else 1) * (len(pin.name) * _CHAR + 10)
            place = f'x="{beside:.1f}" y="{where + 4:.1f}" text-anchor="{side}"'
            yield f'<text class="type" {place}>{_escaped(pin.type)}</text>'
