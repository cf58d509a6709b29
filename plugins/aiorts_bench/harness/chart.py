"""Charts as inline SVG: lines over two axes with the spread as a band, rows of medians with whiskers. Pure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from aiorts_bench.harness.case import Measure
from aiorts_bench.harness.report import Figure, Row

COLOURS: Final = (
    ("#0072b2", "#56b4e9"),
    ("#d55e00", "#ff9152"),
    ("#009e73", "#3fd0a6"),
    ("#b8579b", "#e79fc9"),
    ("#b37400", "#f0b429"),
    ("#5b4bb5", "#a99bff"),
    ("#6b6b6b", "#b5b5b5"),
    ("#8f2d2d", "#e08080"),
)
"""Each colour on a light and on a dark ground; distinct for every colour vision, and the marks differ as well."""
STYLE: Final = "".join(
    f".s{number}{{--c:{light}}}@media(prefers-color-scheme:dark){{.s{number}{{--c:{dark}}}}}"
    for number, (light, dark) in enumerate(COLOURS)
)
_WIDTH, _HEIGHT = 480, 330
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 14, 12, 48
_EM: Final = 70
"""Characters of a row's name on one line."""


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis from the least to the largest value, with round ticks at both ends."""

    low: float
    high: float
    ticks: tuple[float, ...]
    log: bool

    @classmethod
    def of(cls, values: Sequence[float], log: bool) -> Axis:
        """An axis that holds all values; they are above 0 where it is logarithmic."""
        low, high = min(values), max(values)
        if not log:
            low = min(0.0, low)
            step = _step((high - low) / 5 or 1.0)
            first, last = math.floor(low / step), max(1, math.ceil(high / step - 1e-9))
            ticks = tuple(number * step for number in range(first, last + 1))
            return cls(ticks[0], ticks[-1], ticks, False)
        powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 2)
        digits = (1, 2, 5) if math.log10(high / low) < 2.5 else (1,) if math.log10(high / low) > 4 else (1, 3)
        nice = [digit * 10.0**power for power in powers for digit in digits]
        bottom = max(tick for tick in nice if tick <= low * 1.0001)
        top = min(tick for tick in nice if tick >= high * 0.9999 and tick > bottom)
        return cls(bottom, top, tuple(tick for tick in nice if bottom <= tick <= top), True)

    def place(self, value: float) -> float:
        """The place of a value: 0 at the low end, 1 at the high end; a value outside lies at the edge."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def _step(least: float) -> float:
    power = 10.0 ** math.floor(math.log10(least))
    return next(digit * power for digit in (1, 2, 5, 10) if digit * power >= least * 0.9999)


def short(value: float) -> str:
    """The text of a tick: 20k, 1.5M, 0.3."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size * 0.9999:
            return f"{value / size:.4g}{letter}"
    return f"{value:.4g}"


def drawable(figure: Figure) -> list[tuple[str, list[tuple[float, float, float, float]]]]:
    """The lines of a figure without the points that its logarithmic axes cannot show."""

    def is_shown(point: tuple[float, float, float, float]) -> bool:
        return not ("x" in figure.log and point[0] <= 0) and not ("y" in figure.log and min(point[1:]) <= 0)

    return [(one.name, [*filter(is_shown, one.points)]) for one in figure.series]


def lines(figure: Figure) -> str:
    """The chart of a figure as SVG; "" when the figure has no point."""
    series = drawable(figure)
    points = [point for _, own in series for point in own]
    if not points:
        return ""
    across = Axis.of([point[0] for point in points], "x" in figure.log)
    up = Axis.of([value for point in points for value in point[1:]], "y" in figure.log)
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM

    def x(value: float) -> float:
        return _LEFT + wide * across.place(value)

    def y(value: float) -> float:
        return _TOP + high * (1 - up.place(value))

    drawn = [_grid(across, up, x, y)]
    drawn.append(_text(_LEFT + wide / 2, _HEIGHT - 8, f"{figure.x} [{figure.x_unit}]", "middle", "axis"))
    middle = _TOP + high / 2
    turned = f' transform="rotate(-90 14 {middle:.1f})"'
    drawn.append(_text(14, middle, f"{figure.y} [{figure.y_unit}]", "middle", "axis", turned))
    if figure.mark is not None and across.low <= figure.mark <= across.high:
        drawn.append(f'<path class="mark" d="M{x(figure.mark):.1f} {_TOP}v{high}"/>')
    for number, (name, own) in enumerate(series):
        if own:
            drawn.append(_line(number, name, own, x, y, figure))
    return (
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(figure.title)}">{"".join(drawn)}</svg>'
    )


def _grid(across: Axis, up: Axis, x: Callable[[float], float], y: Callable[[float], float]) -> str:
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    drawn = []
    for tick in across.ticks:
        drawn.append(f'<path class="grid" d="M{x(tick):.1f} {_TOP}V{bottom}"/>')
        drawn.append(_text(x(tick), bottom + 16, short(tick), "middle"))
    for tick in up.ticks:
        drawn.append(f'<path class="grid" d="M{_LEFT} {y(tick):.1f}H{right}"/>')
        drawn.append(_text(_LEFT - 6, y(tick) + 4, short(tick), "end"))
    return "".join(drawn)


def _line(
    number: int,
    name: str,
    points: Sequence[tuple[float, float, float, float]],
    x: Callable[[float], float],
    y: Callable[[float], float],
    figure: Figure,
) -> str:
    """The band of the spread, the line, and a mark with its figures at each point."""
    edge = [(at, hi) for at, _, _, hi in points] + [(at, lo) for at, _, lo, _ in reversed(points)]
    band = " ".join(f"{x(at):.1f},{y(value):.1f}" for at, value in edge)
    path = " ".join(f"{x(at):.1f},{y(value):.1f}" for at, value, _, _ in points)
    drawn = [f'<polygon class="band" points="{band}"/>', f'<polyline class="line" points="{path}"/>']
    for at, value, lo, hi in points:
        title = escape(f"{name}: {value:.4g} {figure.y_unit} ({lo:.4g}..{hi:.4g}) at {at:g} {figure.x_unit}")
        drawn.append(f'<g><title>{title}</title><path class="whisker" d="M{x(at):.1f} {y(lo):.1f}V{y(hi):.1f}"/>')
        drawn.append(f"{marker(number, x(at), y(value))}</g>")
    return f'<g class="s{number % len(COLOURS)}">{"".join(drawn)}</g>'


def marker(number: int, x: float, y: float) -> str:
    """The mark of a line: circle, square, diamond, triangle, in turn."""
    shape = number % 4
    if shape == 0:
        return f'<circle class="dot" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
    if shape == 1:
        return f'<path class="dot" d="M{x - 3.6:.1f} {y - 3.6:.1f}h7.2v7.2h-7.2z"/>'
    if shape == 2:
        return f'<path class="dot" d="M{x:.1f} {y - 5:.1f}l5 5l-5 5l-5 -5z"/>'
    return f'<path class="dot" d="M{x:.1f} {y - 5:.1f}l4.8 8.6h-9.6z"/>'


def groups(found: Sequence[Row]) -> dict[Measure, list[Row]]:
    """The rows by each measure that they compare or draw, without those that a logarithmic axis cannot show."""
    kinds: dict[Measure, list[Row]] = {}
    for row in found:
        for measure in (row.case.measure, *row.case.drawn):
            if measure.name in row.figures and row.figures[measure.name].spread.min > 0:
                kinds.setdefault(measure, []).append(row)
    return kinds


def rows(measure: Measure, found: Sequence[Row], loops: Sequence[str]) -> str:
    """The chart of one measure of rows: median, middle half and extremes; each loop has a colour."""
    spreads = [row.figures[measure.name].spread for row in found]
    axis = Axis.of([value for spread in spreads for value in (spread.min, spread.max)], True)
    left, wide = 14, _WIDTH - 14 - 84
    drawn, top = [], 6

    def x(value: float) -> float:
        return left + wide * axis.place(value)

    for name in dict.fromkeys(row.case.name for row in found):
        for part in textwrap.wrap(name, _EM) or [name]:
            top += 15
            drawn.append(_text(2, top, part, "start", "name"))
        for row in (row for row in found if row.case.name == name):
            top += 15
            spread, at = row.figures[measure.name].spread, top - 4
            title = f"{name}, {row.loop}: {spread.median:.4g} {measure.unit} ({spread.min:.4g}..{spread.max:.4g})"
            drawn.append(f'<g class="s{loops.index(row.loop) % len(COLOURS)}"><title>{escape(title)}</title>')
            drawn.append(f'<path class="track" d="M{left} {at}h{wide}"/>')
            drawn.append(f'<path class="whisker" d="M{x(spread.min):.1f} {at}H{x(spread.max):.1f}"/>')
            drawn.append(f'<path class="half" d="M{x(spread.q1):.1f} {at}H{x(spread.q3):.1f}"/>')
            drawn.append(f"{marker(loops.index(row.loop), x(spread.median), at)}</g>")
            drawn.append(_text(_WIDTH - 2, at + 4, f"{short(spread.median)} {measure.unit}", "end"))
        top += 5
    grid = "".join(
        f'<path class="grid" d="M{x(tick):.1f} 6V{top}"/>{_text(x(tick), top + 14, short(tick), "middle")}'
        for tick in axis.ticks
    )
    label = _text(left + wide / 2, top + 32, f"{measure.name} [{measure.unit}]", "middle", "axis")
    return f'<svg viewBox="0 0 {_WIDTH} {top + 40}" role="img">{grid}{"".join(drawn)}{label}</svg>'


def _text(x: float, y: float, text: str, anchor: str, kind: str = "tick", more: str = "") -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{escape(text)}</text>'
