"""The figures of a kernel: rates, losses and waiting samples, from its counters.

Pure: items of the stream `counters` come in, rows for pages come out.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

from aiorts.control import ConnectorCounters
from aiorts_studio.watching.words import said_of, state_of

Row: TypeAlias = Sequence[Any]
_KINDS: Final = ("connectors", "service_connectors", "contexts", "components")
LEFT_OUT: Final = frozenset(("skipped", "superseded"))
"""The reasons of drops that options ask for: every nth sample, the newest alone."""
_LOOKS: Final = 6
"""Looks over which rates are taken: six looks span one second, at five a second."""


class EdgeFigures(NamedTuple):
    """The figures of an edge, in the order in which pages have them."""

    rate: float | None
    """Samples a second; None: unknown, or unknown at the moment."""
    lost: int
    buffered: int
    losing: float
    """Samples that are lost a second."""
    dropped: Mapping[str, int] | None
    """Drops by reason; None where there are none."""
    age: float | None
    """The age of samples in ms, when they are read."""
    trip: float | None
    """The round trip in ms."""


class Figures:
    """The counters of one kernel, and those of the second before."""

    def __init__(self) -> None:
        self.now: dict[str, dict[str, Any]] = {kind: {} for kind in _KINDS}
        self.at_ns = 0
        self.are_old = False
        """Whether the kernel does not answer: its counts are then the last ones, and it has no rates."""
        self.trips: dict[str, float] = {}
        """The round trips of links in ms, by connector."""
        self.ages: dict[str, float] = {}
        """The median ages of samples in ms when they are read, of connectors that are measured."""
        self.late: dict[str, str] = {}
        """The most frequent cause of lateness, by context."""
        self.lossy: set[str] = set()
        """The connectors that have lost samples."""
        self._boxes: dict[str, Row] = {}
        """The rows of components that were made since the component changed last."""
        self._earlier: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_LOOKS)

    def take(self, item: Mapping[str, Any]) -> None:
        """Take an item of the stream: changes, or all."""
        if item["whole"]:
            self._earlier.clear()
            self.now = {kind: {} for kind in _KINDS}
            self.lossy.clear()
            self._boxes.clear()
        elif self.at_ns:
            self._earlier.append((self.at_ns, dict(self.now["connectors"])))
        self.at_ns = item["at_ns"]
        rows = {name: ConnectorCounters.of(row) for name, row in item["connectors"].items()}
        for kind in _KINDS:
            self.now[kind].update(rows if kind == "connectors" else item[kind])
            for name in item["gone"].get(kind, ()):
                self.now[kind].pop(name, None)
        for name, row in rows.items():
            (self.lossy.add if lost(row.dropped) else self.lossy.discard)(name)
        self.lossy.difference_update(item["gone"].get("connectors", ()))
        for name in (*item["components"], *item["gone"].get("components", ())):
            self._boxes.pop(name, None)
        for kept, kind in ((self.trips, "connectors"), (self.late, "contexts")):
            for name in kept.keys() - self.now[kind].keys():
                del kept[name]

    def take_part(self, part: Mapping[str, Any]) -> None:
        """Take the state of links and contexts from an answer of the operation `part`."""
        for name, one in part["connectors"].items():
            if (trip := one["ledger"]["round_trip_ns"]) is not None:
                self.trips[name] = round(trip / 1e6, 3)
        for name, one in part["contexts"].items():
            missed = one["statistics"]["missed"]
            self.late[name] = max(missed, key=missed.__getitem__) if missed else ""

    def edge(self, names: Sequence[str]) -> EdgeFigures | None:
        """The figures of the connectors that one edge stands for: sums, and the largest age and round trip."""
        rows = [row for name in names if (row := self._connector(name)) is not None]
        if len(rows) < 2:
            return rows[0] if rows else None
        reasons: Counter[str] = Counter()
        for row in rows:
            reasons.update(row.dropped or {})
        return EdgeFigures(
            None if self.are_old else _digits(sum(row.rate or 0 for row in rows)),
            sum(row.lost for row in rows),
            sum(row.buffered for row in rows),
            _digits(sum(row.losing for row in rows)),
            dict(reasons) or None,
            max((row.age for row in rows if row.age is not None), default=None),
            max((row.trip for row in rows if row.trip is not None), default=None),
        )

    def _connector(self, name: str) -> EdgeFigures | None:
        one: ConnectorCounters | None = self.now["connectors"].get(name)
        if one is None:
            return None
        rate, losing, reasons = None, 0.0, one.dropped or None
        if self.are_old:
            return EdgeFigures(None, lost(one.dropped), one.buffered, 0.0, reasons, None, None)
        if (before := self._before(name)) is not None:
            at_ns, then = before
            seconds = (self.at_ns - at_ns) / 1e9
            rate = _digits((one.written - then.written) / seconds)
            losing = _digits((lost(one.dropped) - lost(then.dropped)) / seconds)
        age, trip = self.ages.get(name), self.trips.get(name)
        return EdgeFigures(rate, lost(one.dropped), one.buffered, losing, reasons, age, trip)

    def lost(self, name: str) -> int:
        """The samples that the connector has lost."""
        counted = self.now["connectors"].get(name)
        return 0 if counted is None else lost(counted.dropped)

    def rate(self, names: Iterable[str]) -> float | None:
        """The samples a second that come to some connectors; None: unknown, or unknown at the moment."""
        if self.are_old or not self._earlier or self.at_ns == self._earlier[0][0]:
            return None
        (at_ns, before), now = self._earlier[0], self.now["connectors"]
        written = sum(now[name].written - before[name].written for name in names if name in before and name in now)
        return _digits(written / ((self.at_ns - at_ns) / 1e9))

    def _before(self, name: str) -> tuple[int, ConnectorCounters] | None:
        for at_ns, counted in self._earlier:
            if name in counted and at_ns < self.at_ns:
                return at_ns, counted[name]
        return None

    def box(self, name: str) -> Row | None:
        """The state of a component, and words on it; None: unknown, or unknown at the moment."""
        if self.are_old:
            return None
        row = self._boxes.get(name)
        if row is None and (found := self.now["components"].get(name)) is not None:
            states, overdue = found["states"], found.get("overdue") or {}
            row = self._boxes[name] = [state_of(states, failed=found["failed"]), said_of(states, overdue)]
        return row

    def frame(self, context: str) -> Row | None:
        """The lateness of a context in ms (p99; None without a rate), overruns, and most frequent cause of lateness."""
        found = self.now["contexts"].get(context)
        if found is None:
            return None
        late = _digits(found["lateness_p99_ns"] / 1e6) if found["rate"] and not self.are_old else None
        return [late, found["overruns"], self.late.get(context, "")]


def lost(dropped: Mapping[str, int]) -> int:
    """The number of lost samples among the drops by reason: samples left out by an option are not lost."""
    return sum(count for reason, count in dropped.items() if reason not in LEFT_OUT)


def _digits(value: float) -> float:
    """The value, rounded to three digits: more would flicker."""
    return float(f"{value:.3g}")


def different(rows: Mapping[int, Row], told: dict[int, Row], wanted: Iterable[int]) -> dict[int, Row]:
    """The rows that a page has in view and was not sent yet; they count as sent from then on."""
    found = {number: rows[number] for number in wanted if number in rows and told.get(number) != rows[number]}
    told.update(found)
    return found
