"""What a case of a bench is: a workload, what it promises, and which ratios to which baselines are aimed at."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

from aiorts import Connector

__all__ = ("Aim", "Case", "Ledger", "Metric", "Reading", "Sense", "Workload")


class Metric(StrEnum):
    """What is compared."""

    COST = "cost"
    """Nanoseconds per message."""
    P50 = "p50"
    """Median latency in nanoseconds."""


class Sense(StrEnum):
    """On which side of the aim a ratio should lie."""

    AT_MOST = "at most"
    """The case takes at most `factor` times what the baseline takes."""
    AT_LEAST = "at least"
    """The case is at least `factor` times as fast as the baseline."""


@dataclass(frozen=True, slots=True)
class Aim:
    """A ratio of a case to a baseline, and where it should lie.

    Attributes:
        baseline: name of the case compared with.
        factor: the aim. None only shows the ratio.
        times: how many times the baseline the case is compared with.
        extra_ns: what is added to that, for example one period of a producer.
    """

    baseline: str
    sense: Sense = Sense.AT_MOST
    factor: float | None = None
    times: float = 1.0
    extra_ns: float = 0.0

    @property
    def compared_with(self) -> str:
        """What stands below the line of the ratio, for a reader."""
        times = "" if self.times == 1.0 else f"{self.times:g} x "
        extra = f"{self.extra_ns / 1e6:g} ms + " if self.extra_ns else ""
        return f"{extra}{times}{self.baseline}"

    def ratio(self, case_ns: float, baseline_ns: float) -> float:
        """The ratio in the sense of this aim."""
        base_ns = self.extra_ns + self.times * baseline_ns
        return case_ns / base_ns if self.sense is Sense.AT_MOST else base_ns / case_ns

    def met(self, ratio: float) -> bool | None:
        """Whether the ratio is where it should be; None when nothing is aimed at."""
        if self.factor is None:
            return None
        return ratio <= self.factor if self.sense is Sense.AT_MOST else ratio >= self.factor


@dataclass(frozen=True, slots=True)
class Ledger:
    """A connector's ledger at the end of a round, and what the reader itself counted."""

    written: int = 0
    delivered: int = 0
    buffered: int = 0
    dropped: int = 0
    received: int = 0

    @classmethod
    def of(cls, connector: Connector, received: int) -> Ledger:
        """The ledger of `connector`, whose reader took `received` samples."""
        counts = connector.statistics
        return cls(counts.written, counts.delivered, counts.buffered, sum(counts.dropped.values()), received)

    def __add__(self, other: Ledger) -> Ledger:
        return Ledger(
            self.written + other.written,
            self.delivered + other.delivered,
            self.buffered + other.buffered,
            self.dropped + other.dropped,
            self.received + other.received,
        )

    @property
    def balanced(self) -> bool:
        """Whether it adds up and the reader agrees with it."""
        return self.written == self.delivered + self.dropped + self.buffered and self.delivered == self.received

    @property
    def lossless(self) -> bool:
        """Whether everything written was delivered."""
        return self.written == self.delivered


@dataclass(frozen=True, slots=True)
class Reading:
    """What one round of one case gave.

    Attributes:
        messages: how many went through.
        cost_ns: nanoseconds per message; None where latency is measured.
        per_second: messages per second; None where latency is measured.
        latencies_ns: one latency per message, or empty.
        ledger: the connector's ledger at the end; None for bare baselines.
    """

    messages: int
    cost_ns: float | None = None
    per_second: float | None = None
    latencies_ns: tuple[int, ...] = ()
    ledger: Ledger | None = None

    @classmethod
    def timed(cls, messages: int, elapsed_ns: int, ledger: Ledger | None = None) -> Reading:
        """`messages` that took `elapsed_ns` altogether, with nothing else to wait for."""
        cost = max(1, elapsed_ns) / messages
        return cls(messages, cost, 1e9 / cost, (), ledger)


Workload: TypeAlias = Callable[[int], Awaitable[Reading]]
"""Sends so many messages and says how it went; builds and tears down everything it needs."""


@dataclass(frozen=True, slots=True)
class Case:
    """One row of a bench.

    Attributes:
        name: unique in the bench; baselines are named by it.
        what: one line for the reader.
        metric: what is compared.
        run: the workload.
        messages: how many for one round at scale 1.
        lossless: whether every message written must be delivered.
    """

    name: str
    what: str
    metric: Metric
    run: Workload
    messages: int
    aims: tuple[Aim, ...] = ()
    lossless: bool = False
