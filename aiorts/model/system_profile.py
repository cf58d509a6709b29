"""The whole system as one frozen value: `Kernel.profile()` makes it, `to_json` writes it, nothing edits it.

All that has a name stands in a mapping by that name, so two profiles are equal when the systems are, whatever the
order things were made in. Numbers of JSON are finite: NaN and the infinities are the texts "NaN", "Infinity" and
"-Infinity".
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

from aiorts.model.blame import GcPauses
from aiorts.model.plain import plain
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics, ContextStatistics, LogLine, PortProfile

__all__ = (
    "PROFILE_VERSION",
    "ClockReport",
    "ComponentReport",
    "ConfigurationReport",
    "ConnectorReport",
    "ContextReport",
    "ParameterReport",
    "SystemProfile",
)

PROFILE_VERSION: Final = 1
"""Raised whenever a reader of the last one would be misled."""
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ParameterReport:
    """A parameter: what is in force and what may be."""

    value: Any
    default: Any
    type: str
    unit: str = ""
    doc: str = ""
    widget: str = ""
    allowed: str = ""
    """In one line, such as "0.0 <= x <= 10.0"; empty when everything is."""
    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None


@dataclass(frozen=True, slots=True)
class ConfigurationReport:
    """Configuration sets: which is active, and the values of each."""

    active: str = "default"
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True)
class ComponentReport:
    """A component at one moment."""

    type: str
    """"module:Class"."""
    doc: str
    """The first line of what the class says of itself."""
    ports: Mapping[str, PortProfile]
    params: Mapping[str, ParameterReport]
    configuration: ConfigurationReport
    states: Mapping[str, str]
    """Life-cycle state by context."""
    last_error: str | None = None
    log: tuple[LogLine, ...] = ()
    """The last lines it logged, oldest first."""


@dataclass(frozen=True, slots=True)
class ConnectorReport:
    """A connector at one moment: between which ports, the options in force, the ledger."""

    source: str
    target: str
    options: ConnectorProfile
    ledger: ConnectorStatistics


@dataclass(frozen=True, slots=True)
class ContextReport:
    """An execution context at one moment."""

    kind: str
    rate: float | None
    """Hz, where it has a rate."""
    members: tuple[str, ...]
    """In order of execution."""
    statistics: ContextStatistics


@dataclass(frozen=True, slots=True)
class ClockReport:
    """The kernel's clock at the moment of the profile."""

    kind: str
    time_ns: int
    """Since the epoch."""
    monotonic_ns: int
    uptime_ns: int
    """Since the kernel was opened."""
    speed: float
    """Seconds of this clock in one real second; 0 where it does not follow the real one."""


@dataclass(frozen=True, slots=True)
class SystemProfile:
    """A kernel and all that is in it, at one moment."""

    name: str
    sequence: int
    """Number of the last event of the bus that this profile knows of."""
    state: str
    """"open", "closing" or "closed"."""
    clock: ClockReport
    versions: Mapping[str, str]
    components: Mapping[str, ComponentReport]
    connectors: Mapping[str, ConnectorReport]
    contexts: Mapping[str, ContextReport]
    gc_pauses: Mapping[str, GcPauses] = field(default_factory=lambda: _NOTHING)
    schema: int = PROFILE_VERSION

    def to_plain(self) -> dict[str, Any]:
        """The profile as JSON has it: dicts, lists, text, numbers, true, false, null."""
        made: dict[str, Any] = plain(self)
        return made

    def to_json(self, indent: int | None = None) -> str:
        """One JSON document, valid by `aiorts.profile_schema()`. It may be called in any thread."""
        return json.dumps(self.to_plain(), ensure_ascii=False, allow_nan=False, indent=indent)

    def structure(self) -> SystemProfile:
        """The same without what changes without an event: time, ledgers, statistics, log lines, pauses."""
        return replace(
            self,
            sequence=0,
            clock=replace(self.clock, time_ns=0, monotonic_ns=0, uptime_ns=0),
            components={name: replace(one, log=()) for name, one in self.components.items()},
            connectors={name: replace(one, ledger=_EMPTY_LEDGER) for name, one in self.connectors.items()},
            contexts={name: replace(one, statistics=_NO_STATISTICS) for name, one in self.contexts.items()},
            gc_pauses=_NOTHING,
        )


_EMPTY_LEDGER: Final = ConnectorStatistics(0, 0, 0, _NOTHING)
_NO_STATISTICS: Final = ContextStatistics(0)
