"""The connectors of one kernel, by name: all of a call come into being or none, and each ends once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from aiorts.errors import WiringError
from aiorts.kernel import wiring
from aiorts.kernel.bus import Connected, Disconnected
from aiorts.model.numbering import Numbering

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.ports import Port

__all__ = ("Connections",)


class Connections:
    """Who is connected with whom."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self.connectors: dict[str, Connector] = {}
        self._numbering = Numbering(self.connectors.__contains__)

    def make(self, ports: Sequence[Port[Any]], options: Mapping[str, Any]) -> list[Connector]:
        """Connect every out-port with every in-port.

        Raises:
            WiringError: says which ports or options do not go together; nothing was connected.
        """
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

    def _free_name(self, given: str, path: str, count: int) -> str:
        base = given or path
        if given and count == 1 and given in self.connectors:
            raise WiringError(f"{path}: there is a connector named {given!r}; choose another")
        return self._numbering.lowest(f"{base}-", 2) if base in self.connectors else base

    def check_mine(self, connector: Connector) -> None:
        """Raise WiringError unless it is one of this kernel's, closed or not."""
        if not connector.closed and self.connectors.get(connector.name) is not connector:
            raise WiringError(f"{connector.name}: is not a connector of {self._kernel.name}")

    def end(self, connector: Connector) -> None:
        """Take it out of force; idempotent."""
        if connector.closed:
            return
        wiring.unwire(connector)
        self.connectors.pop(connector.name, None)
        self._numbering.free(connector.name)
        self._kernel.bus.publish(Disconnected(connector.profile))

    def end_all(self) -> None:
        """In reverse order."""
        for connector in reversed(tuple(self.connectors.values())):
            self.end(connector)
