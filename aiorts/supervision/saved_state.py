"""Saves the state of a component that its contexts and connectors do not have, for a new instance of it.

That is its configuration, with sets and parameters added, and its place in a composite.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts.composites import outer_of
from aiorts.errors import ComponentError, DeclarationError, StateError
from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations, kinds_of
from aiorts.kernel.execution.cell import cell, has_cell
from aiorts.kernel.loop.origins import located
from aiorts.late import dataclass
from aiorts.model.configuration.sets import ConfigurationState
from aiorts.model.lifecycle import Event
from aiorts.model.values import shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.composites import CompositeGroup, PreviousPlacement
    from aiorts.kernel.microkernel import Microkernel


@dataclass(frozen=True, slots=True)
class SavedState:
    """Taken from the old instance before it is removed."""

    configuration: ConfigurationState
    was_active: bool
    """Whether it was active at any time: samples that the new one drops do not come before its start."""
    added: tuple[str, ...]
    """Parameters that its class does not declare."""
    composite: CompositeGroup | None
    place: int
    """Its place among the composite's members."""
    kept: frozenset[str]
    """Connectors that its ports had before the composite exported them."""
    previous_placements: tuple[PreviousPlacement, ...]
    heritages: tuple[Callable[[Component], None], ...]
    """The functions by which its kinds hand over, such as the machines it takes part in."""

    def configure(self, new: Component) -> None:
        """Give an instance, before it is added to a kernel, the sets, the active set and the parameters of the old one.

        Those that its class no longer declares are left out. ConfigurationError: it refuses a value.
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

    async def join(self, kernel: Microkernel, new: Component) -> None:
        """Take the old instance's place in its composite, if that still exists, and among participants."""
        from aiorts.composites import Wanted, change

        for hand_over in self.heritages:
            hand_over(new)
        composite = self.composite
        if composite is None or kernel.components.get(composite.name) is not composite.component:
            return
        members: list[Any] = [member for member in composite.members if member is not new]
        members.insert(self.place, new)
        await change(composite, Wanted(members), 5.0)
        cell(new).previous_placements = self.previous_placements


def standing_of(component: Component) -> SavedState:
    """How it stands at this moment."""
    composite = outer_of(component)
    state = cell(component).configuration
    declared = declarations(type(component)).parameters
    known = [] if composite is None else [composite.known.get(port, ()) for port in component.ports.values()]
    return SavedState(
        state,
        cell(component).was_active,
        tuple(name for name in state.specs if name not in declared),
        composite,
        0 if composite is None else composite.members.index(component),
        frozenset(connector.name for connectors in known for connector in connectors),
        cell(component).previous_placements,
        tuple(filter(None, (kind.heritage(component) for kind in kinds_of(component)))),
    )


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
