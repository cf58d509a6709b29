"""A component's configuration in a system file, put in force in one step: parameters, sets, active set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component, construct
from aiorts.kernel.declarations import declarations
from aiorts.late import dataclass
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

ACTIVE: Final = "active"
"""`--set COMPONENT.active=NAME` chooses a set, if the component has no parameter named "active"."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Setting:
    """The configuration of one component, checked."""

    params: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    """The values of the set "default" that differ from the declared values."""
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    active: str | None = None
    """The name of the active set; None: the default one."""

    def put(self, component: Component) -> None:
        """Configure a component that is in no kernel yet. ConfigurationError: the component refuses."""
        refused = commit(component, lambda state: self.merged(state, component.name))
        if refused is not None:
            raise refused

    def merged(self, state: ConfigurationState, owner: str) -> ConfigurationState:
        """The state that results when this setting is put on another state."""
        return state.merged({DEFAULT: self.params, **self.sets}, self.active, owner)

    async def create(self, kernel: Microkernel, cls: type[Component], name: str = "") -> Component:
        """A component of this class in this kernel, its sets in force before its first hook."""
        if self.sets or self.active is not None:
            return await kernel.add(self.make(cls, name))
        return await kernel.create(cls, name, **self.params)

    def make(self, cls: type[Component], name: str) -> Component:
        """A component of this class with this configuration, in no kernel."""
        component = construct(cls, name)
        self.put(component)
        return component


def setting_alone(component: Component, given: Mapping[str, Any]) -> Setting:
    """The setting of a component that runs alone: values of parameters, and in `active` the name of the active set.

    These values are in force, even where the active set has others.

    Raises:
        ConfigurationError: names all parameters that are wrong, or says that there is no such set.
    """
    declared = declarations(type(component)).configuration
    if ACTIVE not in given or ACTIVE in component.params:
        return Setting(component.params.check(given))
    active = str(given[ACTIVE]).strip()
    values = declared.activated(active, component.name).sets[active]
    params = component.params.check({name: value for name, value in given.items() if name != ACTIVE})
    chosen = {name: value for name, value in params.items() if name in values}
    sets = {active: {**values, **chosen}} if chosen and active != DEFAULT else {}
    return Setting(params, MappingProxyType(sets), active)
