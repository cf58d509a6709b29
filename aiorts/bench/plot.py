"""Draws a report into one HTML file with inline SVG that loads nothing: lines for figures, else the rows."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import Final

import click

from aiorts.bench.machine import line
from aiorts.bench.report import Figure, Report, Row

__all__ = ("check", "html", "write")

_W, _H, _LEFT, _TOP = 640, 360, 70, 16
_PLOT_W, _PLOT_H = 550, 290
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#7f7f7f")
_STYLE: Final = """:root{color-scheme:light dark;--ink:#222;--faint:#ddd;--paper:#fff}
@media(prefers-color-scheme:dark){:root{--ink:#ddd;--faint:#444;--paper:#181818}}
body{font:14px system-ui,sans-serif;color:var(--ink);background:var(--paper);margin:2em auto;max-width:900px}
svg{width:100%;height:auto}text{fill:var(--ink);font-size:11px}.grid{stroke:var(--faint)}.mark{stroke:var(--ink);
stroke-dasharray:4 4}.line{fill:none;stroke-width:2}p{opacity:.8}"""


def check(file: Path) -> None:
    """Raises click.BadParameter when the name of the file does not end in .html."""
    if file.suffix.lower() != ".html":
        raise click.BadParameter(f"{file}: expected FILE.html", param_hint="--plot")


def write(file: Path, report: Report) -> None:
    """Write the drawing; raises click.ClickException when that fails."""
    try:
        file.write_text(html(report), encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{file}: {error.strerror or error}") from error


def html(report: Report) -> str:
    """The whole document; it parses as XML."""
    parts = [_lines(figure) for figure in report.figures] or [_bars(report.rows)]
    title = escape(f"aiorts bench {report.bench}")
    head = f'<!DOCTYPE html>\n<html><head><meta charset="utf-8"/><title>{title}</title><style>{_STYLE}</style></head>'
    command = f"<p>{escape(line(report.machine))}</p><p>{escape(report.command)}</p>"
    return f"{head}<body><h1>{title}</h1>{command}{''.join(parts)}</body></html>\n"


def _ticks(low: float, high: float) -> list[float]:
    return [10.0**power for power in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]


def _lines(figure: Figure) -> str:
    """Lines over two logarithmic axes; a value that is not above 0 is left out."""
    series = [(one.name, [point for point in one.points if min(point[:2]) > 0]) for one in figure.series]
    points = [point for _, line_points in series for point in line_points]
    if not points:
        return ""
    across = _ticks(min(point[0] for point in points), max(point[0] for point in points))
    up = _ticks(min(point[1] for point in points), max(point[1] for point in points))

    def x(value: float) -> float:
        return _LEFT + _PLOT_W * math.log(value / across[0]) / (math.log(across[-1] / across[0]) or 1)

    def y(value: float) -> float:
        return _TOP + _PLOT_H - _PLOT_H * math.log(value / up[0]) / (math.log(up[-1] / up[0]) or 1)

    drawn = []
    for tick in across:
        drawn.append(f'<path class="grid" d="M{x(tick):.1f} {_TOP}v{_PLOT_H}"/>')
        drawn.append(f'<text x="{x(tick):.1f}" y="{_TOP + _PLOT_H + 14}" text-anchor="middle">{tick:g}</text>')
    for tick in up:
        drawn.append(f'<path class="grid" d="M{_LEFT} {y(tick):.1f}h{_PLOT_W}"/>')
        drawn.append(f'<text x="{_LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    if figure.mark is not None:
        drawn.append(f'<path class="mark" d="M{x(figure.mark):.1f} {_TOP}v{_PLOT_H}"/>')
    legend = []
    for number, (name, line_points) in enumerate(series):
        colour = _COLOURS[number % len(_COLOURS)]
        places = " ".join(f"{x(point[0]):.1f},{y(point[1]):.1f}" for point in line_points)
        drawn.append(f'<polyline class="line" stroke="{colour}" points="{places}"/>')
        legend.append(f'<span style="color:{colour}">&#9632;</span> {escape(name)} &#160; ')
    below = f"{figure.x} [{figure.x_unit}]"
    drawn.append(f'<text x="{_LEFT + _PLOT_W / 2}" y="{_H - 16}" text-anchor="middle">{escape(below)}</text>')
    title = escape(f"{figure.title} [{figure.y_unit}]")
    svg = f'<svg viewBox="0 0 {_W} {_H}" role="img">{"".join(drawn)}</svg>'
    return f"<h2>{title}</h2><p>{escape(figure.note)}</p>{svg}<p>{''.join(legend)}</p>"


def _bars(rows: tuple[Row, ...]) -> str:
    """For each unit a chart of medians with their extremes, on a logarithmic axis."""
    parts = []
    for unit in dict.fromkeys(row.case.measure.unit for row in rows):
        same = [row for row in rows if row.case.measure.unit == unit and row.spread.min > 0]
        if not same:
            continue
        ticks = _ticks(min(row.spread.min for row in same), max(row.spread.max for row in same))
        width = math.log(ticks[-1] / ticks[0]) or 1.0
        height = 20 * len(same)
        drawn = []
        for tick in ticks:
            at = 300 + 330 * math.log(tick / ticks[0]) / width
            drawn.append(f'<path class="grid" d="M{at:.1f} 0v{height}"/>')
            drawn.append(f'<text x="{at:.1f}" y="{height + 14}" text-anchor="middle">{tick:g}</text>')
        for number, row in enumerate(same):
            low, middle, high = (
                300 + 330 * math.log(value / ticks[0]) / width
                for value in (row.spread.min, row.spread.median, row.spread.max)
            )
            name = row.case.name if row.loop == "none" else f"{row.case.name}, {row.loop}"
            middle_y = 20 * number + 10
            drawn.append(f'<text x="294" y="{middle_y + 4}" text-anchor="end">{escape(name)}</text>')
            drawn.append(f'<path stroke="{_COLOURS[0]}" d="M{low:.1f} {middle_y}H{high:.1f}"/>')
            drawn.append(f'<circle cx="{middle:.1f}" cy="{middle_y}" r="4" fill="{_COLOURS[0]}"/>')
        svg = f'<svg viewBox="0 0 {_W} {height + 20}" role="img">{"".join(drawn)}</svg>'
        parts.append(f"<h2>{escape(unit)}: median, least to most</h2>{svg}")
    return "".join(parts)
