"""What `aiorts top` shows: rows of connectors, contexts and components, sorted, filtered and cut to a terminal.

Two readings of the counters and a view make lines of text; nothing here reads, waits or prints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

from aiorts.cli.commands.live.edges import Edge
from aiorts.cli.commands.live.measure.readings import Counters, rate_of
from aiorts.cli.commands.live.spans import span_plain, span_text
from aiorts.cli.console.quote import cells_of
from aiorts.cli.console.report import printed
from aiorts.late import dataclass
from aiorts.model.lifecycle import state_text

KINDS: Final = ("connectors", "contexts", "components")
SORTS: Final = ("name", "rate", "dropped", "buffered", "late")
_HEADS: Final[Mapping[str, tuple[str, ...]]] = {
    "connectors": ("CONNECTOR", "RATE/S", "BUFFERED", "DROPPED/S", "LATENCY", "P99", "DROPPED"),
    "contexts": ("CONTEXT", "RATE/S", "OF", "LATE P50", "P99", "MAX", "OVERRUNS", "SKIPPED"),
    "components": ("COMPONENT", "STATE", "CALLS"),
}
_NONE: Final[Mapping[str, int | None]] = MappingProxyType({})
_NARROWEST: Final = 12
"""Columns that are left of a name at the least."""
_SHORTEST: Final = 3
"""Lines of a table below which it is not begun: title, one row, how many more."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table."""

    cells: tuple[str, ...]
    plain: Mapping[str, Any]
    """As JSON has it."""
    order: Mapping[str, float]
    """By what it is sorted, the greatest first."""

    @property
    def name(self) -> str:
        """What it is of."""
        return self.cells[0]


@dataclass(frozen=True, slots=True)
class View:
    """What is to be seen of the tables, and in which order."""

    kinds: tuple[str, ...] = KINDS
    sort: str = "name"
    reverse: bool = False
    text: str = ""
    """Only rows with this in the name."""
    first: int = 0
    """Rows that are scrolled away."""

    def rows(self, table: Sequence[Row]) -> list[Row]:
        """Those that are to be seen."""
        text = self.text.casefold()
        fitting = [row for row in table if text in row.name.casefold()] if text else list(table)
        if self.sort == "name":
            return sorted(fitting, key=lambda row: row.name, reverse=self.reverse)
        return sorted(fitting, key=lambda row: row.order.get(self.sort, 0.0), reverse=not self.reverse)


Tables = Mapping[str, Sequence[Row]]


def tables(
    now: Counters, before: Counters | None, edges: Mapping[str, Edge], waiting: Mapping[str, int | None] = _NONE
) -> Tables:
    """The rows of all tables; rates only where there is a reading before.

    Args:
        waiting: by the names of links: the samples that wait at either end. A link that is not there has None.
    """
    old = now if before is None else before
    return {
        "connectors": [_connector(edges.get(name), name, now, old, waiting) for name in now["connectors"]],
        "contexts": [_context(name, now, old) for name in now["contexts"]],
        "components": [_component(name, one, old) for name, one in now["components"].items()],
    }


def _connector(edge: Edge | None, name: str, now: Counters, old: Counters, waiting: Mapping[str, int | None]) -> Row:
    written, delivered, here, dropped, measure = now["connectors"][name]
    in_flight = now.get("links", {}).get(name)
    buffered = here if in_flight is None else waiting.get(name)  # of a link this kernel counts its own end alone
    lost, rate = sum(dropped.values()), rate_of(now, old, name)
    before = old["connectors"].get(name)
    losing = None if before is None else _per_second(lost - sum(before[3].values()), now, old)
    timed = now["timed"].get(name, {})
    latency = timed.get("latency")
    reasons = ", ".join(f"{reason} {count}" for reason, count in sorted(dropped.items()))
    empty = "..." if measure else ""
    p50, p99 = (empty, empty) if latency is None else (span_text(latency[1]), span_text(latency[2]))
    path = name if edge is None else edge.path
    return Row(
        (
            path,
            _number(rate),
            "-" if buffered is None else str(buffered),
            _number(losing) if lost else "",
            p50,
            p99,
            reasons,
        ),
        {
            "name": name,
            "from": "" if edge is None else edge.out,
            "to": "" if edge is None else edge.in_,
            "rate": rate,
            "written": written,
            "delivered": delivered,
            "buffered": buffered,
            "in_flight": in_flight,
            "dropped": dropped,
            "measure": measure,
            "latency": span_plain(latency),
            "age": span_plain(timed.get("age")),
        },
        {
            "rate": -1.0 if rate is None else rate,
            "dropped": float(lost),
            "buffered": float(here if buffered is None else buffered),
            "late": 0.0 if latency is None else float(latency[2]),
        },
    )


def _context(name: str, now: Counters, old: Counters) -> Row:
    one: Mapping[str, Any] = now["contexts"][name]
    before = old["contexts"].get(name)
    rate = None if before is None else _per_second(one["cycles"] - before["cycles"], now, old)
    late = [one[f"lateness_{which}_ns"] for which in ("p50", "p99", "max")]
    wanted = "" if one["rate"] is None else f"{one['rate']:g}"
    state = _number(rate) if one["running"] else "stopped"
    counts = (one["overruns"], one["skipped"])
    return Row(
        (
            name,
            state,
            wanted,
            *(span_text(ns) if wanted else "" for ns in late),
            *(str(one) if one else "" for one in counts),
        ),
        {"name": name, "cycles_per_second": rate, **one},
        {"rate": rate or 0.0, "dropped": float(sum(counts)), "late": float(late[1])},
    )


def _component(name: str, one: Mapping[str, Any], old: Counters) -> Row:
    states = state_text(one["states"], one.get("overdue", {}))
    failed = " (failed)" if one["failed"] and "error" not in one["states"].values() else ""
    texts = [
        f"{path} {each['calls']}" + (f" ({each['failures']} failed)" if each["failures"] else "")
        for path, each in one.get("calls", {}).items()
    ]
    texts += [f"{path} {each['accepted']} by threads" for path, each in one.get("thread_writes", {}).items()]
    worst = 2.0 * bool(one["failed"]) + ("active" not in one["states"].values())
    return Row((name, states + failed, ", ".join(texts)), {"name": name, **one}, {"dropped": worst, "late": worst})


def _per_second(more: int, now: Counters, old: Counters) -> float | None:
    span_ns = now["at_ns"] - old["at_ns"]
    return None if span_ns <= 0 or more < 0 else more * 1e9 / span_ns


def _number(rate: float | None) -> str:
    """A rate in few digits."""
    if rate is None:
        return "-"
    return f"{rate:.0f}" if rate >= 10_000 else f"{rate:.1f}"


# -- lines -------------------------------------------------------------------------------------------------------------


def text_of(found: Tables, view: View) -> list[str]:
    """All rows, as many lines as it takes."""
    lines: list[str] = []
    for kind in view.kinds:
        rows = view.rows(found[kind])
        if rows:
            lines += ["", *_columns(kind, rows)] if lines else _columns(kind, rows)
    return lines


def screen_of(found: Tables, view: View, head: str, foot: str, width: int, height: int) -> list[str]:
    """Just so many lines, none wider than `width`."""
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
    """Lines for each table with its title: what is short is whole, what is long shares the rest, the first has most."""
    wanted = [count + 1 if count else 0 for count in counts]
    rooms = [0] * len(wanted)
    for place in range(len(wanted) - 1, 0, -1):
        share = max(_SHORTEST, left // 4) if any(wanted[:place]) else left
        rooms[place] = min(wanted[place], share, left)
        left -= rooms[place]
    rooms[0] = min(wanted[0], left)
    left -= rooms[0]
    for place in range(1, len(wanted)):  # what the first does not need
        more = min(left, wanted[place] - rooms[place])
        rooms[place] += more
        left -= more
    return [room if room > 1 else 0 for room in rooms]


def _columns(kind: str, rows: Sequence[Row], width: int | None = None) -> list[str]:
    """Title and rows, in columns: names and what is said in words to the left, numbers to the right.

    What is wider than `width` loses its empty columns, then the ends of its names; numbers stay.
    """
    cells = [[printed(cell) for cell in one] for one in (_HEADS[kind], *(row.cells for row in rows))]
    count = len(cells[0])
    widths = [max(cells_of(row[column]) for row in cells) for column in range(count)]
    words = {0, count - 1} if kind != "contexts" else {0}
    words |= {1} if kind == "components" else set()
    kept = list(range(count))
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
    """By how much the columns are too wide; the last may be cut where it is words."""
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
