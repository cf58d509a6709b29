"""Holds the results of a run of a bench: rows of spreads and ratios, also as plain data. Pure values."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from aiorts_bench.harness.case import Aim, Case, Ledger, Measure, Reading

SCHEMA: Final = 2
"""Version of the plain data; version 1 had nanoseconds for a message and no other measure."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Median of several rounds, with the quartiles and the extremes."""

    median: float
    q1: float
    q3: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """The spread of at least one value."""
        q1, _, q3 = statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else [values[0]] * 3
        return cls(statistics.median(values), q1, q3, min(values), max(values))


@dataclass(frozen=True, slots=True)
class Figured:
    """One measure of a row.

    Attributes:
        rounds: one figure for each round, in order.
        pooled: for a percentile the figure over all rounds together; None for any other measure.
    """

    measure: Measure
    rounds: tuple[float, ...]
    pooled: float | None = None

    @property
    def spread(self) -> Spread:
        """The spread of the rounds."""
        return Spread.of(self.rounds)

    @property
    def displayed(self) -> float:
        """The figure in a table: the percentile over all rounds, or the median of the rounds."""
        return statistics.median(self.rounds) if self.pooled is None else self.pooled

    def plain(self) -> dict[str, Any]:
        """The figure as one JSON object."""
        unit, better = self.measure.unit, self.measure.better
        return {"unit": unit, "better": better, **asdict(self.spread), "pooled": self.pooled, "rounds": [*self.rounds]}


@dataclass(frozen=True, slots=True)
class Ratio:
    """A ratio to a baseline, taken round by round."""

    aim: Aim
    measure: Measure
    rounds: tuple[float, ...]

    @property
    def measured(self) -> Spread:
        """The spread of the rounds."""
        return Spread.of(self.rounds)

    @property
    def on_course(self) -> bool | None:
        """Whether the median meets the aim; None when there is no aim."""
        return self.aim.met(self.measured.median)

    def plain(self) -> dict[str, Any]:
        """The ratio as one JSON object."""
        aim = self.aim
        compared = {"baseline": aim.baseline, "measure": self.measure.name, "sense": aim.sense.value, "aim": aim.factor}
        base = {"times": aim.times, "extra": aim.extra, "floor": aim.floor}
        return {**compared, **base, **asdict(self.measured), "rounds": [*self.rounds], "on_course": self.on_course}


@dataclass(frozen=True, slots=True)
class Row:
    """One case on one loop.

    Attributes:
        messages: their number in all rounds together.
        figures: by name, for the measure that is compared and all columns; without figures that no round gave.
        ledger: the sum over all rounds; None where there is none.
        reported: faults in the readings of the rounds, each once.
    """

    loop: str
    case: Case
    messages: int
    figures: Mapping[str, Figured]
    ratios: tuple[Ratio, ...]
    ledger: Ledger | None
    reported: tuple[str, ...] = ()

    @property
    def spread(self) -> Spread:
        """The spread of the measure that is compared."""
        return self.figures[self.case.measure.name].spread

    @property
    def faults(self) -> tuple[str, ...]:
        """Broken promises, such as a ledger that does not balance. A missed aim is no fault."""
        where = self.case.name if self.loop == "none" else f"{self.case.name} on {self.loop}"
        faults = [f"{where}: {fault}" for fault in self.reported]
        if self.ledger is not None and not self.ledger.balanced:
            faults.append(f"{where}: the ledger does not balance: {self.ledger}")
        if self.ledger is not None and self.case.lossless and not self.ledger.lossless:
            faults.append(f"{where}: lost messages although none may be lost: {self.ledger}")
        return tuple(faults)

    def plain(self) -> dict[str, Any]:
        """The row as one JSON object."""
        case, ledger = self.case, self.ledger
        return {
            "loop": self.loop,
            "case": case.name,
            "what": case.what,
            "axes": dict(case.axes),
            "compared": case.measure.name,
            "peer": case.peer,
            "messages": self.messages,
            "measures": {name: figure.plain() for name, figure in self.figures.items()},
            "ratios": [ratio.plain() for ratio in self.ratios],
            "ledger": None if ledger is None else _plain_ledger(ledger, case.lossless),
        }


def _plain_ledger(ledger: Ledger, lossless: bool) -> dict[str, Any]:
    promised = "lossless" if lossless else "newest"
    return {**asdict(ledger), "balanced": ledger.balanced, "lossless": ledger.lossless, "promised": promised}


@dataclass(frozen=True, slots=True)
class Series:
    """A line of a figure: (x, y, lowest y, highest y) for each point."""

    name: str
    points: tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Figure:
    """A chart that `--plot` draws: lines over an axis.

    Attributes:
        log: names the logarithmic axes ("x", "y", "xy", "").
        note: one line beneath the title.
        mark: where a vertical line stands, such as the reader's capacity.
    """

    title: str
    x: str
    x_unit: str
    y: str
    y_unit: str
    series: tuple[Series, ...]
    log: str = "xy"
    note: str = ""
    mark: float | None = None


@dataclass(frozen=True, slots=True)
class Report:
    """A whole run.

    Attributes:
        bench: name of the bench.
        command: the command line that repeats it.
        how: how to read the figures; "" takes the sentence for interleaved rounds.
        notes: lines for the reader beneath the table, such as what was left out and why.
        figures: drawn by `--plot`; without any, the rows are drawn.
    """

    bench: str
    command: str
    machine: Mapping[str, Any]
    rounds: int
    scale: float
    rows: tuple[Row, ...]
    how: str = ""
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()

    @property
    def faults(self) -> tuple[str, ...]:
        """The broken promises of all rows."""
        return tuple(fault for row in self.rows for fault in row.faults)

    def missed(self, slack: float = 0.0) -> tuple[tuple[Row, Ratio], ...]:
        """The aims that are missed by more than the share `slack`."""
        return tuple(
            (row, ratio)
            for row in self.rows
            for ratio in row.ratios
            if ratio.aim.met(ratio.measured.median, slack) is False
        )

    def plain(self) -> dict[str, Any]:
        """The report as one JSON document."""
        return {
            "schema": SCHEMA,
            "bench": self.bench,
            "command": self.command,
            "machine": dict(self.machine),
            "rounds": self.rounds,
            "scale": self.scale,
            "rows": [row.plain() for row in self.rows],
            "notes": list(self.notes),
            "figures": [asdict(figure) for figure in self.figures],
            "faults": list(self.faults),
        }


def row_of(loop: str, case: Case, readings: Mapping[str, Sequence[Reading]]) -> Row:
    """Make the row of a case from the readings of all cases, which are in the order of the rounds.

    Raises:
        LookupError: a round gave no figure to compare, or a baseline is not among the readings.
    """
    own = readings[case.name]
    ledgers = [reading.ledger for reading in own if reading.ledger is not None]
    figures = {measure.name: found for measure in (case.measure, *case.columns) if (found := _figured(measure, own))}
    if case.measure.name not in figures:
        raise LookupError(f"case {case.name!r}: its rounds gave no {case.measure.name!r}")
    return Row(
        loop,
        case,
        sum(reading.messages for reading in own),
        figures,
        tuple(_ratio(case, aim, own, readings) for aim in case.aims),
        sum(ledgers, Ledger()) if ledgers else None,
        tuple(dict.fromkeys(fault for reading in own for fault in reading.faults)),
    )


def _figured(measure: Measure, own: Sequence[Reading]) -> Figured | None:
    rounds = tuple(value for reading in own if (value := measure.of([reading])) is not None)
    if not rounds:
        return None
    return Figured(measure, rounds, None if measure.pool is None else measure.of(own))


def _ratio(case: Case, aim: Aim, own: Sequence[Reading], readings: Mapping[str, Sequence[Reading]]) -> Ratio:
    """Take the ratio round by round: a disturbance of the computer slows case and baseline alike."""
    measure = aim.measure or case.measure
    base_measure = aim.base_measure or measure
    bases = readings[aim.baseline] if aim.baseline else own
    rounds = []
    for mine, theirs in zip(own, bases, strict=True):
        value = measure.of([mine])
        base = base_measure.of([theirs]) if aim.baseline else 1.0
        if value is None or base is None:
            raise LookupError(f"case {case.name!r}: no {measure.name!r} to compare with {aim.baseline!r}")
        rounds.append(aim.ratio(value, base, measure.better))
    return Ratio(aim, measure, tuple(rounds))
