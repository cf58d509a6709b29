"""Draws a report into one file: HTML with inline SVG that loads nothing, or PNG where matplotlib is installed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import click

from aiorts.errors import MissingExtra
from aiorts_bench.harness import chart
from aiorts_bench.harness.machine import line
from aiorts_bench.harness.report import Figure, Report

_STYLE: Final = """:root{color-scheme:light dark;--ink:#1d2530;--soft:#5b6673;--faint:#dfe3e8;--paper:#f6f7f9;
--card:#fff}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#a3adba;--faint:#353c46;--paper:#14171b;--card:#1d2127}}
*{box-sizing:border-box}
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);margin:0 auto;max-width:1180px;
padding:1.5rem 1rem}
h1{font-size:1.5rem;margin:0 0 .3rem}h2{font-size:1.02rem;margin:0}
p{color:var(--soft);margin:.2rem 0;overflow-wrap:anywhere}code{font-size:.9em}
main{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,440px),1fr));gap:1rem;margin-top:1rem;
align-items:start}
section{background:var(--card);border:1px solid var(--faint);border-radius:10px;padding:.9rem 1rem}
section p{font-size:.85rem}svg{display:block;width:100%;height:auto;margin:.4rem 0}
ul{list-style:none;display:flex;flex-wrap:wrap;gap:.15rem 1rem;margin:.3rem 0 0;padding:0;font-size:.87rem}
li{display:flex;align-items:center;gap:.4rem}li svg{width:14px;height:14px;margin:0;flex:none}
text{fill:var(--ink);font-size:12.5px}text.axis{fill:var(--soft);font-size:13px}text.tick{fill:var(--soft)}
.grid{stroke:var(--faint);fill:none}.mark{stroke:var(--soft);stroke-dasharray:5 4;fill:none}
.line{fill:none;stroke:var(--c);stroke-width:2}.band{fill:var(--c);opacity:.16}.dot{fill:var(--c)}
.whisker{stroke:var(--c);stroke-width:1.3;fill:none}.half{stroke:var(--c);stroke-width:5;opacity:.45;fill:none}
.track{stroke:var(--faint);fill:none}
"""


def check(file: Path) -> None:
    """Refuse a file that cannot be drawn, before anything is measured.

    Raises:
        click.BadParameter: its name ends in neither .html nor .png, or its folder or matplotlib is missing.
    """
    if file.suffix.lower() not in (".html", ".png"):
        raise click.BadParameter(f"{file}: expected FILE.html or FILE.png", param_hint="--plot")
    if not file.absolute().parent.is_dir():
        raise click.BadParameter(f"{file}: no such folder", param_hint="--plot")
    if file.suffix.lower() == ".png" and find_spec("matplotlib") is None:
        missing = MissingExtra(f"{file}: PNG", "matplotlib", "plot", "name FILE.html, which needs nothing")
        raise click.BadParameter(str(missing), param_hint="--plot")


def write(file: Path, report: Report) -> None:
    """Write the drawing; raises click.ClickException when that fails."""
    try:
        if file.suffix.lower() == ".png":
            _png(file, report)
        else:
            file.write_text(html(report), encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{file}: {error.strerror or error}") from error


def html(report: Report) -> str:
    """The whole document; it parses as XML."""
    loops = list(dict.fromkeys(row.loop for row in report.rows))
    parts = [_figure(figure) for figure in report.figures]
    if not report.figures or any(not row.case.axes for row in report.rows):
        for measure, rows in chart.groups(report.rows).items():
            legend = [] if loops == ["none"] else loops
            note = "median, its middle half, least to most of the rounds; logarithmic"
            parts.append(_section(f"{measure.name} [{measure.unit}]", note, chart.rows(measure, rows, loops), legend))
    title = escape(f"aiorts bench {report.bench}")
    head = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        f"<title>{title}</title><style>{_STYLE}{chart.STYLE}</style></head>"
    )
    faults = "".join(f"<p><b>Fault:</b> {escape(fault)}</p>" for fault in report.faults)
    notes = "".join(f"<p>{escape(note)}</p>" for note in report.notes)
    top = f"<h1>{title}</h1><p>{escape(line(report.machine))}</p><p><code>{escape(report.command)}</code></p>{faults}"
    return f"{head}<body>{top}<main>{''.join(parts)}</main>{notes}</body></html>\n"


def _figure(figure: Figure) -> str:
    drawn = chart.lines(figure)
    return _section(figure.title, figure.note, drawn, [one.name for one in figure.series]) if drawn else ""


def _section(title: str, note: str, svg: str, legend: list[str]) -> str:
    below = f"<p>{escape(note)}</p>" if note else ""
    names = "".join(
        f'<li><svg class="s{number % len(chart.COLOURS)}" viewBox="0 0 12 12">{chart.marker(number, 6, 6)}</svg>'
        f"{escape(name)}</li>"
        for number, name in enumerate(legend)
    )
    return f"<section><h2>{escape(title)}</h2>{below}{svg}{f'<ul>{names}</ul>' if names else ''}</section>"


def _png(file: Path, report: Report) -> None:
    """Draw the charts of `html` with matplotlib, into a PNG file."""
    from matplotlib.backends.backend_agg import (  # type: ignore[import-not-found, unused-ignore]
        FigureCanvasAgg,
    )
    from matplotlib.figure import Figure as Sheet  # type: ignore[import-not-found, unused-ignore]

    kinds = [] if report.figures else list(chart.groups(report.rows).items())
    count = max(1, len(report.figures) + len(kinds))
    tall = [4.6] * len(report.figures) + [1.2 + 0.22 * len(rows) for _, rows in kinds] or [3.0]
    sheet: Any = Sheet(figsize=(9, sum(tall)), layout="constrained")
    FigureCanvasAgg(sheet)
    sheet.suptitle(f"aiorts bench {report.bench}\n{line(report.machine)}", fontsize=9, wrap=True)
    one_loop = len({row.loop for row in report.rows}) == 1
    axes = [one[0] for one in sheet.subplots(count, 1, squeeze=False, height_ratios=tall)]
    for figure, ax in zip(report.figures, axes, strict=False):
        _png_lines(ax, figure)
    for (measure, rows), ax in zip(kinds, axes, strict=False):
        spreads = [row.figures[measure.name].spread for row in rows]
        beyond = [[one.median - one.q1 for one in spreads], [one.q3 - one.median for one in spreads]]
        ax.errorbar([one.median for one in spreads], range(len(rows)), xerr=beyond, fmt="o", markersize=4)
        names = [row.case.name if one_loop else f"{row.case.name}, {row.loop}" for row in rows]
        ax.set_yticks(range(len(rows)), names, fontsize=7)
        ax.invert_yaxis()
        ax.set(xlabel=f"{measure.name} [{measure.unit}]: median and middle half of the rounds")
        _png_axis(ax, "x", [value for one in spreads for value in (one.q1, one.q3)], log=True)
        ax.grid(alpha=0.3)
    sheet.savefig(file, dpi=130)


def _png_lines(ax: Any, figure: Figure) -> None:
    for number, (name, points) in enumerate(chart.drawable(figure)):
        if points:
            xs, ys, lows, highs = zip(*points, strict=True)
            colour = chart.COLOURS[number % len(chart.COLOURS)][0]
            ax.plot(xs, ys, "osDv"[number % 4] + "-", color=colour, label=name, markersize=4)
            ax.fill_between(xs, lows, highs, color=colour, alpha=0.16)
    if figure.mark is not None:
        ax.axvline(figure.mark, color="grey", linestyle="--")
    ax.set_title(f"{figure.title}\n{figure.note}", fontsize=8, wrap=True)
    ax.set(xlabel=f"{figure.x} [{figure.x_unit}]", ylabel=f"{figure.y} [{figure.y_unit}]")
    points = [point for _, own in chart.drawable(figure) for point in own]
    if points:
        _png_axis(ax, "x", [point[0] for point in points], "x" in figure.log)
        _png_axis(ax, "y", [value for point in points for value in point[1:]], "y" in figure.log)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=7)


def _png_axis(ax: Any, which: str, values: Sequence[float], log: bool) -> None:
    """The axis of the HTML charts: matplotlib writes 3 x 10^1 between two powers of ten."""
    found = chart.Axis.of(values, log)
    margin = 0.02 * (found.high - found.low)
    ends = (found.low / 1.05, found.high * 1.05) if log else (found.low - margin, found.high + margin)
    ax.set(**{f"{which}scale": "log" if log else "linear", f"{which}lim": ends, f"{which}ticks": found.ticks})
    ax.set(**{f"{which}ticklabels": [chart.short(tick) for tick in found.ticks]})
    ax.minorticks_off()
