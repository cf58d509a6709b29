"""What connections of service ports are, and what their calls have come to; frozen, plain data as in `profile.py`."""

from __future__ import annotations

from aiorts.late import dataclass


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
class ServiceStatistics:
    """The calls of one interface; times in nanoseconds, from asking to the answer, all waiting included."""

    calls: int = 0
    """Calls that have ended, in whatever way."""
    failures: int = 0
    """Of these: the provider raised, or answered with a wrong type."""
    timeouts: int = 0
    """Of these: not answered within the deadline."""
    refused: int = 0
    """Of these: there was no provider, it was not active, or it would have waited for itself."""
    cancelled: int = 0
    """Of these: the caller was cancelled."""
    total_ns: int = 0
    """All calls together."""
    max_ns: int = 0
    """The longest call."""

    @property
    def mean_ns(self) -> float:
        """The mean duration; 0 without a call."""
        return self.total_ns / self.calls if self.calls else 0.0
