"""Who is in an execution context, in order of execution, and what of their ports follows from it.

Each member is found through its component, which is in few contexts, never by walking a context that may have ten
thousand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.errors import StateError
from aiorts.kernel.member import is_open
from aiorts.kernel.ports import InPort

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.member import Member
    from aiorts.kernel.ports import Port
    from aiorts.model.lifecycle import LifeCycleState

__all__ = ("Members",)


class Members:
    """The part of a context that knows its members."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._members: list[Member] = []
        self._updating = 0
        """How many members have an `on_state_update`."""

    @property
    def members(self) -> tuple[Component, ...]:
        """The components in this context, in order of execution."""
        return tuple(member.component for member in self._members)

    def state(self, component: Component) -> LifeCycleState:
        """The life-cycle state of a member; StateError when the component is not one."""
        return self._member(component).state

    def _attach(self, member: Member) -> None:
        component = member.component
        self._members.append(member)
        component._rt_members.append(member)
        component._rt_host.retired = False
        if len(component._rt_members) > 1:
            component._rt_gate.share(component._rt_members)
        self._updating += member.updates
        for port in component.ports.values():
            self._port_added(member, port)
        self._set_ports_open(member)

    def _detach(self, member: Member) -> None:
        member.left = True
        component = member.component
        if member in component._rt_members:
            component._rt_members.remove(member)
            # Of ten thousand the last goes first when the context ends.
            if self._members[-1] is member:
                self._members.pop()
            else:
                self._members.remove(member)
            self._updating -= member.updates
        component._rt_host.retired = not component._rt_members
        for port in component.ports.values():
            self._port_removed(member, port)
        self._set_ports_open(member)

    def _port_added(self, member: Member, port: Port[object]) -> None:
        """A member has another port; it is open when the component is."""
        if isinstance(port, InPort):
            member.in_ports.append(port)
            takes = is_open(member.component)
            if port._open is not takes:
                port._set_open(takes)

    def _port_removed(self, member: Member, port: Port[object]) -> None:
        """A member lost a port, or the port lost its member."""
        if isinstance(port, InPort) and port in member.in_ports:
            member.in_ports.remove(port)

    def _set_ports_open(self, member: Member) -> None:
        """In-ports take samples while the component is active somewhere, or is in no context at all."""
        takes = is_open(member.component)
        for port in member.component.ports.values():
            if isinstance(port, InPort) and port._open is not takes:
                port._set_open(takes)

    def _member(self, component: Component) -> Member:
        for member in component._rt_members:
            if member.context is self:
                return member
        raise StateError(f"{component.name}: is not in {self.name or 'this context'}")
