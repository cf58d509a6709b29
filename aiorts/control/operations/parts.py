"""Operations that look at a part of the system, so that one component does not cost the whole profile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import absent, component_named, context_named
from aiorts.control.session import Session
from aiorts.late import dataclass
from aiorts.model.plain import empty
from aiorts.observe import SystemPart, system_part
from aiorts.types import full_name


@dataclass(frozen=True, slots=True)
class Parts:
    """Components, connectors and contexts to report, by name. A component comes with its connectors and contexts."""

    components: tuple[str, ...] = ()
    connectors: tuple[str, ...] = ()
    contexts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Outlined:
    """Components to outline; an empty tuple is all."""

    components: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PortOutline:
    """The direction and the type of a port."""

    direction: str
    """"in", "out" or "service"."""
    type: str
    full_type: str = ""
    """The name by which other processes know the type; "" of a service port."""


@dataclass(frozen=True, slots=True)
class Outline:
    """The type, the ports and the parameters of a component, by name."""

    type: str
    """"module:Class"."""
    ports: Mapping[str, PortOutline] = field(default_factory=empty)
    params: tuple[str, ...] = ()


def _part(session: Session, given: Parts) -> SystemPart:
    kernel = session.kernel
    for name in given.components:
        component_named(session, name)
    for name in given.contexts:
        context_named(session, name)
    known = (*kernel.connectors, *kernel.service_connectors)
    for name in given.connectors:
        if name not in known:
            raise absent(f"{name:.80}: no such connector", name, known)
    return system_part(kernel, given.components, given.connectors, given.contexts)


def _outline(session: Session, given: Outlined) -> Mapping[str, Outline]:
    kernel = session.kernel
    chosen = {name: component_named(session, name) for name in given.components} or {
        name: one for name, one in kernel.components.items() if not kernel.registry.is_arriving(one)
    }
    return MappingProxyType(
        {
            name: Outline(
                f"{type(one).__module__}:{type(one).__qualname__}",
                MappingProxyType({port.name: _port(port) for port in one.ports.values()}),
                tuple(one.params),
            )
            for name, one in chosen.items()
        }
    )


def _port(port: Any) -> PortOutline:
    profile = port.profile
    types = ", ".join(f"{one.polarity} {one.type}" for one in profile.interfaces) or profile.type
    return PortOutline(profile.direction, types, "" if profile.direction == "service" else full_name(port.type))


ROWS: Final = (
    Operation(
        "outline",
        "Types, ports and parameters of components, by name.",
        Outlined,
        Mapping[str, Outline],
        Right.VIEW,
        _outline,
        idempotent=True,
    ),
    Operation(
        "part",
        "Reports of components with their connectors and contexts, of connectors, of contexts.",
        Parts,
        SystemPart,
        Right.VIEW,
        _part,
        idempotent=True,
    ),
)
