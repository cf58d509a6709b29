"""The whole system as one frozen value: `Kernel.profile()` makes it, `to_json` writes it, nothing edits it.

Everything with a name is in a mapping by that name, so two profiles are equal when the systems are, in whatever order
they were made. A field that only some components have (a state machine, modes, members) is None for the others. Numbers
of JSON are finite: NaN and the infinities are the texts "NaN", "Infinity" and "-Infinity".
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import field, replace
from types import MappingProxyType
from typing import Any, Final

from aiorts.late import dataclass
from aiorts.model.blame import GcPauses
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.plain import plain
from aiorts.model.profile import (
    ConnectorProfile,
    ConnectorStatistics,
    ContextStatistics,
    LogLine,
    PortProfile,
    ThreadWriteStatistics,
)
from aiorts.model.service_profile import ServiceStatistics

PROFILE_VERSION: Final = 1
"""The version of a profile's form, raised with each change that would mislead a reader of the previous form."""
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Limits:
    """The allowed values of one element of a parameter, or of one of its keys; None: no such limit."""

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None


@dataclass(frozen=True, slots=True)
class ParameterReport:
    """A parameter: its value, and which values are allowed."""

    value: Any
    """The value in force."""
    default: Any
    type: str
    unit: str = ""
    doc: str = ""
    widget: str = ""
    allowed: str = ""
    """The allowed values in one line, such as "0.0 <= x <= 10.0"; empty when every value is allowed."""
    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    choices: tuple[Any, ...] | None = None
    pattern: str | None = None
    declared: bool = True
    """Whether the class declares the parameter; else it was added at run time."""
    file: str = ""
    """"read" or "write" when the value names a file that the component reads, or writes."""
    elements: tuple[Limits, ...] | None = None
    """The limits of each element of a tuple; None where the limits above hold for all of them."""
    keys: Mapping[str, Limits] | None = None
    """The limits of each value of a mapping with fixed keys; None for any other parameter."""


@dataclass(frozen=True, slots=True)
class ConfigurationReport:
    """Configuration sets: the active one, and the values of each; values not named in a set are as in "default"."""

    active: str = "default"
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True)
class MachineReport:
    """The state machine of a component at one moment."""

    chart: str
    """The name of its table."""
    states: tuple[str, ...]
    """The active states, the outer before the inner; none while the component is not active."""
    history: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: _NOTHING)
    """The states that each history would restore; none before its state was left for the first time."""
    timers: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    """The deadline of each running timer, on the kernel's monotonic clock, in nanoseconds."""
    ignored: int = 0
    """Events that led to nothing."""
    deferred: tuple[str, ...] = ()
    """Events that active states keep for later, in the order of arrival."""


@dataclass(frozen=True, slots=True)
class ModeReport:
    """The modes of a component, and its present mode."""

    modes: tuple[str, ...]
    mode: str
    """The mode in the context whose hook runs, else the mode requested last."""
    by_context: Mapping[str, str]
    pending: str | None = None
    """The mode requested last, while it is not in force in every context."""


@dataclass(frozen=True, slots=True)
class CompositeReport:
    """The members of a composite, its parts and its exported ports."""

    members: tuple[str, ...]
    """The members in the declared order."""
    parts: tuple[str, ...]
    """The components that run with it, in order of execution; a composite among them is replaced by its parts."""
    exported: Mapping[str, str]
    """The ports that the composite shows: each name with the path of the member's port."""
    groups: tuple[tuple[str, ...], ...] = ()
    """The members that run side by side, by group."""
    order: str = "stated"
    errors: str = "stop"
    """The effect of a member's error on the composite."""
    own_schedule: bool = False


@dataclass(frozen=True, slots=True)
class ComponentReport:
    """A component at one moment."""

    type: str
    """"module:Class"."""
    doc: str
    """The first line of the class's docstring."""
    ports: Mapping[str, PortProfile]
    params: Mapping[str, ParameterReport]
    configuration: ConfigurationReport
    states: Mapping[str, str]
    """Lifecycle state by context."""
    last_error: str | None = None
    """The error of the last failure; None after a reset or a new activation."""
    log: tuple[LogLine, ...] = ()
    """The last lines it logged, oldest first."""
    calls: Mapping[str, ServiceStatistics] = field(default_factory=lambda: _NOTHING)
    """The calls through each interface of its service ports, by "port", or "port.interface" where the names differ."""
    machine: MachineReport | None = None
    modes: ModeReport | None = None
    composite: CompositeReport | None = None
    thread_writes: Mapping[str, ThreadWriteStatistics] = field(default_factory=lambda: _NOTHING)
    """The counts of `write_from_thread` of each out-port where a thread wrote."""
    overdue: Mapping[str, OverdueHook] = field(default_factory=lambda: _NOTHING)
    """The hook that runs longer than its deadline, by context, where one does at this moment."""


@dataclass(frozen=True, slots=True)
class ConnectorReport:
    """A connector at one moment: its ports, the options in force, the ledger."""

    source: str
    target: str
    options: ConnectorProfile
    ledger: ConnectorStatistics


@dataclass(frozen=True, slots=True)
class BindingReport:
    """A required interface bound to a provided one at one moment."""

    required: str
    """The path of the caller's interface."""
    provided: str
    """The path of the interface that answers."""
    interface: str
    statistics: ServiceStatistics = field(default_factory=ServiceStatistics)
    """The statistics of the calls over this binding only."""
    waiting: int = 0
    """Calls that wait or run."""


@dataclass(frozen=True, slots=True)
class ServiceConnectorReport:
    """A connector of two service ports at one moment."""

    ports: tuple[str, ...]
    """Paths, in the order they were given."""
    bindings: tuple[BindingReport, ...]
    strict: bool = True
    """Whether it was to bind every required interface or none."""


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
    """Nanoseconds since a fixed moment, the time of deadlines and log lines."""
    uptime_ns: int
    """Since the kernel was opened."""
    speed: float
    """Seconds of this clock in one real second; 0 where it does not follow the real one."""


@dataclass(frozen=True, slots=True)
class SystemProfile:
    """A kernel and all that is in it, at one moment."""

    name: str
    sequence: int
    """The number of the last bus event that this profile includes."""
    state: str
    """"open", "closing" or "closed"."""
    clock: ClockReport
    versions: Mapping[str, str]
    """The versions of aiorts and Python, and the implementation of Python."""
    components: Mapping[str, ComponentReport]
    connectors: Mapping[str, ConnectorReport]
    contexts: Mapping[str, ContextReport]
    gc_pauses: Mapping[str, GcPauses] = field(default_factory=lambda: _NOTHING)
    """Garbage collections by generation."""
    service_connectors: Mapping[str, ServiceConnectorReport] = field(default_factory=lambda: _NOTHING)
    services: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    """The reports of services attached to the kernel, by name of the service."""
    lasting: str = ""
    """The name by which the kernel is known again after a restart: "host/NAME", or, if it has no given name,
    "host/PROGRAM:FILE". Kernels that run the same file share this name. "" where clients cannot reach the kernel."""
    assembled: bool | None = None
    """Whether the system of the run is complete; None: a program makes the system, and does not report that."""
    schema: int = PROFILE_VERSION

    def to_plain(self) -> dict[str, Any]:
        """The profile as JSON has it: dicts, lists, text, numbers, true, false, null."""
        made: dict[str, Any] = plain(self)
        return made

    def to_json(self, indent: int | None = None) -> str:
        """One JSON document, valid by `aiorts.profile_schema()`. It may be called in any thread."""
        return json.dumps(self.to_plain(), ensure_ascii=False, allow_nan=False, indent=indent)

    def structure(self) -> SystemProfile:
        """The profile without the values that change without an event: time, ledgers, statistics, log lines, pauses,
        late hooks, what a state machine remembers, timers, modes that are pending."""
        return replace(
            self,
            sequence=0,
            clock=replace(self.clock, time_ns=0, monotonic_ns=0, uptime_ns=0),
            components={name: _lasting(one) for name, one in self.components.items()},
            connectors={name: replace(one, ledger=_EMPTY_LEDGER) for name, one in self.connectors.items()},
            contexts={name: replace(one, statistics=_NO_STATISTICS) for name, one in self.contexts.items()},
            service_connectors={name: _unused(one) for name, one in self.service_connectors.items()},
            gc_pauses=_NOTHING,
            services=_NOTHING,
        )


def _lasting(one: ComponentReport) -> ComponentReport:
    """The report without the values that change without an event."""
    machine, modes = one.machine, one.modes
    if machine is not None:
        machine = MachineReport(machine.chart, machine.states)
    if modes is not None:
        modes = replace(modes, pending=None)
    return replace(one, log=(), calls=_NOTHING, machine=machine, modes=modes, thread_writes=_NOTHING, overdue=_NOTHING)


def _unused(one: ServiceConnectorReport) -> ServiceConnectorReport:
    bindings = tuple(BindingReport(each.required, each.provided, each.interface) for each in one.bindings)
    return replace(one, bindings=bindings)


_EMPTY_LEDGER: Final = ConnectorStatistics(0, 0, 0, _NOTHING)
_NO_STATISTICS: Final = ContextStatistics(0)
