"""The declarations of a component class as values, for tools: ports, parameters and hooks; nothing is created."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from aiorts.errors import DeclarationError
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.hooks import HookKind
from aiorts.late import dataclass

if TYPE_CHECKING:
    from aiorts.kernel.declarations import Declarations
    from aiorts.model.configuration.parameters import ParameterSpec
    from aiorts.model.profile import PortProfile


@dataclass(frozen=True, slots=True)
class Declaration:
    """The declarations of a component class: ports, parameters, hooks and configuration sets.

    ports: the ports of the class body; a component may add others when it is created. hooks: the hooks that the class
    defines, in the order of a component's life. sets: its configuration sets by name, "default" first; the other sets
    hold the values that they change.
    """

    type: str
    ports: tuple[PortProfile, ...]
    parameters: tuple[ParameterSpec, ...]
    hooks: tuple[str, ...]
    sets: Mapping[str, Mapping[str, Any]]


def declaration_of(cls: type[Component]) -> Declaration:
    """The declarations of this class. DeclarationError when it is no component class."""
    if not (isinstance(cls, type) and issubclass(cls, Component)):
        raise DeclarationError(f"{cls!r:.60}: expected a class derived from Component")
    declared = declarations(cls)
    return Declaration(
        cls.__name__,
        _ports(declared),
        tuple(declared.parameters.values()),
        tuple(hook for hook, kind in declared.hook_kinds.items() if kind != HookKind.ABSENT),
        declared.configuration.sets,
    )


def _ports(declared: Declarations) -> tuple[PortProfile, ...]:
    found: dict[str, PortProfile] = {}
    for attribute, port in declared.ports.items():
        profile = port.declared_profile(attribute, found)
        found[profile.name] = profile
    return tuple(found.values())
