"""The service with the connectors of tools: clients that read samples of a system, or write to it.

These connectors are no part of the system: they take no place at a port, and they are not among its connectors. The
profile reports them under `services`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.service import KernelService

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import InPort, OutPort
    from aiorts.kernel.ports.connector import Connector


class Tools(KernelService):
    """The service that makes the connectors of tools, and reports each: its client, its port, and its ledger."""

    name = "tool"

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._clients: dict[Connector, str] = {}

    def tap(self, client: str, out: OutPort[Any], take: Callable[[InPort[Any]], object], *, length: int) -> Connector:
        """Let a client read the samples of an out-port: see `Connections.tap`."""
        return self._keep(client, self.kernel.connections.tap(self, out, take, length=length))

    def inject(self, client: str, in_: InPort[Any], options: Mapping[str, Any]) -> Connector:
        """Let a client write to an in-port: see `Connections.inject`."""
        return self._keep(client, self.kernel.connections.inject(self, in_, options))

    def _keep(self, client: str, made: Connector) -> Connector:
        self._clients = {one: who for one, who in self._clients.items() if not one.closed} | {made: client}
        return made

    def report(self) -> Mapping[str, Any]:
        found = tuple(_report(client, one) for one, client in self._clients.items() if not one.closed)
        return {"connectors": found} if found else {}


def _report(client: str, connector: Connector) -> dict[str, Any]:
    written, buffered, dropped = transport_of(connector).glance()
    reads, profile = connector.in_.is_tap, connector.profile
    return {
        "client": client,
        "port": (connector.out if reads else connector.in_).path,
        "reads": reads,
        "length": profile.length,
        "full": profile.full.value,
        "written": written,
        "delivered": written - buffered - sum(dropped.values()),
        "buffered": buffered,
        "dropped": dict(dropped),
    }
