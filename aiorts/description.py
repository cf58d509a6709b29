"""A component as a file of others describes it, for `aiorts new NAME --from FILE`.

A plugin offers the reader of such a file as an entry point `aiorts.describers`, named after the ending of the file's
name: a function of a path that returns a `ComponentDescription`, or raises an error of `aiorts.errors`.
"""

from __future__ import annotations

from typing import Any, Literal

from aiorts.late import dataclass

__all__ = ("ComponentDescription", "ParameterDescription", "PortDescription", "ServiceDescription")


@dataclass(frozen=True, slots=True)
class PortDescription:
    """A data port."""

    name: str
    direction: Literal["in", "out"]
    type: str
    """The name of a record type."""
    unit: str = ""
    doc: str = ""
    where: str = ""
    """File and line, for errors."""


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """A parameter; its fields are as for `aiorts.Param`."""

    name: str
    default: Any
    """A bool, int, float or str, or a tuple of one of them that is not empty; its type is the parameter's."""
    unit: str = ""
    doc: str = ""
    constraint: str = ""
    widget: str = ""
    where: str = ""
    """File and line, for errors."""


@dataclass(frozen=True, slots=True)
class ServiceDescription:
    """One interface of a service port."""

    name: str
    required: bool = False
    """Whether the component calls it; without, it answers."""
    port: str = ""
    """The name of its port, where that is another."""
    doc: str = ""
    where: str = ""
    """File and line, for errors."""


@dataclass(frozen=True, slots=True)
class ComponentDescription:
    """A component type."""

    name: str
    """Its name in the file; the new component is found by this name, too."""
    doc: str = ""
    ports: tuple[PortDescription, ...] = ()
    parameters: tuple[ParameterDescription, ...] = ()
    services: tuple[ServiceDescription, ...] = ()
    rate: float = 0.0
    """Hz of its context; 0 where none is given."""
    notes: tuple[str, ...] = ()
    """The parts of the file that are not carried over, a line each."""
