"""Defines a case of a bench: its workload, what it measures, and the ratios to baselines it aims at. Pure values."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, Literal, TypeAlias

from aiorts import Connector

NANOSECONDS: Final = {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9}
"""Nanoseconds in one unit of time."""


@dataclass(frozen=True, slots=True)
class Measure:
    """A figure with a name: one value for each round.

    Attributes:
        name: the key in `Reading.values`, in tables and in JSON.
        unit: shown after the figure; a figure in "1/s" is shown with k or M.
        better: which direction is an improvement.
        digits: decimals shown.
        pool: the measure is a percentile of this pool of `Reading.pools` (nanoseconds) instead of a value of its own;
            `unit` must then be ns, us, ms or s.
        percent: which percentile; 100 is the largest.
    """

    name: str
    unit: str = ""
    better: Literal["less", "more"] = "less"
    digits: int = 0
    pool: str | None = None
    percent: float = 50.0

    def of(self, readings: Sequence[Reading]) -> float | None:
        """The figure of one round, or of a pool over several rounds; None when the readings lack it."""
        if self.pool is None:
            values = [reading.values[self.name] for reading in readings if self.name in reading.values]
            return sum(values) / len(values) if values else None
        pooled = [one for reading in readings for one in reading.pools.get(self.pool, ())]
        return percentile(pooled, self.percent) / NANOSECONDS[self.unit] if pooled else None


COST: Final = Measure("cost", "ns")
"""Nanoseconds for one message, or for one unit of what the case counts."""
RATE: Final = Measure("rate", "1/s", "more")
"""Messages in a second."""
CPU: Final = Measure("cpu", "%", digits=0)
"""Share of one core that the process used."""
LATENCY: Final = Measure("latency p50", "us", digits=1, pool="latency")
"""Median latency of a round."""


def tails(
    pool: str, *percents: float, unit: str = "us", digits: int = 1, label: str | None = None
) -> tuple[Measure, ...]:
    """Measures such as "age p99" for percentiles of a pool; 100 is called "max". Without percents 99, 99.9 and 100.

    Args:
        label: stands in the place of the pool's name; "" leaves "p99", so that rows of different pools share a column.
    """
    prefix = pool if label is None else label
    return tuple(
        Measure(f"{prefix} {'max' if percent == 100 else f'p{percent:g}'}".strip(), unit, "less", digits, pool, percent)
        for percent in percents or (99.0, 99.9, 100.0)
    )


def percentile(values: Sequence[float], percent: float) -> float:
    """The nearest-rank percentile of at least one value; for 50 the mean of the two middle values."""
    ordered = sorted(values)
    if percent == 50:
        half = len(ordered) // 2
        return float(ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2)
    rank = -(-len(ordered) * percent // 100)
    return float(ordered[max(0, int(rank) - 1)])


class Sense(StrEnum):
    """The side of the aim on which a ratio should lie."""

    AT_MOST = "at most"
    """The ratio says how many times as bad the case is: it takes at most `factor` times what the baseline takes."""
    AT_LEAST = "at least"
    """The ratio says how many times as good the case is: at least `factor` times as fast as the baseline."""


@dataclass(frozen=True, slots=True)
class Aim:
    """A ratio of a case to a baseline, and where it should lie.

    Attributes:
        baseline: name of the case compared with; "" when the figure itself is the aim (`factor` is then in its unit).
        factor: the aim. None only shows the ratio.
        times: a factor for the baseline's figure.
        extra: added to that product, in the measure's unit, for example one period of a producer.
        floor: the least value of that sum, in the measure's unit.
        measure: the measure compared; None takes the measure of the case.
        base_measure: the measure of the baseline; None takes `measure`.
    """

    baseline: str
    sense: Sense = Sense.AT_MOST
    factor: float | None = None
    times: float = 1.0
    extra: float = 0.0
    floor: float = 0.0
    measure: Measure | None = None
    base_measure: Measure | None = None

    def compared_with(self, unit: str) -> str:
        """The denominator of the ratio, as text."""
        if not self.baseline:
            return "the figure itself"
        times = "" if self.times == 1.0 else f"{self.times:g} x "
        extra = f"{self.extra:g} {unit} + " if self.extra else ""
        base = f"{extra}{times}{self.baseline}"
        return f"max({self.floor:g} {unit}, {base})" if self.floor else base

    def ratio(self, own: float, base: float, better: str = "less") -> float:
        """The ratio, oriented by the sense of this aim; without a baseline `own` itself."""
        if not self.baseline:
            return own
        base = max(self.floor, self.extra + self.times * base)
        upright = (self.sense is Sense.AT_MOST) is (better == "less")
        above, below = (own, base) if upright else (base, own)
        return above / below if below else (1.0 if above == below else float("inf"))

    def met(self, ratio: float, slack: float = 0.0) -> bool | None:
        """Whether the ratio meets the aim, give or take the share `slack`; None when there is no aim."""
        if self.factor is None:
            return None
        if self.sense is Sense.AT_MOST:
            return ratio <= self.factor * (1 + slack)
        return ratio >= self.factor / (1 + slack)


@dataclass(frozen=True, slots=True)
class Ledger:
    """A connector's ledger at the end of a round, and the reader's own count."""

    written: int = 0
    delivered: int = 0
    buffered: int = 0
    received: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Dropped samples, by reason."""

    @classmethod
    def of(cls, connector: Connector, received: int) -> Ledger:
        """The ledger of `connector`, whose reader took `received` samples."""
        counts = connector.statistics
        dropped = {str(reason): count for reason, count in counts.dropped.items() if count}
        return cls(counts.written, counts.arrived, counts.buffered, received, dropped)

    def __add__(self, other: Ledger) -> Ledger:
        reasons = dict.fromkeys((*self.dropped, *other.dropped))
        return Ledger(
            self.written + other.written,
            self.delivered + other.delivered,
            self.buffered + other.buffered,
            self.received + other.received,
            {reason: self.dropped.get(reason, 0) + other.dropped.get(reason, 0) for reason in reasons},
        )

    @property
    def balanced(self) -> bool:
        """Whether written = delivered + dropped + buffered, and the reader counted as many as were delivered."""
        lost = sum(self.dropped.values())
        return self.written == self.delivered + lost + self.buffered and self.delivered == self.received

    @property
    def lossless(self) -> bool:
        """Whether everything written was delivered."""
        return self.written == self.delivered


@dataclass(frozen=True, slots=True)
class Reading:
    """The result of one round of one case.

    Attributes:
        values: figures by the name of their measure, in its unit.
        messages: how many went through, or how many units of what the case counts.
        pools: single observations in nanoseconds by name ("latency", "age"); percentiles are taken of them.
        ledger: the connectors' ledger at the end; None where there is none, as for bare baselines.
        faults: what went wrong in words; each makes the bench end with status 1.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    messages: int = 1
    pools: Mapping[str, Sequence[float]] = field(default_factory=dict)
    ledger: Ledger | None = None
    faults: tuple[str, ...] = ()

    @classmethod
    def timed(cls, messages: int, elapsed_ns: int, ledger: Ledger | None = None, **values: float) -> Reading:
        """COST and RATE of `messages` that took `elapsed_ns` altogether."""
        cost = max(1, elapsed_ns) / messages
        return cls({"cost": cost, "rate": 1e9 / cost, **values}, messages, ledger=ledger)


Workload: TypeAlias = Callable[[int], "Awaitable[Reading] | Reading"]
"""Does the work of a case a number of times and returns the reading; sets up and ends all that it needs. A plain
function may block and may start processes; a coroutine runs on the loop that is measured."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of a bench.

    Attributes:
        name: unique in the bench; aims name their baseline by it.
        what: one line that explains it.
        measure: the figure that is compared with baselines, with other cases and with an older run.
        run: the workload.
        messages: their number in one round at scale 1.
        lossless: whether every message written must be delivered.
        columns: further measures to show; a table has the columns of all its rows.
        drawn: measures that a plot shows in addition to `measure`.
        warm: whether a small round is run before the first that counts.
        axes: the word on each axis of a grid, by the name of the axis; shown in the place of `name`.
        peer: whether it measures another library, so that `--compare` ignores its changes.
    """

    name: str
    what: str
    measure: Measure
    run: Workload
    messages: int = 1
    aims: tuple[Aim, ...] = ()
    lossless: bool = False
    columns: tuple[Measure, ...] = ()
    drawn: tuple[Measure, ...] = ()
    warm: bool = True
    axes: Mapping[str, str] = field(default_factory=dict)
    peer: bool = False
