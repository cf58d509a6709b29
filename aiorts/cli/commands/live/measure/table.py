"""The tables of `aiorts top`: rows of connectors, contexts and components, sorted, filtered and cut to a terminal.

Two readings of the counters and a view make lines of text; this module does not read counters, wait or print.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from aiorts.cli.commands.live.edges import Edge
from aiorts.cli.commands.live.measure.readings import Counters, per_second, rate_of
from aiorts.cli.commands.live.spans import span_plain, span_text
from aiorts.cli.console.quote import cells_of
from aiorts.cli.console.report import printed
from aiorts.late import dataclass
from aiorts.model.lifecycle import state_text
from aiorts.model.timing import ConnectorCounters

KINDS: Final = ("connectors", "contexts", "components")
SORTS: Final = ("name", "rate", "dropped", "buffered", "late")
_NONE: Final[Mapping[str, int | None]] = MappingProxyType({})
_NARROWEST: Final = 12
"""Columns of a name that are kept at least."""
_SHORTEST: Final = 3
"""Lines of the shortest table: title, one row, and the number of further rows."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table."""

    name: str
    """The name of the thing, which is the first column."""
    plain: Mapping[str, Any]
    """The row as JSON has it."""
    order: Mapping[str, float]
    """The values by which the row is sorted, the greatest first."""


@dataclass(frozen=True, slots=True)
class View:
    """The visible part of the tables, and its order."""

    kinds: tuple[str, ...] = KINDS
    sort: str = "name"
    reverse: bool = False
    text: str = ""
    """The text that the names of visible rows contain."""
    first: int = 0
    """The number of rows that are scrolled away."""

    def rows(self, table: Sequence[Row]) -> list[Row]:
        """The rows that pass the filter, in order."""
        text = self.text.casefold()
        fitting = [row for row in table if text in row.name.casefold()] if text else list(table)
        if self.sort == "name":
            return sorted(fitting, key=lambda row: row.name, reverse=self.reverse)
        return sorted(fitting, key=lambda row: row.order.get(self.sort, 0.0), reverse=not self.reverse)


Tables = Mapping[str, Sequence[Row]]


def tables(
    now: Counters, before: Counters | None, edges: Mapping[str, Edge], waiting: Mapping[str, int | None] = _NONE
) -> Tables:
    """The rows of all tables; rates only where there is an earlier reading.

    Args:
        waiting: the samples that wait at either end of a link, by its name; None where they are not known.
    """
    old = now if before is None else before
    return {
        "connectors": [_connector(edges.get(name), name, now, old, waiting) for name in now["connectors"]],
        "contexts": [_context(name, now, old) for name in now["contexts"]],
        "components": [_component(name, one, old) for name, one in now["components"].items()],
    }


def _connector(edge: Edge | None, name: str, now: Counters, old: Counters, waiting: Mapping[str, int | None]) -> Row:
    one: ConnectorCounters = now["connectors"][name]
    before: ConnectorCounters | None = old["connectors"].get(name)
    in_flight = now.get("links", {}).get(name)
    # This kernel counts only its own end of a link.
    buffered = one.buffered if in_flight is None else waiting.get(name)
    rate = rate_of(now, old, name)
    timed = now["timed"].get(name, {})
    latency = span_plain(timed.get("latency"))
    return Row(
        name if edge is None else edge.path,
        {
            "name": name,
            "from": "" if edge is None else edge.out,
            "to": "" if edge is None else edge.in_,
            "rate": rate,
            **one._asdict(),
            "buffered": buffered,
            "in_flight": in_flight,
            "dropped_per_second": None if before is None else per_second(one.lost - before.lost, now, old),
            "latency": latency,
            "age": span_plain(timed.get("age")),
        },
        {
            "rate": -1.0 if rate is None else rate,
            "dropped": float(one.lost),
            "buffered": float(one.buffered if buffered is None else buffered),
            "late": 0.0 if latency is None else float(latency["p99_ns"]),
        },
    )


def _context(name: str, now: Counters, old: Counters) -> Row:
    one: Mapping[str, Any] = now["contexts"][name]
    before = old["contexts"].get(name)
    rate = None if before is None else per_second(one["cycles"] - before["cycles"], now, old)
    missed = float(one["overruns"] + one["skipped"])
    return Row(
        name,
        {"name": name, "cycles_per_second": rate, **one},
        {"rate": rate or 0.0, "dropped": missed, "late": float(one["lateness_p99_ns"])},
    )


def _component(name: str, one: Mapping[str, Any], old: Counters) -> Row:
    worst = 2.0 * bool(one["failed"]) + ("active" not in one["states"].values())
    return Row(name, {"name": name, **one}, {"dropped": worst, "late": worst})


# -- columns -----------------------------------------------------------------------------------------------------------


class Column(NamedTuple):
    """A column of a table: its title, and the function that makes a cell of a row as JSON has it."""

    title: str
    cell: Callable[[Mapping[str, Any]], str]
    is_words: bool = False
    """Whether the column is text, which is aligned to the left; numbers are aligned to the right."""


def _number(rate: float | None) -> str:
    """A rate with few digits."""
    if rate is None:
        return "-"
    return f"{rate:.0f}" if rate >= 10_000 else f"{rate:.1f}"


def _span(spans: str, figure: str) -> Callable[[Mapping[str, Any]], str]:
    """Make the cell of a measured span of a connector; "..." where no sample was read yet."""

    def cell(one: Mapping[str, Any]) -> str:
        if one[spans] is None:
            return "..." if one["measure"] else ""
        return span_text(one[spans][figure])

    return cell


def _late(figure: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda one: span_text(one[f"lateness_{figure}_ns"]) if one["rate"] is not None else ""


def _losing(one: Mapping[str, Any]) -> str:
    return _number(one["dropped_per_second"]) if any(one["dropped"].values()) else ""


def _reasons(one: Mapping[str, Any]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in sorted(one["dropped"].items()))


def _states(one: Mapping[str, Any]) -> str:
    failed = " (failed)" if one["failed"] and "error" not in one["states"].values() else ""
    return state_text(one["states"], one.get("overdue", {})) + failed


def _calls(one: Mapping[str, Any]) -> str:
    texts = [
        f"{path} {each['calls']}" + (f" ({each['failures']} failed)" if each["failures"] else "")
        for path, each in one.get("calls", {}).items()
    ]
    texts += [f"{path} {each['accepted']} by threads" for path, each in one.get("thread_writes", {}).items()]
    return ", ".join(texts)


_NAMED: Final = {"connectors": "CONNECTOR", "contexts": "CONTEXT", "components": "COMPONENT"}
"""The titles of the first columns, with the rows' names."""
_COLUMNS: Final[Mapping[str, tuple[Column, ...]]] = {
    "connectors": (
        Column("RATE/S", lambda one: _number(one["rate"])),
        Column("BUFFERED", lambda one: "-" if one["buffered"] is None else str(one["buffered"])),
        Column("DROPPED/S", _losing),
        Column("LATENCY", _span("latency", "p50_ns")),
        Column("P99", _span("latency", "p99_ns")),
        Column("DROPPED", _reasons, is_words=True),
    ),
    "contexts": (
        Column("RATE/S", lambda one: _number(one["cycles_per_second"]) if one["running"] else "stopped"),
        Column("OF", lambda one: "" if one["rate"] is None else f"{one['rate']:g}"),
        Column("LATE P50", _late("p50")),
        Column("P99", _late("p99")),
        Column("MAX", _late("max")),
        Column("OVERRUNS", lambda one: str(one["overruns"] or "")),
        Column("SKIPPED", lambda one: str(one["skipped"] or "")),
    ),
    "components": (Column("STATE", _states, is_words=True), Column("CALLS", _calls, is_words=True)),
}


# -- lines -------------------------------------------------------------------------------------------------------------


def text_of(found: Tables, view: View) -> list[str]:
    """All visible rows, as lines."""
    lines: list[str] = []
    for kind in view.kinds:
        rows = view.rows(found[kind])
        if rows:
            lines += ["", *_columns(kind, rows)] if lines else _columns(kind, rows)
    return lines


def screen_of(found: Tables, view: View, head: str, foot: str, width: int, height: int) -> list[str]:
    """Exactly `height` lines, none wider than `width`."""
    parts = {kind: view.rows(found[kind]) for kind in view.kinds}
    lines = [head]
    left = height - 2
    for kind, room in zip(parts, _rooms([len(rows) for rows in parts.values()], left), strict=True):
        rows = parts[kind]
        first = min(view.first, max(0, len(rows) - (room - 1)))
        shown = rows[first : first + room - 1]
        if room and rows:
            more = f"  {first + 1}-{first + len(shown)} of {len(rows)}" if len(shown) < len(rows) else ""
            title, *body = _columns(kind, shown, width)
            lines += [title + more, *body]
    lines += [""] * (height - 1 - len(lines))
    return [fitted(line, width) for line in (*lines[: height - 1], foot)][:height]


def _rooms(counts: Sequence[int], left: int) -> list[int]:
    """The lines for each table with its title: short tables are whole, long ones share the rest, the first has most."""
    wanted = [count + 1 if count else 0 for count in counts]
    rooms = [0] * len(wanted)
    for place in range(len(wanted) - 1, 0, -1):
        share = max(_SHORTEST, left // 4) if any(wanted[:place]) else left
        rooms[place] = min(wanted[place], share, left)
        left -= rooms[place]
    rooms[0] = min(wanted[0], left)
    left -= rooms[0]
    for place in range(1, len(wanted)):  # lines that the first table does not need
        more = min(left, wanted[place] - rooms[place])
        rooms[place] += more
        left -= more
    return [room if room > 1 else 0 for room in rooms]


def _columns(kind: str, rows: Sequence[Row], width: int | None = None) -> list[str]:
    """Title and rows in columns: names and text aligned to the left, numbers to the right.

    A table wider than `width` loses its empty columns, then the ends of its names; numbers stay.
    """
    columns = _COLUMNS[kind]
    texts = [[row.name, *(column.cell(row.plain) for column in columns)] for row in rows]
    cells = [[_NAMED[kind], *(column.title for column in columns)], *([printed(cell) for cell in row] for row in texts)]
    widths = [max(map(cells_of, column)) for column in zip(*cells, strict=True)]
    words = {0, *(place for place, column in enumerate(columns, 1) if column.is_words)}
    kept = list(range(len(widths)))
    if width is not None and _beyond(widths, kept, words, width) > 0:
        kept = [place for place in kept if any(row[place] for row in cells[1:])]
        widths[0] = min(widths[0], max(_NARROWEST, widths[0] - _beyond(widths, kept, words, width)))
    lines = []
    for row in cells:
        padded = []
        for place in kept:
            cell = row[place] if place or cells_of(row[0]) <= widths[0] else f"{fitted(row[0], widths[0] - 2)}.."
            space = " " * (widths[place] - cells_of(cell))
            padded.append(cell + space if place in words else space + cell)
        lines.append("  ".join(padded).rstrip())
    return lines


def _beyond(widths: Sequence[int], kept: Sequence[int], words: set[int], width: int) -> int:
    """The width by which the columns exceed `width`; a last column of text does not count, since it may be cut."""
    counted = [place for place in kept if place == 0 or place not in words or place != len(widths) - 1]
    return sum(widths[place] + 2 for place in counted) - 2 - width


def fitted(line: str, width: int) -> str:
    """The line, cut to so many columns."""
    if line.isascii():
        return line[:width]
    used = 0
    for place, character in enumerate(line):
        used += cells_of(character)
        if used > width:
            return line[:place]
    return line
