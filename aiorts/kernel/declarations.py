"""What a component class declares, as values: ports, parameters and hooks, read from the class; nothing is created."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from aiorts.errors import DeclarationError
from aiorts.kernel.component import Component
from aiorts.kernel.hooks import HookKind

if TYPE_CHECKING:
    from aiorts.model.configuration import ParameterSpec
    from aiorts.model.profile import PortProfile

__all__ = ("Declaration", "declaration_of")


@dataclass(frozen=True, slots=True)
class Declaration:
    """What a component class says of itself.

    ports: those of its class body; it may add others when it is created.
    hooks: those it defines, in the order of a component's life.
    """

    type: str
    ports: tuple[PortProfile, ...]
    parameters: tuple[ParameterSpec, ...]
    hooks: tuple[str, ...]


def declaration_of(cls: type[Component]) -> Declaration:
    """What this class declares. DeclarationError when it is no component class."""
    if not (isinstance(cls, type) and issubclass(cls, Component)):
        raise DeclarationError(f"{cls!r:.60}: expected a class derived from Component")
    return Declaration(
        cls.__name__,
        tuple(
            replace(port.profile, name=port.name or attribute) for attribute, port in cls._rt_port_declarations.items()
        ),
        tuple(cls._rt_parameter_specs.values()),
        tuple(hook for hook, kind in cls._rt_hook_kinds.items() if kind != HookKind.ABSENT),
    )
