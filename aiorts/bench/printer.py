"""Shows a report: as an aligned table for a terminal, or as markdown. Pure: text in, text out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from aiorts.bench.case import Metric, Sense
from aiorts.bench.machine import line
from aiorts.bench.report import Ratio, Report, Row, Spread

__all__ = ("markdown", "table")

_HEAD = ("case", "median", "min..max", "p99", "messages/s", "ratio to", "aim", "measured", "IQR", "on course")
_LEFT = {0, 5}
"""Columns of words; the others are figures and stand to the right."""


def table(report: Report) -> str:
    """Plain text."""
    parts = [f"aiorts bench {report.bench}: {line(report.machine)}", _how(report)]
    for loop, rows in _by_loop(report):
        cells = [_HEAD, *_cells(rows)]
        widths = [max(len(row[column]) for row in cells) for column in range(len(_HEAD))]
        lines = ["  ".join(_pad(cell, widths[i], i) for i, cell in enumerate(row)).rstrip() for row in cells]
        parts.append("\n".join((f"{loop}", *lines)))
    parts.append("\n".join(f"{row.case.name}: {row.case.what}" for row in _first_loop(report)))
    parts += [f"FAULT {fault}" for fault in report.faults]
    return "\n\n".join(parts)


def markdown(report: Report) -> str:
    """The same as markdown."""
    parts = [
        f"# aiorts bench {report.bench}",
        f"Measured on: {line(report.machine)}.",
        f"Command: `{report.command}`. {_how(report)}",
    ]
    for loop, rows in _by_loop(report):
        rule = [":---" if column in _LEFT else "---:" for column in range(len(_HEAD))]
        lines = [_bar(row) for row in (_HEAD, rule, *_cells(rows))]
        parts.append("\n".join((f"## {loop}", "", *lines)))
    parts.append("\n".join(f"- {row.case.name}: {row.case.what}" for row in _first_loop(report)))
    parts += [f"**Fault:** {fault}" for fault in report.faults]
    return "\n\n".join(parts)


def _how(report: Report) -> str:
    return (
        f"{report.rounds} rounds, cases interleaved in each; medians over the rounds. Cost is for one message, latency "
        "is the median of a round, p99 of all rounds. A ratio is taken round by round to the baseline of that round; "
        "x <= is time taken, x >= is times as fast."
    )


def _by_loop(report: Report) -> Iterable[tuple[str, list[Row]]]:
    loops = dict.fromkeys(row.loop for row in report.rows)
    return [(loop, [row for row in report.rows if row.loop == loop]) for loop in loops]


def _first_loop(report: Report) -> list[Row]:
    return [row for row in report.rows if row.loop == report.rows[0].loop]


def _cells(rows: Iterable[Row]) -> list[tuple[str, ...]]:
    """One line for each row, and one more for each further ratio."""
    cells = []
    for row in rows:
        first, *more = [_ratio_cells(ratio) for ratio in row.ratios] or [("",) * 5]
        cells.append((*_row_cells(row), *first))
        cells += [("",) * 5 + ratio for ratio in more]
    return cells


def _row_cells(row: Row) -> tuple[str, ...]:
    unit = "us" if row.case.metric is Metric.P50 else "ns"
    spread = row.spread
    p99 = "" if row.p99_ns is None else f"{_time(row.p99_ns, unit)} {unit}"
    rate = "" if row.per_second is None else _rate(row.per_second)
    extremes = f"{_time(spread.min, unit)}..{_time(spread.max, unit)}"
    return (row.case.name, f"{_time(spread.median, unit)} {unit}", extremes, p99, rate)


def _ratio_cells(ratio: Ratio) -> tuple[str, ...]:
    aim, measured = ratio.aim, ratio.measured
    sign = "<=" if aim.sense is Sense.AT_MOST else ">="
    wanted = "" if aim.factor is None else f"{sign} {aim.factor:.1f}x"
    course = {None: "", True: "yes", False: "NO"}[ratio.on_course]
    return (
        aim.compared_with,
        wanted,
        f"{measured.median:.2f}x",
        f"{measured.q1:.2f}..{measured.q3:.2f}",
        course,
    )


def _time(nanoseconds: float, unit: str) -> str:
    return f"{nanoseconds / 1000:.1f}" if unit == "us" else f"{nanoseconds:.0f}"


def _rate(per_second: Spread) -> str:
    return f"{per_second.median / 1e6:.2f} M" if per_second.median >= 1e6 else f"{per_second.median / 1e3:.0f} k"


def _pad(cell: str, width: int, column: int) -> str:
    return cell.ljust(width) if column in _LEFT else cell.rjust(width)


def _bar(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
