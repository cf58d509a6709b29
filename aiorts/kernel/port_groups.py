"""Ports that exist while the parameters say so: what is wanted is compared with what there is, then made so at once.

A port that stays is not touched: it keeps its connectors and its unread samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.bus import PortAdded, PortRemoved
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.port import host_of, wake_waiter
from aiorts.model.names import check_name

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide


class PortPlan:
    """A change of a component's group of ports; until `put` nothing is changed, until `settle` all can be undone.

    On the kernel's loop, while no hook of the component runs.
    """

    __slots__ = ("_added", "_before", "_component", "_group", "_group_before", "_removed", "_reworded")

    def __init__(self, component: ComponentSide, group: dict[str, Port[Any]], wanted: Mapping[str, Port[Any]]) -> None:
        old = _standing(component)
        self._component = component
        self._group, self._group_before = group, old
        self._reworded = [
            (group[name], declared)
            for name, declared in wanted.items()
            if (group[name].doc, group[name].max_connectors) != (declared.doc, declared.max_connectors)
        ]
        self._added = [port for name, port in group.items() if old.get(name) is not port]
        self._removed = [port for name, port in old.items() if group.get(name) is not port]
        self._before = dict(cell(component).ports)

    @property
    def idle(self) -> bool:
        """Whether everything stays as it is."""
        same_order = list(self._group) == list(self._group_before)
        return same_order and not (self._added or self._removed or self._reworded)

    def put(self) -> None:
        """Add new ports and take out those that go; the connectors of the latter stay until `settle`."""
        component = self._component
        fixed = {name: port for name, port in self._before.items() if name not in self._group_before}
        self._set(self._group, {**fixed, **self._group})
        for port in self._added:
            for member in cell(component).members:
                member.port_added(port)

    def undo(self) -> None:
        """Restore the ports of before `put`."""
        for port in self._added:
            for member in cell(self._component).members:
                member.port_removed(port)
        self._set(self._group_before, self._before)

    def settle(self) -> None:
        """Make the change lasting: the ports that went lose their connectors, and events tell of it."""
        component = self._component
        for live, declared in self._reworded:
            live.doc, live.max_connectors = declared.doc, declared.max_connectors
        kernel = cell(component).kernel
        for port in self._removed:
            if kernel is not None:
                for connector in port.connectors:
                    kernel.connections.end(connector)
            for member in cell(component).members:
                member.port_removed(port)
            if isinstance(port, InPort):
                wake_waiter(port)
        if kernel is None:
            return
        for port in self._removed:
            kernel.bus.publish(PortRemoved(component.name, port.profile))
        for port in self._added:
            kernel.bus.publish(PortAdded(component.name, port.profile))

    def _set(self, group: Mapping[str, Port[Any]], ports: Mapping[str, Port[Any]]) -> None:
        cell(self._component).port_group = group
        # Changed in place: other code refers to this dictionary.
        live = cell(self._component).ports
        live.clear()
        live.update(ports)


def plan_ports(component: ComponentSide, wanted: Mapping[str, Any]) -> PortPlan:
    """The change that makes the group as `wanted`; a port that stays is recognised by name and declaration.

    Raises:
        ConfigurationError: a port cannot be made.
    """
    name = component.name
    old = _standing(component)
    group: dict[str, Port[Any]] = {}
    for port_name, declared in wanted.items():
        try:
            check_name(port_name, "port")
            if not isinstance(declared, InPort | OutPort) or host_of(declared) is not None:
                raise ConfigurationError(f"expected a new InPort(...) or OutPort(...), got {declared!r:.80}")
            if port_name in cell(component).ports and port_name not in old:
                raise ConfigurationError("there is a port of that name already")
            standing = old.get(port_name)
            stays = standing is not None and _alike(standing, declared)
            group[port_name] = standing if stays and standing is not None else declared.bind(cell(component), port_name)
        except AiortsError as error:
            raise ConfigurationError(f"{name}.{port_name!s:.80}: the port cannot be made: {error}") from error
    return PortPlan(component, group, wanted)


def _standing(component: ComponentSide) -> dict[str, Port[Any]]:
    """The ports of the group, without those that were removed in another way."""
    ports = cell(component).ports
    return {name: port for name, port in cell(component).port_group.items() if ports.get(name) is port}


def _alike(one: Port[Any], other: Port[Any]) -> bool:
    """Whether a live port is what this declaration asks for; documentation and limits can be changed on a live one."""
    return (
        one.direction == other.direction
        and one.type is other.type
        and one.unit == other.unit
        and one.shape == other.shape
        and getattr(one, "stamp", None) == getattr(other, "stamp", None)
    )
