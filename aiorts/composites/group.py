"""The kernel's view of a composite: the components it stands for, their order, and the ports it exports.

A composite never runs itself and adds no hop: its order is laid out when something changes, not in a cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from aiorts.composites import composition_check, membership, parallel, recovery
from aiorts.composites.composition import Export, derived, flow_order, shown
from aiorts.composites.composition_check import group_of, leaves_of, outer_of, parts_of
from aiorts.errors import StateError, WiringError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import Kind
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.loop.bus import Event, PortAdded, PortRemoved, StateChanged
from aiorts.late import dataclass
from aiorts.model.lifecycle import Event as LifeEvent
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.policy import ErrorPolicy

if TYPE_CHECKING:
    from typing import Any

    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports import Port
    from aiorts.kernel.ports.connector import Connector


@dataclass(frozen=True, slots=True)
class CompositeChanged(Event):
    """Published when a composite has other members, or another order."""

    composite: str
    members: tuple[str, ...]
    """In order of execution."""
    added: tuple[str, ...]
    removed: tuple[str, ...]
    disconnected: tuple[str, ...]
    """Connectors that ended with the ports that were withdrawn."""


class CompositeGroup:
    """The kernel's side of a composite; `Composite` is the user's side.

    `own_schedule`, `order` and `errors` are the composite's arguments.
    """

    def __init__(self, component: Component, order: str, errors: ErrorPolicy, *, own_schedule: bool) -> None:
        self.component = component
        """The composite."""
        self.order = order
        self.errors = errors
        self.own_schedule = own_schedule
        self.given: tuple[Component | str, ...] = ()
        self.brought: dict[Component, str] = {}
        """Members that stand for components of other kernels, with their paths; they live as long as the composite."""
        self.groups_given: str | Sequence[Sequence[str]] = ()
        self.exports: tuple[Export, ...] = ()
        """The rules for the ports that it exports."""
        self.members: tuple[Component, ...] = ()
        """The members in the order stated; a composite among them is one."""
        self.groups: tuple[tuple[str, ...], ...] = ()
        """Names of members: the groups that run side by side."""
        self.laid_out: Sequence[Component] = ()
        """The members in order of execution, as it was laid out last."""
        self.started_in: Context | None = None
        """The context in which it was started last; an inner composite runs in that of `root`."""
        self.known: dict[Port[Any], frozenset[Connector]] = {}
        """The connectors that a port had already when it was exported."""
        self.state_published: LifecycleState | None = None

    @property
    def name(self) -> str:
        """The composite's name."""
        return self.component.name

    @property
    def kernel(self) -> Microkernel:
        """The kernel that the composite belongs to."""
        return self.component.kernel

    @property
    def outer(self) -> CompositeGroup | None:
        """The group that the composite is a member of."""
        return outer_of(self.component)

    @property
    def state(self) -> LifecycleState | None:
        """The state that follows from its members' (`aiorts.composites.composition.STATES`); None in no context."""
        if self.is_spread:
            return derived((state for one in self.inner if (state := one.state) is not None), self.errors)
        context = self.context
        return None if context is None else self.state_in(context)

    @property
    def states(self) -> dict[str, LifecycleState]:
        """Its state, by the name of each context that runs members of it."""
        state = self.state
        return {} if state is None else dict.fromkeys(self._context_names(), state)

    def _context_names(self) -> tuple[str, ...]:
        if self.is_spread:
            return tuple(name for one in self.inner for name in one._context_names())
        context = self.context
        return () if context is None else (context.name,)

    @property
    def is_spread(self) -> bool:
        """Whether each member has a schedule of its own: then the composite is in no context, and has their state."""
        return bool(self.members) and all(map(self.runs_apart, self.members))

    @property
    def parts_together(self) -> tuple[Component, ...]:
        """The parts of the composite; if all members have a schedule of their own, the parts of the members."""
        return self.parts or tuple(part for one in self.inner if self.is_spread for part in one.parts_together)

    @property
    def next_out(self) -> CompositeGroup | None:
        """The outer group, if an error here concerns it, too: this group runs with it, or the outer group is spread."""
        outer = self.outer
        return outer if outer is not None and (not self.own_schedule or outer.is_spread) else None

    @property
    def parts(self) -> tuple[Component, ...]:
        """The components that run with it, in order: its members, with inner composites replaced by their parts."""
        return self.line(self.laid_out)

    @property
    def context(self) -> Context | None:
        """The context that runs its members; None when there is none."""
        context = self.root.started_in
        return context if context is not None and context.running else None

    @property
    def holds(self) -> bool:
        """Whether the members run with the composite, or are about to; else each may run in contexts of its own."""
        context = self.root.started_in
        return context is not None and (context.running or not context.runner.stopping)

    @property
    def root(self) -> CompositeGroup:
        """The outermost group that this group runs with; itself if it has a schedule of its own."""
        root = self
        while (outer := root.outer) is not None and not root.own_schedule:
            root = outer
        return root

    @property
    def inner(self) -> tuple[CompositeGroup, ...]:
        """The groups of the composites among its members."""
        return tuple(filter(None, map(group_of, self.members)))

    def line(self, members: Iterable[Component]) -> tuple[Component, ...]:
        """The components that these members stand for, in order."""
        apart = self.runs_apart
        return tuple(part for member in members if not apart(member) for part in parts_of(member))

    def runs_apart(self, member: Component) -> bool:
        """Whether this member is a composite with a schedule of its own."""
        group = group_of(member)
        return group is not None and group.own_schedule

    def state_in(self, context: Context) -> LifecycleState | None:
        """The state in a context that follows from its members'; a composite among them counts with its own state."""
        states: list[LifecycleState | None] = []
        for one in self.laid_out:
            group = group_of(one)
            if group is None:
                states += [member.state for member in cell(one).members if member.context is context]
            elif not group.own_schedule:
                states.append(group.state_in(context))
        return derived((state for state in states if state is not None), self.errors)

    def lay_out(self) -> None:
        """Lay out the order again, also of inner composites."""
        for inner in self.inner:
            inner.lay_out()
        self.laid_out = self.ordered()

    def enter_context(self, context: Context | None) -> None:
        """Set the context in which the composite is about to run, or None."""
        self.started_in = context
        self.reset_state(None if context is None else LifecycleState.INACTIVE)
        outer = self.next_out
        while context is not None and outer is not None and outer.state is None:
            outer.state_published, outer = LifecycleState.INACTIVE, outer.next_out

    def reset_state(self, state: LifecycleState | None) -> None:
        """Set the last published state without publishing it."""
        self.state_published = state
        for inner in self.inner:
            if not inner.own_schedule:
                inner.reset_state(state)

    def ordered(
        self,
        members: Sequence[Component] | None = None,
        order: str | None = None,
        groups: tuple[tuple[str, ...], ...] | None = None,
    ) -> list[Component]:
        """The members in order of execution."""
        direct = self.members if members is None else members
        named = {member.name: member for member in direct}
        grouped = self.groups if groups is None else groups
        if grouped:
            direct = [named[name] for group in grouped for name in group if name in named]
        if (order or self.order) == "stated":
            return list(direct)
        belongs = {part.name: member.name for member in direct for part in leaves_of((member,))}
        edges = [
            (belongs[part.name], belongs.get(connector.in_.path.removesuffix(f".{connector.in_.name}"), ""))
            for member in direct
            for part in leaves_of((member,))
            for port in part.ports.values()
            if port.direction == "out"
            for connector in port.connectors
        ]
        lines = [flow_order([name for name in group if name in named], edges) for group in grouped or (tuple(named),)]
        return [named[name] for line in lines for name in line]

    def sections(self) -> tuple[tuple[tuple[Component, ...], ...], ...]:
        """Its groups that run side by side; composites within a group run there, one member after the other."""
        if self.groups:
            named = {member.name: member for member in self.members}
            place = {part: index for index, part in enumerate(self.parts)}
            lines = [self.line(named[name] for name in group if name in named) for group in self.groups]
            return (tuple(tuple(sorted(line, key=lambda part: place[part])) for line in lines if line),)
        inner = filter(None, map(group_of, self.laid_out))
        return tuple(section for group in inner if not group.own_schedule for section in group.sections())

    def check_context(self, component: Component, context: Context) -> None:
        """Refuse a context: a member runs where its composite runs and nowhere else."""
        if self.holds and self.root.started_in is not context:
            raise StateError(
                f"{component.name}: is a member of {self.name}, which says where it runs; "
                f"start {self.root.name}, or {self.name}.remove_members first"
            )

    def ports_of(self, members: Sequence[Component], rules: Sequence[Any] | None = None) -> dict[str, Port[Any]]:
        """The ports that these members and rules export. WiringError: two have one name, or one does not exist."""
        every = {(member.name, name): port for member in members for name, port in member.ports.items()}
        found = shown(self.exports if rules is None else rules, every, self.name)
        return {name: every[place] for name, place in found.items()}

    def have_members(self, members: Sequence[Component], inside: frozenset[Port[Any]]) -> tuple[Connector, ...]:
        """Set the members; return the connectors that ended with ports withdrawn."""
        self.members = tuple(members)
        self.root.lay_out()
        return self.show(self.ports_of(self.members), inside)

    def publish_change(
        self, added: Sequence[Component], removed: Sequence[Component], ended: Sequence[Connector] = ()
    ) -> None:
        """Publish which members joined and left, and which connectors ended."""
        names = [tuple(one.name for one in those) for those in (self.laid_out, added, removed, ended)]
        self.kernel.bus.publish(CompositeChanged(self.name, *names))

    def show(self, ports: Mapping[str, Port[Any]], inside: frozenset[Port[Any]]) -> tuple[Connector, ...]:
        """Export these ports and no others; a connector between two ports of `inside` stays within the composite."""
        kernel = self.kernel
        showing = cell(self.component).ports
        before = dict(showing)
        showing.clear()
        showing.update(ports)
        ended: list[Connector] = []
        still = set(ports.values())
        for name, port in before.items():
            if ports.get(name) is port:
                continue
            if port not in still:
                known = self.known.pop(port, frozenset())
                for connector in port.connectors:
                    if connector not in known and not (connector.out in inside and connector.in_ in inside):
                        kernel.connections.end(connector)
                        ended.append(connector)
            kernel.bus.publish(PortRemoved(self.name, replace(port.profile, name=name)))
        for name, port in ports.items():
            if before.get(name) is not port:
                self.known.setdefault(port, frozenset(port.connectors))
                kernel.bus.publish(PortAdded(self.name, replace(port.profile, name=name)))
        for connector in ended:
            counts = connector.statistics
            self.component.log.warning(
                "disconnected %s: its port is exported no more; %d written, %d delivered, %d dropped",
                connector.name,
                counts.written,
                counts.arrived,
                sum(counts.dropped.values()),
            )
        outer = self.outer
        if outer is not None and before != dict(ports):
            outer.ports_changed()
        return tuple(ended)

    def check_ports(self, ports: Mapping[str, Port[Any]] | None = None) -> None:
        """Raise WiringError when the members' ports (or these ports) cannot be exported, here or further out."""
        ports = self.ports_of(self.members) if ports is None else ports
        outer = self.outer
        if outer is not None:
            here = cell(self.component)
            showing, here.ports = here.ports, dict(ports)
            try:
                outer.check_ports()
            finally:
                here.ports = showing

    def ports_changed(self) -> None:
        """Export the ports again, since the ports of a member changed."""
        inside = frozenset(port for part in leaves_of(self.members) for port in part.ports.values())
        self.show(self.ports_of(self.members), inside)

    def check_new_port(self, member: Component, port: Port[Any]) -> None:
        """Check that a member's new port can be exported; if not, remove the port and raise WiringError."""
        try:
            self.check_ports()
        except WiringError:
            del cell(member).ports[port.name]
            raise

    @staticmethod
    async def start(
        kernel: Microkernel, context: Context, components: Sequence[Component], *, activate: bool, timeout: float | None
    ) -> None:
        """Start a context with composites among its components."""
        await membership.start(kernel, context, components, activate=activate, timeout=timeout)

    @staticmethod
    async def join(context: Context, components: Sequence[Component], timeout: float | None) -> None:
        """Add components, composites among them, to a running context."""
        await membership.enter(context, components, timeout)

    @staticmethod
    async def leave(context: Context, components: Sequence[Component], timeout: float | None) -> None:
        """Remove components, composites among them, from a running context."""
        await membership.leave(context, components, timeout)

    async def request(self, what: str, timeout: float | None) -> None:
        """Activate, deactivate or reset all members, as `what` says."""
        await membership.transition(self, LifeEvent(what), timeout)

    def check_startable(self) -> None:
        """Raise StateError when the composite runs already, or all its members have a schedule of their own."""
        if self.is_spread:
            names = ", ".join(member.name for member in self.members)
            raise StateError(f"{self.name}: each member has a schedule of its own; start {names}, each in its context")
        context = self.context
        if context is not None:
            raise StateError(f"{self.name}: runs in {context.name} already")

    async def dissolve(self) -> None:
        """Return the members to their former contexts, since the composite is about to leave the kernel."""
        await membership.change(self, membership.Wanted(()), 5.0)

    async def added(self) -> None:
        """Add the members together with the composite, all or none."""
        kernel = self.kernel
        added: list[Component] = []
        try:
            for member in self.given:
                if isinstance(member, Component) and cell(member).kernel is None:
                    await kernel.add(member)
                    added.append(member)
            given = await self.bring_in(self.given)
            members = composition_check.resolved(kernel, self, given)
            composition_check.check(self, members, self.exports)
            self.groups = composition_check.grouped(self, members, self.groups_given)
        except BaseException:
            await self.let_go(tuple(self.brought))
            for member in reversed(added):
                await kernel.remove(member)
            raise
        for member in members:
            cell(member).group = self
        self.members = members
        self.lay_out()
        cell(self.component).ports.update(self.ports_of(members))
        self.known = {port: frozenset(port.connectors) for port in cell(self.component).ports.values()}

    async def bring_in(self, given: Iterable[Component | str]) -> list[Component | str]:
        """The given members, with stand-ins for components of other kernels; new stand-ins are added to the kernel."""
        known = {path: member for member, path in self.brought.items()}
        found: list[Component | str] = []
        for one in given:
            if isinstance(one, str) and self.kernel.registry.is_elsewhere(one):
                if one not in known:
                    known[one] = await self.kernel.stand_in(one, self.name)
                    self.brought[known[one]] = one
                found.append(known[one])
            else:
                found.append(one)
        return found

    async def let_go(self, members: Sequence[Component | str]) -> None:
        """Remove the members among these that were brought in from other kernels."""
        for member in [one for one in members if isinstance(one, Component) and one in self.brought]:
            del self.brought[member]
            await self.kernel.remove(member)

    def member_replaced(self, old: Component, new: Component) -> None:
        """Put another instance in a member's place."""
        self.members = _renewed(self.members, old, new)
        self.laid_out = _renewed(self.laid_out, old, new)
        self.given = tuple(new if one is old else one for one in self.given)
        for context in new.contexts:
            parallel.lay_out_parallel(context)

    def removed(self) -> None:
        """Release the members, since the composite belongs to no kernel any more."""
        for member in self.members:
            cell(member).group = None
        self.members = self.laid_out = ()
        cell(self.component).ports.clear()

    def member_removed(self, member: Component) -> None:
        """Drop a member that was removed; its connectors ended with it."""
        cell(member).group = None
        self.brought.pop(member, None)
        self.have_members([other for other in self.members if other is not member], frozenset())
        self.publish_change((), (member,))

    def member_entered(self, member: Member) -> None:
        """Follow a member's change of state; in the thread of its context."""
        if member.state is not LifecycleState.INACTIVE:
            member.stopped_for = frozenset()
        context = self.context
        if context is None or context is not member.context or member.component not in self.parts:
            return  # a member on trial: its changes are published when it has joined
        failed = member.state is LifecycleState.ERROR
        group: CompositeGroup | None = self
        while failed and group is not None:
            if group.errors is ErrorPolicy.STOP:
                recovery.stop_the_others(group, context, member.component.name)
            failed = group.state is LifecycleState.ERROR
            group = group.next_out
        self.publish_state()

    def publish_state(self) -> None:
        """Publish the composite's state, unless that was published before."""
        state, kernel = self.state, self.kernel
        before, self.state_published = self.state_published, state
        if state is not None and before is not None and before is not state:
            for name in self._context_names():
                event = StateChanged(self.name, name, before, state)
                kernel.call_on_loop(partial(kernel.bus.publish, event))
        outer = self.next_out
        if outer is not None and outer.is_spread:
            kernel.call_on_loop(outer.publish_state)  # contexts of several threads are in it
        elif outer is not None:
            outer.publish_state()


def _renewed(those: Iterable[Component], old: Component, new: Component) -> tuple[Component, ...]:
    return tuple(new if one is old else one for one in those)


class CompositeKind(Kind):
    """Describes composites for introspection."""

    def reports(self, component: Component) -> Mapping[str, Any]:
        """The members and exports of a composite."""
        from aiorts.observe import CompositeReport

        group = group_of(component)
        assert group is not None  # noqa: S101 - a composite
        report = CompositeReport(
            tuple(member.name for member in group.members),
            tuple(part.name for part in group.parts),
            MappingProxyType({name: port.path for name, port in component.ports.items()}),
            group.groups,
            group.order,
            group.errors.value,
            group.own_schedule,
        )
        return {"composite": report}

    def keeps_code(self, component: Component) -> str:
        return "is a composite; reload its members"
