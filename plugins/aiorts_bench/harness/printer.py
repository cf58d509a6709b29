"""Formats a report as an aligned table for a terminal, or as markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aiorts_bench.harness.case import Measure, Sense
from aiorts_bench.harness.machine import line
from aiorts_bench.harness.report import Ratio, Report, Row

_RATIO_HEAD = ("ratio to", "aim", "measured", "IQR", "on course")


@dataclass(frozen=True, slots=True)
class _Layout:
    """The columns of a report.

    Attributes:
        axes: shown in the place of the case's name, where rows have axes.
        measures: the columns, by name.
    """

    axes: tuple[str, ...]
    measures: tuple[str, ...]
    drops: bool
    ratios: bool

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Layout:
        axes = tuple(dict.fromkeys(axis for row in rows for axis in row.case.axes))
        measures = dict.fromkeys(one.name for row in rows for one in row.case.columns if one.name in row.figures)
        drops = any(row.ledger is not None and row.ledger.dropped for row in rows)
        return cls(axes, tuple(measures), drops, any(row.ratios for row in rows))

    @property
    def head(self) -> tuple[str, ...]:
        named = self.axes or ("case",)
        ratios = _RATIO_HEAD if self.ratios else ()
        return (*named, "median", "min..max", *self.measures, *(("dropped",) if self.drops else ()), *ratios)

    @property
    def left(self) -> set[int]:
        """The columns of words, aligned to the left; figures are aligned to the right."""
        head = self.head
        return {*range(len(self.axes or ("case",))), *(i for i, name in enumerate(head) if name == "ratio to")}

    def lines(self, rows: Iterable[Row]) -> list[tuple[str, ...]]:
        """One line for each row, and one more for each further ratio."""
        lines = []
        for row in rows:
            own = self._own(row)
            if not self.ratios:
                lines.append(own)
                continue
            first, *more = [_ratio_cells(ratio) for ratio in row.ratios] or [("",) * len(_RATIO_HEAD)]
            lines.append((*own, *first))
            lines += [("",) * len(own) + ratio for ratio in more]
        return lines

    def _own(self, row: Row) -> tuple[str, ...]:
        measure, spread = row.case.measure, row.spread
        named = tuple(row.case.axes.get(axis, "") for axis in self.axes) or (row.case.name,)
        found = [row.figures.get(name) for name in self.measures]
        cells = ["" if one is None else figure_text(one.displayed, one.measure) for one in found]
        extremes = f"{_bare(spread.min, measure)}..{_bare(spread.max, measure)}"
        dropped = [] if row.ledger is None else [f"{count} {reason}" for reason, count in row.ledger.dropped.items()]
        drops = (", ".join(dropped),) if self.drops else ()
        return (*named, figure_text(spread.median, measure), extremes, *cells, *drops)


def table(report: Report) -> str:
    """The report as plain text with aligned columns."""
    parts = [f"aiorts bench {report.bench}: {line(report.machine)}", _how(report)]
    layout = _Layout.of(report.rows)
    for loop, rows in _by_loop(report):
        cells = [layout.head, *layout.lines(rows)]
        widths = [max(len(row[column]) for row in cells) for column in range(len(layout.head))]
        lines = ["  ".join(_pad(cell, widths[i], i, layout) for i, cell in enumerate(row)).rstrip() for row in cells]
        parts.append("\n".join((*_titled(loop), *lines)))
    parts.append("\n".join(_explained(report)))
    parts.append("\n".join(report.notes))
    parts += [f"FAULT {fault}" for fault in report.faults]
    return "\n\n".join(part for part in parts if part)


def markdown(report: Report, level: int = 1) -> str:
    """The report as markdown, with headings from `level` on."""
    marks = "#" * level
    parts = [
        f"{marks} aiorts bench {report.bench}",
        f"Measured on: {line(report.machine)}.",
        f"Command: `{report.command}`. {_how(report)}",
    ]
    layout = _Layout.of(report.rows)
    for loop, rows in _by_loop(report):
        rule = [":---" if column in layout.left else "---:" for column in range(len(layout.head))]
        lines = [_bar(row) for row in (layout.head, rule, *layout.lines(rows))]
        parts.append("\n".join((*(f"{marks}# {title}\n" for title in _titled(loop)), *lines)))
    parts.append("\n".join(f"- {text}" for text in _explained(report)))
    parts.append("\n".join(f"- {text}" for text in report.notes))
    parts += [f"**Fault:** {fault}" for fault in report.faults]
    return "\n\n".join(part for part in parts if part)


def figure_text(value: float, measure: Measure) -> str:
    """A figure with its unit: "178 ns", "5.61 M/s"."""
    if measure.unit == "1/s":
        return f"{_bare(value, measure)}/s"
    return f"{_bare(value, measure)} {measure.unit}".strip() if measure.unit != "%" else f"{_bare(value, measure)}%"


def _bare(value: float, measure: Measure) -> str:
    if measure.unit != "1/s":
        return f"{value:,.{measure.digits}f}".replace(",", "" if abs(value) < 1e5 else ",")
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.2f} {letter}" if value < 1e4 * size / 1e3 else f"{value / size:.1f} {letter}"
    return f"{value:.{max(1, measure.digits)}f}"


def _how(report: Report) -> str:
    return report.how or (
        f"{report.rounds} round{'s' if report.rounds > 1 else ''}, cases interleaved in each; medians over the rounds, "
        "percentiles and max of all rounds together. A ratio is taken round by round to the baseline of that round; "
        "x <= is times as much, x >= is times as fast."
    )


def _titled(loop: str) -> tuple[str, ...]:
    return () if loop == "none" else (loop,)


def _explained(report: Report) -> list[str]:
    cases = {row.case.name: row.case for row in report.rows}
    return [f"{name}: {case.what}" for name, case in cases.items() if case.what]


def _by_loop(report: Report) -> Iterable[tuple[str, list[Row]]]:
    loops = dict.fromkeys(row.loop for row in report.rows)
    return [(loop, [row for row in report.rows if row.loop == loop]) for loop in loops]


def _ratio_cells(ratio: Ratio) -> tuple[str, ...]:
    aim, measured = ratio.aim, ratio.measured
    sign = "<=" if aim.sense is Sense.AT_MOST else ">="
    course = {None: "", True: "yes", False: "NO"}[ratio.on_course]
    if not aim.baseline:
        wanted = "" if aim.factor is None else f"{sign} {figure_text(aim.factor, ratio.measure)}"
        between = f"{_bare(measured.q1, ratio.measure)}..{_bare(measured.q3, ratio.measure)}"
        return (ratio.measure.name, wanted, figure_text(measured.median, ratio.measure), between, course)
    wanted = "" if aim.factor is None else f"{sign} {aim.factor:.4g}x"
    base = aim.compared_with((aim.base_measure or ratio.measure).unit)
    return (base, wanted, f"{measured.median:.2f}x", f"{measured.q1:.2f}..{measured.q3:.2f}", course)


def _pad(cell: str, width: int, column: int, layout: _Layout) -> str:
    return cell.ljust(width) if column in layout.left else cell.rjust(width)


def _bar(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
