"""What all Flexi components share: a verbosity, and the tables from which command line and documentation are made."""

from __future__ import annotations

from typing import ClassVar

from aiorts import Component, InPort, Param
from aiorts.types import type_name
from aiorts_flexi.options import VERBOSITY, Option

__all__ = ("FlexiComponent",)


class FlexiComponent(Component):
    """Base of the Flexi components: their ports are made of parameters when they are created, and stay."""

    options: ClassVar[tuple[Option, ...]] = (VERBOSITY,)
    """What a command line offers."""
    interface: ClassVar[str] = ""
    """The names of the ports, as documentation shows them."""

    help_text: ClassVar[str] = ""
    """What the help of its command says besides, with examples."""

    verbosity = Param(0, doc="how much is logged: 0 nothing, 1 the ports, 2 or more details")

    def make_ports(self) -> None:
        """Make the ports that the parameters ask for.

        It has no other effect: tools call it for a component that belongs to no kernel, and no hook of which ever runs.

        Raises:
            ConfigurationError: the parameters do not go together; a TypedTextError has the place.
        """

    def tell_ports(self) -> None:
        """Log the ports when that is asked for; called once they are made."""
        if self.verbosity >= 1:
            # One line: the log folds what follows by the same template.
            ports = [f"{_direction(port)} {port.name}: {type_name(port.type)}" for port in self.ports.values()]
            self.log.info("ports: %s", ", ".join(ports))


def _direction(port: object) -> str:
    return "in-port" if isinstance(port, InPort) else "out-port"
