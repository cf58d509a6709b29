"""The connectors of one kernel, by name: all of a call come into being or none, and each ends once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

from aiorts.errors import WiringError
from aiorts.kernel import wiring
from aiorts.kernel.bus import Connected, Disconnected
from aiorts.kernel.service_port import ServiceConnector, is_service
from aiorts.kernel.service_visit import Calls
from aiorts.model.numbering import Numbering
from aiorts.model.profile import ConnectorProfile

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.service_profile import ServiceConnectorProfile

__all__ = ("Connections",)


class Connections:
    """Who is connected with whom."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self.connectors: dict[str, Connector] = {}
        self.service_connectors: dict[str, ServiceConnector] = {}
        self.calls = Calls()
        self._numbering = Numbering(self._taken)

    def make(self, ports: Sequence[Any], options: Mapping[str, Any]) -> list[Any]:
        """Connect every out-port with every in-port, or service ports with one another.

        Raises:
            WiringError: says which ports or options do not go together; nothing was connected.
        """
        if any(map(is_service, ports)):
            return self._make_services(ports, options)
        plans = wiring.plan(self._kernel, ports, options)
        made = []
        for out, in_, profile in plans:
            name = self._free_name(profile.name, f"{out.path}-{in_.path}", len(plans))
            connector = wiring.wire(self._kernel, out, in_, replace(profile, name=name))
            self.connectors[name] = connector
            made.append(connector)
        for connector in made:
            self._kernel.bus.publish(Connected(connector.profile))
            if self._kernel.bus.samples_wanted:
                self._kernel.listening.made(connector)
        return made

    def _make_services(self, ports: Sequence[Any], options: Mapping[str, Any]) -> list[Any]:
        from aiorts.kernel import service_wiring  # late: most systems have no services

        plans = service_wiring.connect(self._kernel, ports, options)
        made = []
        for path, plan in plans:
            name = self._free_name(str(options.get("name") or ""), path, len(plans))
            connector = self.service_connectors[name] = plan.make(name)
            made.append(connector)
        for connector in made:
            self._kernel.bus.publish(Connected(connector.profile))
        return made

    def _taken(self, name: str) -> bool:
        return name in self.connectors or name in self.service_connectors

    def _those(self, connector: Connector | ServiceConnector) -> Mapping[str, Any]:
        return self.service_connectors if isinstance(connector, ServiceConnector) else self.connectors

    def renew(self, profile: ConnectorProfile | ServiceConnectorProfile) -> Connector | ServiceConnector:
        """Connect the first two ports of a profile, the writer's first, as they were connected before.

        Raises:
            WiringError: there is no such port any more, or they do not go together any more.
        """
        if not isinstance(profile, ConnectorProfile):
            return self._renew_services(profile)
        out, in_ = (self._kernel._roster.find(path) for path in profile.ports[:2])
        ((writer, reader, _),) = wiring.plan(self._kernel, cast("Any", (out, in_)), {"allow_duplicate": True})
        name = profile.name if not self._taken(profile.name) else self._free_name("", profile.name, 1)
        connector = wiring.wire(self._kernel, writer, reader, replace(profile, name=name))
        self.connectors[name] = connector
        self._kernel.bus.publish(Connected(connector.profile))
        return connector

    def _renew_services(self, profile: ServiceConnectorProfile) -> ServiceConnector:
        from aiorts.kernel import service_wiring

        plan = service_wiring.renewed(self._kernel, profile)
        name = profile.name if not self._taken(profile.name) else self._free_name("", profile.name, 1)
        connector = self.service_connectors[name] = plan.make(name)
        self._kernel.bus.publish(Connected(connector.profile))
        return connector

    def _free_name(self, given: str, path: str, count: int) -> str:
        base = given or path
        if given and count == 1 and self._taken(given):
            raise WiringError(f"{path}: there is a connector named {given!r}; choose another")
        return self._numbering.lowest(f"{base}-", 2) if self._taken(base) else base

    def check_mine(self, connector: Connector | ServiceConnector) -> None:
        """Raise WiringError unless it is one of this kernel's, closed or not."""
        if not connector.closed and self._those(connector).get(connector.name) is not connector:
            raise WiringError(f"{connector.name}: is not a connector of {self._kernel.name}")

    def end(self, connector: Connector | ServiceConnector) -> None:
        """Take it out of force; idempotent."""
        if connector.closed:
            return
        if isinstance(connector, ServiceConnector):
            connector._close()
            self.service_connectors.pop(connector.name, None)
        else:
            wiring.unwire(connector)
            self.connectors.pop(connector.name, None)
        self._numbering.free(connector.name)
        self._kernel.bus.publish(Disconnected(connector.profile))

    def end_all(self) -> None:
        """In reverse order."""
        for services in reversed(tuple(self.service_connectors.values())):
            self.end(services)
        for connector in reversed(tuple(self.connectors.values())):
            self.end(connector)
