"""The place of a component in its kernel, read from one instance and put back for the next one.

After a failure, supervision puts a new instance in the place; a move puts one of another process there. Planning and
reload look up the state in each context.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from aiorts.composites import outer_of
from aiorts.errors import ComponentError, DeclarationError, StateError
from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations, kinds_of
from aiorts.kernel.execution.cell import cell, has_cell
from aiorts.kernel.loop.origins import located
from aiorts.kernel.ports.connector import transport_of
from aiorts.late import dataclass
from aiorts.model.configuration.sets import ConfigurationState
from aiorts.model.lifecycle import Event, LifecycleState
from aiorts.model.values import shown
from aiorts.services import ServiceConnector

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from aiorts.composites import CompositeGroup, PreviousPlacement
    from aiorts.kernel.execution.cycle import Done, Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.profile import ConnectorProfile
    from aiorts.model.service_profile import ServiceConnectorProfile

    KeptConnector = tuple[ConnectorProfile | ServiceConnectorProfile, bool]
    """The profile of a connector, and whether its losses are reported. The port of a writer comes first."""


@dataclass(frozen=True, slots=True)
class ContextPlace:
    """A component in one of its contexts, at one moment."""

    member: Member
    order: int
    """The number by which the context sorts its members."""
    state: LifecycleState
    failure: BaseException | None
    finishing: bool

    @classmethod
    def of(cls, member: Member) -> ContextPlace:
        """The place of a member at this moment."""
        return cls(member, member.order, member.state, member.failure, member.finishing)

    async def put_back(self, new: Component) -> None:
        """Add an instance to the context, if that runs, in the same order; active unless the old one was inactive."""
        context = self.member.context
        if not context.running or new.kernel.contexts.get(context.name) is not context:
            return
        if context not in new.contexts:
            await context.add(new)
        await context.runner.ask([(f"put {new.name} in its place", lambda done: self._sort(new, done))], 5.0)
        if self.state is not LifecycleState.INACTIVE and context.state(new) is LifecycleState.INACTIVE:
            await context.activate(new)

    def _sort(self, new: Component, done: Done) -> Steps:
        runner = self.member.context.runner
        runner.member(new).order = self.order
        runner.members.sort(key=lambda member: member.order)
        done(None)
        yield from ()


@dataclass(frozen=True, slots=True)
class ComponentPlace:
    """The place of a component, read before its instance is removed."""

    configuration: ConfigurationState
    was_active: bool
    """Whether the component was ever active: samples that the new instance drops do not come before that start."""
    added: tuple[str, ...]
    """Parameters that its class does not declare."""
    contexts: tuple[ContextPlace, ...]
    connectors: list[KeptConnector]
    composite: CompositeGroup | None
    index: int
    """The position among the composite's members."""
    kept: frozenset[str]
    """Connectors that its ports had before the composite exported them."""
    previous_placements: tuple[PreviousPlacement, ...]
    heritages: tuple[Callable[[Component], None], ...]
    """The functions by which its kinds hand over to the new one, such as its part in machines."""
    on_link_lost: str
    """The option of this name in a system file."""

    def configure(self, new: Component) -> None:
        """Give an instance, before it is added to a kernel, the sets, the active set and the parameters of the old one.

        Parameters that its class no longer declares are left out. ConfigurationError: the instance refuses a value.
        """
        refused = commit(new, lambda state: self._configured(state, new.name), old=self.configuration)
        if refused is not None:
            raise refused
        cell(new).was_active = self.was_active

    def _configured(self, state: ConfigurationState, owner: str) -> ConfigurationState:
        old = self.configuration
        for name in self.added:
            if name not in state.specs:
                state = state.with_parameter(old.specs[name], owner)
        sets = {
            name: {parameter: value for parameter, value in values.items() if parameter in state.specs}
            for name, values in old.sets.items()
        }
        return state.replaced(sets, old.active, owner)

    async def put_back(self, new: Component, connect: Callable[[Sequence[KeptConnector]], None]) -> None:
        """Give this place to an instance already in its kernel: connectors, composite and contexts, in this order.

        Args:
            connect: makes connectors between the ports that still exist.
        """
        new.kernel.registry.on_link_lost[new.name] = self.on_link_lost
        connect([one for one in self.connectors if one[0].name in self.kept])
        await self._join(new)
        connect([one for one in self.connectors if one[0].name not in self.kept])
        for place in self.contexts:
            await place.put_back(new)

    async def _join(self, new: Component) -> None:
        """Take the old instance's place in its composite, if that still exists, and among participants."""
        from aiorts.composites import Wanted, change

        for hand_over in self.heritages:
            hand_over(new)
        composite = self.composite
        if composite is None or new.kernel.components.get(composite.name) is not composite.component:
            return
        members: list[Any] = [member for member in composite.members if member is not new]
        members.insert(self.index, new)
        await change(composite, Wanted(members), 5.0)
        cell(new).previous_placements = self.previous_placements


def place_of(component: Component) -> ComponentPlace:
    """The place of a component at this moment."""
    composite = outer_of(component)
    state = cell(component).configuration
    declared = declarations(type(component)).parameters
    ports = component.ports.values()
    known = {} if composite is None else composite.known
    # A connector from the component to itself is at two of its ports.
    connectors = {connector.name: connector for port in ports for connector in port.connectors}
    return ComponentPlace(
        state,
        cell(component).was_active,
        tuple(name for name in state.specs if name not in declared),
        tuple(map(ContextPlace.of, cell(component).members)),
        [_kept_of(connector) for connector in connectors.values()],
        composite,
        0 if composite is None else composite.members.index(component),
        frozenset(connector.name for port in ports for connector in known.get(port, ())),
        cell(component).previous_placements,
        tuple(filter(None, (kind.heritage(component) for kind in kinds_of(component)))),
        component.kernel.registry.on_link_lost.get(component.name, ""),
    )


def _kept_of(connector: Connector | ServiceConnector) -> KeptConnector:
    if isinstance(connector, ServiceConnector):
        return connector.profile, False
    profile, ends = connector.profile, (connector.out.path, connector.in_.path)
    ports = (*ends, *(path for path in profile.ports if path not in ends))
    return replace(profile, ports=ports), transport_of(connector).losses is not None


async def reset_whole(composite: CompositeGroup) -> None:
    """Reset all members that are in error, and activate the composite again."""
    from aiorts.composites import transition

    if composite.state is not None:
        await transition(composite, Event.RESET, 5.0)
        await transition(composite, Event.ACTIVATE, 5.0)


def instance_of(kernel: Microkernel, name: str, factory: Callable[[str], Component]) -> Component:
    """Make a new instance of this name.

    Raises:
        ComponentError: the factory raised, also a SystemExit: it ends only this call.
        DeclarationError, StateError: the factory made no component, or one of another name.
    """
    try:
        new = factory(name)
    except Exception:
        raise
    except BaseException as error:  # a component's border: its constructor is the user's
        if issubclass(type(error), KeyboardInterrupt):
            kernel.pass_on_interrupt(error)
        raise ComponentError(f"{name}: cannot be made anew: {located(error)}") from error
    if not isinstance(new, Component) or not has_cell(new):
        raise DeclarationError(f"{name}: its factory made {shown(new)}; expected a component of that name")
    if new.name != name:
        raise StateError(f"{name}: its factory made a component named {new.name!r}")
    return new
