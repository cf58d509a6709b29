"""What a run of a bench gave: rows of spreads and ratios, and the same as plain data. Pure: no clock, no loop."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from aiorts.bench.case import Aim, Case, Ledger, Metric, Reading

__all__ = ("Ratio", "Report", "Row", "Spread", "percentile", "row_of")


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


def percentile(values: Sequence[int], percent: float) -> float:
    """The nearest-rank percentile of at least one value."""
    ordered = sorted(values)
    rank = -(-len(ordered) * percent // 100)
    return float(ordered[max(0, int(rank) - 1)])


@dataclass(frozen=True, slots=True)
class Ratio:
    """A ratio to a baseline, taken round by round, and whether its median is on course (None: nothing is aimed at)."""

    aim: Aim
    measured: Spread
    on_course: bool | None


@dataclass(frozen=True, slots=True)
class Row:
    """One case on one loop.

    Attributes:
        messages: of all rounds together.
        spread: of what is compared, over the rounds: nanoseconds per message, or the median latency.
        per_second: messages per second over the rounds; None where latency is measured.
        p99_ns: 99th percentile of the latencies of all rounds, max_ns the largest; None where cost is measured.
        ledger: of all rounds together; None for a bare baseline.
    """

    loop: str
    case: Case
    messages: int
    spread: Spread
    per_second: Spread | None
    p99_ns: float | None
    max_ns: float | None
    ratios: tuple[Ratio, ...]
    ledger: Ledger | None

    @property
    def faults(self) -> tuple[str, ...]:
        """What was promised and not kept. A ratio that is not on course is none."""
        if self.ledger is None:
            return ()
        where = f"{self.case.name} on {self.loop}"
        faults = [] if self.ledger.balanced else [f"{where}: the ledger does not balance: {self.ledger}"]
        if self.case.lossless and not self.ledger.lossless:
            faults.append(f"{where}: lost messages although none may be lost: {self.ledger}")
        return tuple(faults)

    def plain(self) -> dict[str, Any]:
        """JSON-able."""
        ledger = self.ledger
        return {
            "loop": self.loop,
            "case": self.case.name,
            "what": self.case.what,
            "metric": self.case.metric.value,
            "messages": self.messages,
            "ns": asdict(self.spread),
            "messages_per_second": None if self.per_second is None else asdict(self.per_second),
            "p99_ns": self.p99_ns,
            "max_ns": self.max_ns,
            "ratios": [_plain_ratio(ratio) for ratio in self.ratios],
            "ledger": ledger
            and {**asdict(ledger), "balanced": ledger.balanced, "lossless": ledger.lossless, "promised": self.promise},
        }

    @property
    def promise(self) -> str:
        """What the case promises of its messages."""
        return "lossless" if self.case.lossless else "newest"


def _plain_ratio(ratio: Ratio) -> dict[str, Any]:
    aim = ratio.aim
    return {
        "baseline": aim.baseline,
        "sense": aim.sense.value,
        "aim": aim.factor,
        "times": aim.times,
        "extra_ns": aim.extra_ns,
        "measured": asdict(ratio.measured),
        "on_course": ratio.on_course,
    }


@dataclass(frozen=True, slots=True)
class Report:
    """A whole run."""

    bench: str
    command: str
    machine: Mapping[str, Any]
    rounds: int
    scale: float
    rows: tuple[Row, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """What was promised and not kept, of all rows."""
        return tuple(fault for row in self.rows for fault in row.faults)

    def plain(self) -> dict[str, Any]:
        """JSON-able: one document."""
        return {
            "schema": 1,
            "bench": self.bench,
            "command": self.command,
            "machine": dict(self.machine),
            "rounds": self.rounds,
            "scale": self.scale,
            "rows": [row.plain() for row in self.rows],
            "faults": list(self.faults),
        }


def row_of(loop: str, case: Case, readings: Mapping[str, Sequence[Reading]]) -> Row:
    """The row of a case from the readings of all cases, which stand in the order of the rounds."""
    own = readings[case.name]
    rates = [reading.per_second for reading in own if reading.per_second is not None]
    pooled = [latency for reading in own for latency in reading.latencies_ns]
    ledgers = [reading.ledger for reading in own if reading.ledger is not None]
    return Row(
        loop,
        case,
        sum(reading.messages for reading in own),
        Spread.of([_compared(case.metric, reading) for reading in own]),
        Spread.of(rates) if rates else None,
        percentile(pooled, 99) if pooled else None,
        float(max(pooled)) if pooled else None,
        tuple(_ratio(case.metric, aim, own, readings[aim.baseline]) for aim in case.aims),
        sum(ledgers, Ledger()) if ledgers else None,
    )


def _compared(metric: Metric, reading: Reading) -> float:
    if metric is Metric.P50:
        return float(statistics.median(reading.latencies_ns))
    assert reading.cost_ns is not None  # noqa: S101 - a workload of this metric gives it
    return reading.cost_ns


def _ratio(metric: Metric, aim: Aim, own: Sequence[Reading], base: Sequence[Reading]) -> Ratio:
    """Round by round: what disturbs the machine for a while disturbs both."""
    pairs = zip(own, base, strict=True)
    measured = Spread.of([aim.ratio(_compared(metric, mine), _compared(metric, theirs)) for mine, theirs in pairs])
    return Ratio(aim, measured, aim.met(measured.median))
