"""Takes the profile of a system, or of a part of it: on the loop, at one moment, without disturbing the system. No
sample is taken, no lock is awaited for longer than an update of a ledger, and parts that cannot have changed since the
last profile are not described again.
"""

from __future__ import annotations

import platform
import sys
from dataclasses import fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from aiorts.clock import SimulatedClock
from aiorts.diagnostics import DeadlineMonitor
from aiorts.errors import format_error
from aiorts.kernel.declarations import declarations, kinds_of
from aiorts.kernel.execution.cell import cell, standing_error
from aiorts.kernel.execution.member import overdue_hooks
from aiorts.kernel.service import reports
from aiorts.model.configuration.constraints import Constraint
from aiorts.model.configuration.parameters import ParameterSpec
from aiorts.observe import special_reports
from aiorts.observe.profiles import (
    ClockReport,
    ComponentReport,
    ConfigurationReport,
    ConnectorReport,
    ContextReport,
    Limits,
    ParameterReport,
    ServiceConnectorReport,
    SystemProfile,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.services import ServiceConnector

_BOUNDS: Final = tuple(one.name for one in fields(Limits))
_frozen: Final = MappingProxyType
_KNOWN: Final[WeakKeyDictionary[type, _Kind]] = WeakKeyDictionary()


class _Kind:
    """The parts of a report that all components of a class have in common."""

    __slots__ = ("doc", "name", "params")

    def __init__(self, cls: type[Component]) -> None:
        self.name = f"{cls.__module__}:{cls.__qualname__}"
        doc = (cls.__doc__ or "").strip()
        self.doc = doc.splitlines()[0] if doc else ""
        self.params = {name: _described(spec, True) for name, spec in declarations(cls).parameters.items()}


def system_profile(kernel: Microkernel) -> SystemProfile:
    """The profile of the whole system at this moment."""
    components = kernel.components.items()
    return profile_with(
        kernel,
        {name: component_report(component) for name, component in components if visible(kernel, component)},
        {name: connector_report(connector) for name, connector in kernel.connectors.items()},
        {name: service_report(connector) for name, connector in kernel.service_connectors.items()},
    )


def profile_with(
    kernel: Microkernel,
    components: dict[str, ComponentReport],
    connectors: dict[str, ConnectorReport],
    service_connectors: dict[str, ServiceConnectorReport],
) -> SystemProfile:
    """The profile of this moment with reports that are at hand."""
    clock, monitor = kernel.clock, kernel.attached(DeadlineMonitor)
    return SystemProfile(
        kernel.name,
        kernel.bus.sequence,
        kernel.state,
        ClockReport(
            type(clock).__name__,
            clock.time_ns(),
            clock.monotonic_ns(),
            clock.monotonic_ns() - kernel.opened_ns,
            0.0 if isinstance(clock, SimulatedClock) else clock.speed,
        ),
        _versions(),
        MappingProxyType(components),
        MappingProxyType(connectors),
        MappingProxyType({name: context_report(context) for name, context in kernel.contexts.items()}),
        MappingProxyType({} if monitor is None else {str(which): one for which, one in monitor.gc_pauses.items()}),
        MappingProxyType(service_connectors),
        reports(kernel.services),
        lasting=kernel.registry.lasting,
        assembled=kernel.registry.assembled,
    )


def visible(kernel: Microkernel, component: Component) -> bool:
    """Whether a component is in the system: not while its `on_initialize` runs, which may still fail."""
    return not kernel.registry.is_arriving(component)


def component_report(component: Component) -> ComponentReport:
    """The report of a component at this moment."""
    kind = _kind_of(type(component))
    error = standing_error(component)
    params, here = component.params, cell(component)
    ports, state = here.ports, here.configuration
    return ComponentReport(
        kind.name,
        kind.doc,
        special_reports.exported_ports(ports)
        if here.stands_for is not None
        else _frozen({n: p.profile for n, p in ports.items()}),
        _frozen({name: ParameterReport(value, *_rest(kind, params, name)) for name, value in state.values.items()}),
        ConfigurationReport(state.active, state.sets),
        _frozen({context: state.value for context, state in component.states.items()}),
        None if error is None else format_error(error),
        () if here.log is None else here.log.last_lines,
        special_reports.calls(ports),
        thread_writes=special_reports.thread_writes(ports),
        overdue=overdue_hooks(component),
        **{field: report for one in kinds_of(component) for field, report in one.reports(component).items()},
    )


def declared_params(cls: type[Component]) -> dict[str, ParameterReport]:
    """The parameters that a class declares, with their defaults as values."""
    return {name: ParameterReport(rest[0], *rest) for name, rest in _kind_of(cls).params.items()}


def connector_report(connector: Connector) -> ConnectorReport:
    """The report of a connector at this moment."""
    return ConnectorReport(connector.out.path, connector.in_.path, connector.profile, connector.statistics)


def service_report(connector: ServiceConnector) -> ServiceConnectorReport:
    """The report of a connector of service ports at this moment."""
    return special_reports.service_connector(connector)


def context_report(context: Context) -> ContextReport:
    """The report of a context at this moment."""
    members = tuple(member.component.name for member in context.runner.members)
    return ContextReport(context.kind, context.rate, members, context.statistics)


def _kind_of(cls: type[Component]) -> _Kind:
    kind = _KNOWN.get(cls)
    if kind is None:
        kind = _KNOWN[cls] = _Kind(cls)
    return kind


def _rest(kind: _Kind, params: Mapping[str, Any], name: str) -> tuple[Any, ...]:
    return kind.params.get(name) or _described(params[name].spec, False)


def _described(spec: ParameterSpec, declared: bool) -> tuple[Any, ...]:
    """All fields of a ParameterReport but the value."""
    limits = spec.constraint
    words = spec.unit, spec.doc, spec.widget, str(limits)
    elements = None if limits.elements is None else tuple(Limits(*_bounds(one)) for one in limits.elements)
    keys = None if limits.keys is None else _frozen({key: Limits(*_bounds(one)) for key, one in limits.keys.items()})
    return (spec.default, spec.type_text, *words, *_bounds(limits), declared, spec.names_file, elements, keys)


def _bounds(constraint: Constraint) -> Iterator[Any]:
    return (getattr(constraint, name) for name in _BOUNDS)


def _versions() -> Mapping[str, str]:
    ours = sys.modules["aiorts"].__version__
    return MappingProxyType(
        {"aiorts": ours, "python": platform.python_version(), "implementation": platform.python_implementation()}
    )
