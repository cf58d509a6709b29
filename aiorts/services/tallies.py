"""The counts of an interface: of its calls, and of its goals if it has any."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aiorts.model.service_profile import GoalStatistics, ServiceStatistics


class Tally:
    """The counts of an interface's calls."""

    __slots__ = ("calls", "cancelled", "failures", "goals", "max_ns", "refused", "timeouts", "total_ns")

    def __init__(self) -> None:
        self.goals: GoalTally | None = None
        self.calls = self.failures = self.timeouts = self.refused = self.cancelled = self.total_ns = self.max_ns = 0

    def add(self, elapsed_ns: int, outcome: str = "") -> None:
        """Count a call that has ended; `outcome` names its further count, "" for a success."""
        self.calls += 1
        self.total_ns += elapsed_ns
        if elapsed_ns > self.max_ns:
            self.max_ns = elapsed_ns
        if outcome:
            setattr(self, outcome, getattr(self, outcome) + 1)

    @property
    def statistics(self) -> ServiceStatistics:
        """The counts at this moment."""
        from aiorts.model.service_profile import ServiceStatistics

        goals = None if self.goals is None else self.goals.statistics
        return ServiceStatistics(*self.counts, goals=goals)

    @property
    def counts(self) -> tuple[int, int, int, int, int, int, int]:
        """The counts as `ServiceStatistics` has them."""
        return (
            *(self.calls, self.failures, self.timeouts, self.refused, self.cancelled),
            *(self.total_ns, self.max_ns),
        )

    def take_over(self, other: Tally) -> None:
        """Add the counts of another tally."""
        calls, failures, timeouts, refused, cancelled, total_ns, max_ns = other.counts
        self.calls += calls
        self.failures += failures
        self.timeouts += timeouts
        self.refused += refused
        self.cancelled += cancelled
        self.total_ns += total_ns
        self.max_ns = max(self.max_ns, max_ns)
        if other.goals is not None:
            self.goals = self.goals or type(other.goals)()
            self.goals.take_over(other.goals)


class GoalTally:
    """The counts of an interface's goals."""

    __slots__ = ("counts", "failed")

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.failed: Counter[str] = Counter()

    def take_over(self, other: GoalTally) -> None:
        """Add the counts of another tally."""
        self.counts.update(other.counts)
        self.failed.update(other.failed)

    @property
    def statistics(self) -> GoalStatistics:
        """The counts at this moment."""
        from aiorts.model.service_profile import GoalStatistics

        counts, failed = self.counts, self.failed.total()
        offered, accepted = counts["offered"], counts["accepted"]
        return GoalStatistics(
            offered=offered,
            refused=offered - accepted,
            accepted=accepted,
            succeeded=counts["succeeded"],
            failed=MappingProxyType(dict(self.failed)),
            cancelled=counts["cancelled"],
            running=accepted - counts["succeeded"] - counts["cancelled"] - failed,
            feedback=counts["feedback"],
            dropped=counts["dropped"],
        )


def count_in(tallies: Iterable[Tally], what: str, reason: str = "") -> None:
    """Count an event of a goal: a failure by its `reason`, any other by `what`."""
    for tally in tallies:
        if tally.goals is None:
            tally.goals = GoalTally()
        if reason:
            tally.goals.failed[reason] += 1
        else:
            tally.goals.counts[what] += 1
