"""What a system file says of a component's configuration, put in force in one step: parameters, sets, active set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component, construct
from aiorts.late import dataclass
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState

ACTIVE: Final = "active"
"""`--set COMPONENT.active=NAME` chooses a set, where the component has no parameter of that name."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Setting:
    """The configuration of one component, checked."""

    params: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    """What the set "default" has other than declared."""
    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    active: str | None = None
    """None: the default one."""

    def put(self, component: Component) -> None:
        """Into a component that belongs to no kernel yet; ConfigurationError when it refuses."""
        refused = commit(component, lambda state: self.merged(state, component.name))
        if refused is not None:
            raise refused

    def merged(self, state: ConfigurationState, owner: str) -> ConfigurationState:
        """The state that this makes of another."""
        return state.merged({DEFAULT: self.params, **self.sets}, self.active, owner)

    def make(self, cls: type[Component], name: str) -> Component:
        """A component of this class with this configuration, in no kernel."""
        component = construct(cls, name)
        self.put(component)
        return component
