"""Descriptions of service ports' connectors, and the counts of their calls; frozen, plain data as in `profile.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

from aiorts.late import dataclass

_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ServiceConnectorProfile:
    """The options in force of a connector of service ports."""

    name: str
    ports: tuple[str, ...] = ()
    mapping: tuple[tuple[str, str], ...] = ()
    """Each required interface with the provided one that answers it, as paths."""
    strict: bool = True
    """Whether every required interface has to be bound."""


@dataclass(frozen=True, slots=True)
class GoalStatistics:
    """The goals of one interface: offered = refused + accepted, accepted = succeeded + failed + cancelled + running."""

    offered: int = 0
    """Ended calls of its methods that answer with a goal."""
    refused: int = 0
    """Offered calls without a goal: the method raised, was not reached, or did not answer in time."""
    accepted: int = 0
    """Offered calls with a goal."""
    succeeded: int = 0
    """Goals that ended with a result."""
    failed: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    """Goals that ended without a result, by reason: "provider" (which failed it), "cancel_timeout" (the provider was
    asked to cancel it and did not in time), "deactivated", "error", "reloaded", "removed", "closed" (the fate of the
    provider, or of its kernel), "mismatch" (a result or feedback of a wrong type came before the goal was accepted)."""
    cancelled: int = 0
    """Goals that the provider cancelled on request."""
    running: int = 0
    """Goals that have not ended."""
    feedback: int = 0
    """Feedback that providers gave."""
    dropped: int = 0
    """Feedback that the client did not read before eight newer ones had come."""

    @property
    def balanced(self) -> bool:
        """Whether the sums are right; they always are."""
        ended = self.succeeded + sum(self.failed.values()) + self.cancelled
        return self.offered == self.refused + self.accepted and self.accepted == ended + self.running


@dataclass(frozen=True, slots=True)
class ServiceStatistics:
    """The calls of one interface; times in nanoseconds, from asking to the answer, all waiting included."""

    calls: int = 0
    """Calls that have ended, in whatever way."""
    failures: int = 0
    """Calls whose provider raised, or answered with a wrong type."""
    timeouts: int = 0
    """Calls that were not answered within the deadline."""
    refused: int = 0
    """Calls for which there was no provider, it was not active, or it would have waited for itself."""
    cancelled: int = 0
    """Calls whose caller was cancelled."""
    total_ns: int = 0
    """The duration of all calls together."""
    max_ns: int = 0
    """The longest call."""
    goals: GoalStatistics | None = None
    """The counts of its goals; None where no method answers with one, or nothing was connected yet."""

    @property
    def mean_ns(self) -> float:
        """The mean duration; 0 without a call."""
        return self.total_ns / self.calls if self.calls else 0.0
