"""Takes the profile of a system, or of a part of it: on the loop, at one moment, without disturbing what it looks at.

No sample is taken, no lock is waited for longer than a ledger takes, and what cannot have changed since the last
profile is not described again.
"""

from __future__ import annotations

import platform
import sys
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

from aiorts.clock import SimulatedClock
from aiorts.errors import said
from aiorts.kernel import special_reports
from aiorts.model.configuration import ParameterSpec
from aiorts.model.system_profile import (
    ClockReport,
    ComponentReport,
    ConfigurationReport,
    ConnectorReport,
    ContextReport,
    ParameterReport,
    ServiceConnectorReport,
    SystemProfile,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.component import Component
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.service_port import ServiceConnector

__all__ = (
    "component_report",
    "connector_report",
    "context_report",
    "profile_with",
    "service_report",
    "system_profile",
    "visible",
)

_BOUNDS: Final = ("ge", "gt", "le", "lt", "choices", "pattern")
_frozen: Final = MappingProxyType
_KNOWN: Final[WeakKeyDictionary[type, _Kind]] = WeakKeyDictionary()


class _Kind:
    """What all components of a class have in common."""

    __slots__ = ("composes", "doc", "has_machine", "has_modes", "name", "params")

    def __init__(self, cls: type[Component]) -> None:
        self.name = f"{cls.__module__}:{cls.__qualname__}"
        doc = (cls.__doc__ or "").strip()
        self.doc = doc.splitlines()[0] if doc else ""
        self.params = {name: _described(spec, True) for name, spec in cls._rt_parameter_specs.items()}
        self.composes = cls._rt_composes
        self.has_machine = special_reports.has_machine(cls)
        self.has_modes = special_reports.has_modes(cls)


def system_profile(kernel: Kernel) -> SystemProfile:
    """All there is at this moment."""
    components = kernel.components.items()
    return profile_with(
        kernel,
        {name: component_report(component) for name, component in components if visible(kernel, component)},
        {name: connector_report(connector) for name, connector in kernel.connectors.items()},
        {name: service_report(connector) for name, connector in kernel.service_connectors.items()},
    )


def profile_with(
    kernel: Kernel,
    components: dict[str, ComponentReport],
    connectors: dict[str, ConnectorReport],
    service_connectors: dict[str, ServiceConnectorReport],
) -> SystemProfile:
    """The profile of this moment with reports that are at hand."""
    clock = kernel.clock
    return SystemProfile(
        kernel.name,
        kernel.bus.sequence,
        "closed" if kernel._ended else "closing" if kernel._closed else "open",
        ClockReport(
            type(clock).__name__,
            clock.time_ns(),
            clock.monotonic_ns(),
            clock.monotonic_ns() - kernel._opened_ns,
            0.0 if isinstance(clock, SimulatedClock) else clock.speed,
        ),
        _versions(),
        MappingProxyType(components),
        MappingProxyType(connectors),
        MappingProxyType({name: context_report(context) for name, context in kernel.contexts.items()}),
        MappingProxyType({str(generation): pauses for generation, pauses in kernel.gc_pauses.items()}),
        MappingProxyType(service_connectors),
    )


def visible(kernel: Kernel, component: Component) -> bool:
    """Whether it is in the system: not while its `on_initialize` runs, which may still fail."""
    return component not in kernel._roster._arriving


def component_report(component: Component) -> ComponentReport:
    """A component at this moment."""
    kind = _KNOWN.get(type(component))
    if kind is None:
        kind = _KNOWN[type(component)] = _Kind(type(component))
    error = component.last_error
    params, ports = component.params, component._rt_host.ports
    state = params._state
    return ComponentReport(
        kind.name,
        kind.doc,
        special_reports.shown_ports(ports) if kind.composes else _frozen({n: p.profile for n, p in ports.items()}),
        _frozen({name: ParameterReport(value, *_rest(kind, params, name)) for name, value in state.values.items()}),
        ConfigurationReport(state.active, state.sets),
        _frozen({context: state.value for context, state in component.states.items()}),
        None if error is None else said(error),
        () if component._rt_log is None else component._rt_log.last_lines,
        special_reports.calls(ports),
        special_reports.machine(component) if kind.has_machine else None,
        special_reports.modes(component) if kind.has_modes else None,
        special_reports.composite(component) if kind.composes else None,
    )


def connector_report(connector: Connector) -> ConnectorReport:
    """A connector at this moment."""
    return ConnectorReport(connector.out.path, connector.in_.path, connector.profile, connector.statistics)


def service_report(connector: ServiceConnector) -> ServiceConnectorReport:
    """A connector of service ports at this moment."""
    return special_reports.service_connector(connector)


def context_report(context: Context) -> ContextReport:
    """A context at this moment."""
    members = tuple(member.component.name for member in context._members)
    return ContextReport(context.kind, context.rate, members, context.statistics)


def _rest(kind: _Kind, params: Mapping[str, Any], name: str) -> tuple[Any, ...]:
    return kind.params.get(name) or _described(params[name].spec, False)


def _described(spec: ParameterSpec, declared: bool) -> tuple[Any, ...]:
    """All fields of a ParameterReport but the value."""
    limits = (getattr(spec.constraint, name) for name in _BOUNDS)
    return (spec.default, spec.type_text, spec.unit, spec.doc, spec.widget, str(spec.constraint), *limits, declared)


def _versions() -> Mapping[str, str]:
    ours = sys.modules["aiorts"].__version__
    return MappingProxyType(
        {"aiorts": ours, "python": platform.python_version(), "implementation": platform.python_implementation()}
    )
