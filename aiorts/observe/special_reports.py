"""The parts of a profile on services, on writes of foreign threads, and on ports that a group shows for its members."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports import OutPort
from aiorts.model.profile import NO_THREAD_WRITES, ThreadWriteStatistics
from aiorts.observe.profiles import BindingReport, ServiceConnectorReport
from aiorts.services import ServicePort

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.ports import Port
    from aiorts.model.profile import PortProfile
    from aiorts.model.service_profile import ServiceStatistics
    from aiorts.services import ServiceConnector

_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


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


def thread_writes(ports: Mapping[str, Port[Any]]) -> Mapping[str, ThreadWriteStatistics]:
    """The counts of each out-port at which a foreign thread wrote."""
    found = {name: port.thread_writes for name, port in ports.items() if isinstance(port, OutPort)}
    return MappingProxyType({name: counts for name, counts in found.items() if counts is not NO_THREAD_WRITES})


def service_connector(connector: ServiceConnector) -> ServiceConnectorReport:
    """The report of a service connector: its bindings, with the statistics of each."""
    bindings = tuple(
        BindingReport(
            link.required.path, link.provided.path, link.required.spec.name, link.tally.statistics, len(link.calls)
        )
        for link in connector.links
    )
    profile = connector.profile
    return ServiceConnectorReport(profile.ports, bindings, profile.strict)


def exported_ports(ports: Mapping[str, Port[Any]]) -> Mapping[str, PortProfile]:
    """Members' ports under the names they are exported as."""
    return MappingProxyType({name: replace(port.profile, name=name) for name, port in ports.items()})
