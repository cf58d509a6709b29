"""What a component class declares, as values: ports, parameters and hooks, read from the class; nothing is created."""

from __future__ import annotations

from dataclasses import dataclass, replace

from aiorts.errors import DeclarationError
from aiorts.kernel.component import Component
from aiorts.kernel.hooks import HookKind
from aiorts.kernel.port import Port
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
        _ports(cls),
        tuple(cls._rt_parameter_specs.values()),
        tuple(hook for hook, kind in cls._rt_hook_kinds.items() if kind != HookKind.ABSENT),
    )


def _ports(cls: type[Component]) -> tuple[PortProfile, ...]:
    """Data ports as they are declared; interfaces that share a service port as one."""
    found: dict[str, PortProfile] = {}
    for attribute, declared in cls._rt_port_declarations.items():
        name = declared.name or attribute
        if isinstance(declared, Port):
            found[name] = replace(declared.profile, name=name)
            continue
        one = replace(declared.profile, name=declared.instance or (attribute if declared.name else "") or name)
        port = found.get(name, PortProfile(name, "service", "", doc=one.doc))
        kinds = ", ".join((*filter(None, (port.type,)), one.type))
        found[name] = replace(port, type=kinds, interfaces=(*port.interfaces, one))
    return tuple(found.values())
