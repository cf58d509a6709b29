"""What a profile says of what only some components have: services, a state machine, modes, members.

Nothing of it is imported for a component that has none of it: what is not loaded cannot be there.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.service_port import ServicePort
from aiorts.model.system_profile import (
    BindingReport,
    CompositeReport,
    MachineReport,
    ModeReport,
    ServiceConnectorReport,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.component import Component
    from aiorts.kernel.ports import Port
    from aiorts.kernel.service_port import ServiceConnector
    from aiorts.model.profile import PortProfile
    from aiorts.model.service_profile import ServiceStatistics

__all__ = ("calls", "composite", "has_machine", "has_modes", "machine", "modes", "service_connector", "shown_ports")

_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


def has_machine(cls: type[Component]) -> bool:
    """Whether components of this class are state machines."""
    return _derives(cls, "aiorts.kernel.machine", "StateMachineComponent")


def has_modes(cls: type[Component]) -> bool:
    """Whether components of this class have modes."""
    return _derives(cls, "aiorts.kernel.modes", "MultiModeComponent")


def _derives(cls: type[Component], module: str, name: str) -> bool:
    loaded = sys.modules.get(module)
    return loaded is not None and issubclass(cls, getattr(loaded, name, ()))


def calls(ports: Mapping[str, Port[Any]]) -> Mapping[str, ServiceStatistics]:
    """The calls through each interface, by its path in the component."""
    services = [(name, port) for name, port in ports.items() if isinstance(port, ServicePort)]
    if not services:
        return _NOTHING
    return MappingProxyType(
        {
            name if end.instance == port.name else f"{name}.{end.instance}": end.statistics
            for name, port in services
            for end in port.interfaces
        }
    )


def service_connector(connector: ServiceConnector) -> ServiceConnectorReport:
    """Who is bound with whom, and what came of it."""
    bindings = tuple(
        BindingReport(
            link.required.path, link.provided.path, link.required.spec.name, link.tally.statistics, len(link.calls)
        )
        for link in connector._links
    )
    profile = connector.profile
    return ServiceConnectorReport(profile.ports, bindings, profile.strict)


def machine(component: Any) -> MachineReport:
    """What is active, and what it remembers. A thread may run it meanwhile."""
    machine = component.machine
    core, chart = machine._core, machine.chart
    history = {
        chart.nodes[index].name: chart.names(states)
        for index, states in zip(chart.histories, core.history, strict=True)
        if states
    }
    return MachineReport(
        chart.name, core.configuration, MappingProxyType(history), MappingProxyType(machine.timers), core.ignored
    )


def modes(component: Any) -> ModeReport:
    """Which modes there are, and in which it is."""
    return ModeReport(tuple(component.modes), component.mode, component.modes_by_context, component.pending_mode)


def composite(component: Any) -> CompositeReport:
    """What it is made of."""
    return CompositeReport(
        tuple(member.name for member in component.members),
        tuple(part.name for part in component.parts),
        MappingProxyType({name: port.path for name, port in component.ports.items()}),
        component.groups,
        component.order,
        component.errors.value,
        component.own_schedule,
    )


def shown_ports(ports: Mapping[str, Port[Any]]) -> Mapping[str, PortProfile]:
    """Members' ports under the names they are exported as."""
    return MappingProxyType({name: replace(port.profile, name=name) for name, port in ports.items()})
