"""What a component stands for besides its contexts and connectors, so that a new instance can stand for it.

Its configuration with sets and parameters added, and its place in a composite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts.errors import ComponentError, DeclarationError, StateError, said
from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component
from aiorts.model.lifecycle import Event
from aiorts.model.sets import ConfigurationState
from aiorts.model.values import shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from aiorts.kernel.composed import Composed
    from aiorts.kernel.homes import Home
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.modes import Participant
    from aiorts.kernel.state_machine import StateMachine

__all__ = ("Standing", "instance_of", "reset_whole", "standing_of")


@dataclass(frozen=True, slots=True)
class Standing:
    """Taken from the old instance before it goes."""

    configuration: ConfigurationState
    added: tuple[str, ...]
    """Parameters that its class does not declare."""
    composite: Composed | None
    place: int
    """Among the composite's members."""
    kept: frozenset[str]
    """Connectors that its ports had before the composite exported them."""
    homes: tuple[Home, ...]
    machines: tuple[StateMachine, ...]
    """Machines that told it of their changes."""
    participants: tuple[Participant, ...]
    """Those that its own machine told."""

    def configure(self, new: Component) -> None:
        """Give an instance that belongs to no kernel yet the sets, the active one and the parameters of the old.

        What its class does not declare any more is left out. ConfigurationError: it refuses a value.
        """
        refused = commit(new, lambda state: self._configured(state, new.name))
        if refused is not None:
            raise refused

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

    async def join(self, kernel: Kernel, new: Component) -> None:
        """Take the old one's place in its composite, if there still is one, and among participants."""
        from aiorts.kernel import membership

        self._take_part(kernel, new)
        composite = self.composite
        if composite is None or kernel.components.get(composite.name) is not composite:
            return
        members: list[Any] = [member for member in composite._rt_direct if member is not new]
        members.insert(self.place, new)
        await membership.change(composite, membership.Wanted(members), 5.0)
        new._rt_homes = self.homes

    def _take_part(self, kernel: Kernel, new: Any) -> None:
        if hasattr(new, "_rt_machines"):
            for machine in self.machines:
                machine.add_participant(new)
        own: Any = getattr(new, "machine", None)
        for one in self.participants if hasattr(own, "add_participant") else ():
            if kernel.components.get(one.name) is one:
                own.add_participant(one)


def standing_of(component: Component) -> Standing:
    """How it stands at this moment."""
    composite = component._rt_composite
    state = component._rt_params._state
    declared = type(component)._rt_parameter_specs
    known = [] if composite is None else [composite._rt_known.get(port, ()) for port in component.ports.values()]
    return Standing(
        state,
        tuple(name for name in state.specs if name not in declared),
        composite,
        0 if composite is None else composite._rt_direct.index(component),
        frozenset(connector.name for connectors in known for connector in connectors),
        component._rt_homes,
        getattr(component, "_rt_machines", ()),
        getattr(getattr(component, "machine", None), "_participants", ()),
    )


async def reset_whole(composite: Composed) -> None:
    """Take all members that are in error out of it, and activate the composite again."""
    from aiorts.kernel import membership

    if composite.contexts:
        await membership.transition(composite, Event.RESET, 5.0)
        await membership.transition(composite, Event.ACTIVATE, 5.0)


def instance_of(kernel: Kernel, name: str, factory: Callable[[str], Component]) -> Component:
    """A new instance of this name.

    Raises:
        ComponentError: the factory raised what is no Exception: a SystemExit of a constructor ends nothing but this.
        DeclarationError, StateError: what it made is no component, or is named otherwise.
    """
    try:
        new = factory(name)
    except Exception:
        raise
    except BaseException as error:  # a component's border: its constructor is the user's
        if isinstance(error, KeyboardInterrupt):
            kernel._interrupted(error)
        raise ComponentError(f"{name}: cannot be made anew: {said(error)}") from error
    if not isinstance(new, Component) or not hasattr(new, "_rt_host"):
        raise DeclarationError(f"{name}: its factory made {shown(new)}; expected a component of that name")
    if new.name != name:
        raise StateError(f"{name}: its factory made a component named {new.name!r}")
    return new
