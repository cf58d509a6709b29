"""What a composite is to the kernel: which components it stands for, in which order, which of their ports it shows.

It is never run itself and adds no hop: what it stands for is laid out when something changes, not in a cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from aiorts.errors import StateError, WiringError
from aiorts.kernel import comeback, composition_check
from aiorts.kernel.bus import Event, PortAdded, PortRemoved, StateChanged
from aiorts.kernel.component import Component
from aiorts.model.composition import ErrorPolicy, Export, derived, flow_order, shown
from aiorts.model.lifecycle import LifeCycleState

if TYPE_CHECKING:
    from typing import Any

    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context
    from aiorts.kernel.member import Member
    from aiorts.kernel.ports import Port

__all__ = ("Composed", "CompositeChanged")


@dataclass(frozen=True, slots=True)
class CompositeChanged(Event):
    """A composite has other members now, or another order."""

    composite: str
    members: tuple[str, ...]
    """In order of execution."""
    added: tuple[str, ...]
    removed: tuple[str, ...]
    disconnected: tuple[str, ...]
    """Connectors that ended with the ports that were withdrawn."""


class Composed(Component):
    """The part of a composite that the kernel uses; `Composite` is what users see."""

    _rt_composes: ClassVar[bool] = True

    order: str
    errors: ErrorPolicy
    own_schedule: bool

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._rt_given: tuple[Component | str, ...] = ()
        self._rt_groups_given: str | Sequence[Sequence[str]] = ()
        self._rt_rules: tuple[Export, ...] = ()
        self._rt_direct: tuple[Component, ...] = ()
        self._rt_groups: tuple[tuple[str, ...], ...] = ()
        """Names of members: the groups that run side by side."""
        self._rt_laid_out: Sequence[Component] = ()
        """The members in order of execution, as it was laid out last."""
        self._rt_context: Context | None = None
        """The context it was started in last; a member's is that of the outermost composite it runs with."""
        self._rt_known: dict[Port[Any], frozenset[Connector]] = {}
        """The connectors a port had already when it was exported."""
        self._rt_state: LifeCycleState | None = None
        """As it was told last."""

    @property
    def parts(self) -> tuple[Component, ...]:
        """What runs with it, in order of execution: its members, those of composites in it in their place."""
        return self._rt_line(self._rt_laid_out)

    @property
    def _rt_running_context(self) -> Context | None:
        context = self._rt_root._rt_context
        return context if context is not None and context._driver is not None else None

    @property
    def _rt_holds(self) -> bool:
        """Whether its members run with it, or are about to; else they may run where they like."""
        context = self._rt_root._rt_context
        return context is not None and (context._driver is not None or not context._stopping)

    @property
    def _rt_root(self) -> Composed:
        """The outermost composite it is run with: itself, where it has a schedule of its own."""
        root = self
        while root._rt_composite is not None and not root.own_schedule:
            root = root._rt_composite
        return root

    def _rt_unfold(self) -> tuple[Component, ...]:
        return self.parts

    def _rt_leaves(self) -> tuple[Component, ...]:
        return tuple(leaf for member in self._rt_direct for leaf in member._rt_leaves())

    def _rt_line(self, members: Iterable[Component]) -> tuple[Component, ...]:
        """What these members run, one after the other."""
        apart = self._rt_runs_apart
        return tuple(part for member in members if not apart(member) for part in member._rt_unfold())

    def _rt_runs_apart(self, member: Component) -> bool:
        return isinstance(member, Composed) and member.own_schedule

    def _rt_state_in(self, context: Context) -> LifeCycleState | None:
        """What follows from the states of its members; of a composite among them its own counts."""
        states: list[LifeCycleState | None] = []
        for one in self._rt_laid_out:
            if not isinstance(one, Composed):
                states += [member.state for member in one._rt_members if member.context is context]
            elif not one.own_schedule:
                states.append(one._rt_state_in(context))
        return derived((state for state in states if state is not None), self.errors)

    def _rt_lay_out(self) -> None:
        """Lay out the order anew, of composites in it, too."""
        for member in self._rt_direct:
            if isinstance(member, Composed):
                member._rt_lay_out()
        self._rt_laid_out = self._rt_ordered()

    def _rt_enter(self, context: Context | None) -> None:
        """It is about to run in this context, or in none."""
        self._rt_context = context
        self._rt_reset_state(None if context is None else LifeCycleState.INACTIVE)

    def _rt_reset_state(self, state: LifeCycleState | None) -> None:
        self._rt_state = state
        for member in self._rt_direct:
            if isinstance(member, Composed) and not member.own_schedule:
                member._rt_reset_state(state)

    def _rt_ordered(
        self,
        members: Sequence[Component] | None = None,
        order: str | None = None,
        groups: tuple[tuple[str, ...], ...] | None = None,
    ) -> list[Component]:
        """The members in order of execution."""
        direct = self._rt_direct if members is None else members
        named = {member.name: member for member in direct}
        grouped = self._rt_groups if groups is None else groups
        if grouped:
            direct = [named[name] for group in grouped for name in group if name in named]
        if (order or self.order) == "stated":
            return list(direct)
        belongs = {part.name: member.name for member in direct for part in member._rt_leaves()}
        edges = [
            (belongs[part.name], belongs.get(connector.in_._bound().name, ""))
            for member in direct
            for part in member._rt_leaves()
            for port in part.ports.values()
            if port.direction == "out"
            for connector in port.connectors
        ]
        lines = [flow_order([name for name in group if name in named], edges) for group in grouped or (tuple(named),)]
        return [named[name] for line in lines for name in line]

    def _rt_sections(self) -> tuple[tuple[tuple[Component, ...], ...], ...]:
        """What of it runs side by side; composites within a group run there, one member after the other."""
        if self._rt_groups:
            named = {member.name: member for member in self._rt_direct}
            place = {part: index for index, part in enumerate(self.parts)}
            lines = [self._rt_line(named[name] for name in group if name in named) for group in self._rt_groups]
            return (tuple(tuple(sorted(line, key=lambda part: place[part])) for line in lines if line),)
        inner = [member for member in self._rt_laid_out if isinstance(member, Composed) and not member.own_schedule]
        return tuple(section for member in inner for section in member._rt_sections())

    def _rt_check_context(self, component: Component, context: Context) -> None:
        """A member runs where its composite runs and nowhere else."""
        if self._rt_holds and self._rt_root._rt_context is not context:
            raise StateError(
                f"{component.name}: is a member of {self.name}, which says where it runs; "
                f"start {self._rt_root.name}, or {self.name}.remove_members first"
            )

    def _rt_exports(self, members: Sequence[Component], rules: Sequence[Any] | None = None) -> dict[str, Port[Any]]:
        """What it would show with these members. WiringError: a name twice, or a port named that is not there."""
        every = {(member.name, name): port for member in members for name, port in member.ports.items()}
        found = shown(self._rt_rules if rules is None else rules, every, self.name)
        return {name: every[place] for name, place in found.items()}

    def _rt_take(self, members: Sequence[Component], inside: frozenset[Port[Any]]) -> tuple[Connector, ...]:
        """Have these members from now on; the connectors that ended with ports withdrawn."""
        self._rt_direct = tuple(members)
        self._rt_root._rt_lay_out()
        return self._rt_show(self._rt_exports(self._rt_direct), inside)

    def _rt_told(
        self, added: Sequence[Component], removed: Sequence[Component], ended: Sequence[Connector] = ()
    ) -> None:
        names = [tuple(one.name for one in those) for those in (self._rt_laid_out, added, removed, ended)]
        self.kernel.bus.publish(CompositeChanged(self.name, *names))

    def _rt_show(self, ports: Mapping[str, Port[Any]], inside: frozenset[Port[Any]]) -> tuple[Connector, ...]:
        """Show these ports and no others; a connector between two ports of `inside` is the members' own affair."""
        kernel = self.kernel
        before, showing = dict(self._rt_host.ports), self._rt_host.ports
        showing.clear()
        showing.update(ports)
        ended: list[Connector] = []
        still = set(ports.values())
        for name, port in before.items():
            if ports.get(name) is port:
                continue
            if port not in still:
                known = self._rt_known.pop(port, frozenset())
                for connector in port.connectors:
                    if connector not in known and not (connector.out in inside and connector.in_ in inside):
                        kernel._connections.end(connector)
                        ended.append(connector)
            kernel.bus.publish(PortRemoved(self.name, replace(port.profile, name=name)))
        for name, port in ports.items():
            if before.get(name) is not port:
                self._rt_known.setdefault(port, frozenset(port.connectors))
                kernel.bus.publish(PortAdded(self.name, replace(port.profile, name=name)))
        for connector in ended:
            counts = connector.statistics
            self.log.warning(
                "disconnected %s: its port is exported no more; %d written, %d delivered, %d dropped",
                connector.name,
                counts.written,
                counts.delivered,
                sum(counts.dropped.values()),
            )
        outer = self._rt_composite
        if outer is not None and before != dict(ports):
            outer._rt_ports_changed()
        return tuple(ended)

    def _rt_check_ports(self, ports: Mapping[str, Port[Any]] | None = None) -> None:
        """Raise WiringError when what the members have now (or these ports) cannot be shown, here or further out."""
        ports = self._rt_exports(self._rt_direct) if ports is None else ports
        outer = self._rt_composite
        if outer is not None:
            showing = self._rt_host.ports
            self._rt_host.ports = dict(ports)
            try:
                outer._rt_check_ports()
            finally:
                self._rt_host.ports = showing

    def _rt_ports_changed(self) -> None:
        """A member has other ports."""
        inside = frozenset(port for part in self._rt_leaves() for port in part.ports.values())
        self._rt_show(self._rt_exports(self._rt_direct), inside)

    def _rt_check_new_port(self, member: Component, port: Port[Any]) -> None:
        """A member has got another port: take it away again when it cannot be shown, and raise WiringError."""
        try:
            self._rt_check_ports()
        except WiringError:
            del member._rt_host.ports[port.name]
            raise

    async def _rt_come(self) -> None:
        """It is being added: its members come with it, or nobody."""
        kernel = self.kernel
        brought: list[Component] = []
        try:
            for member in self._rt_given:
                if isinstance(member, Component) and member._rt_kernel is None:
                    await kernel.add(member)
                    brought.append(member)
            members = composition_check.resolved(kernel, self, self._rt_given)
            composition_check.check(self, members, self._rt_rules)
            self._rt_groups = composition_check.grouped(self, members, self._rt_groups_given)
        except BaseException:
            for member in reversed(brought):
                await kernel.remove(member)
            raise
        for member in members:
            member._rt_composite = self
        self._rt_direct = members
        self._rt_lay_out()
        self._rt_host.ports.update(self._rt_exports(members))
        self._rt_known = {port: frozenset(port.connectors) for port in self._rt_host.ports.values()}

    def _rt_gone(self) -> None:
        """It belongs to no kernel any more: its members are on their own."""
        for member in self._rt_direct:
            member._rt_composite = None
        self._rt_direct = self._rt_laid_out = ()
        self._rt_host.ports.clear()

    def _rt_drop(self, member: Component) -> None:
        """A member is gone for good; its connectors ended with it."""
        member._rt_composite = None
        self._rt_take([other for other in self._rt_direct if other is not member], frozenset())
        self._rt_told((), (member,))

    def _rt_member_entered(self, member: Member) -> None:
        """A member has another state; in the thread of its context."""
        if member.state is not LifeCycleState.INACTIVE:
            member.stopped_for = frozenset()
        context = self._rt_running_context
        if context is None or context is not member.context or member.component not in self.parts:
            return  # one that is on trial: what it does is told when it has joined
        failed = member.state is LifeCycleState.ERROR
        composite: Composed | None = self
        while failed and composite is not None:
            if composite.errors is ErrorPolicy.STOP:
                comeback.stop_the_others(composite, context, member.component.name)
            failed = composite.state is LifeCycleState.ERROR
            composite = None if composite.own_schedule else composite._rt_composite
        self._rt_tell_state()

    def _rt_tell_state(self) -> None:
        """Publish what state it is in, unless that is known."""
        context, state = self._rt_running_context, self.state
        before, self._rt_state = self._rt_state, state
        if context is not None and state is not None and before not in (None, state):
            context._publish(StateChanged(self.name, context.name, before, state))
        if self._rt_composite is not None and not self.own_schedule:
            self._rt_composite._rt_tell_state()
