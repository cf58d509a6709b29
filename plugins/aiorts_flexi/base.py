"""What all Flexi components share: ports that follow the parameters, and the tables of command line and documentation.

A component says in `ports_for` which ports it has for which values, and in `check_configuration` what it makes of
them; both are worked out before anything is changed, while it runs as when it is made.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, cast

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import type_name
from aiorts_flexi.options import VERBOSITY, Option

__all__ = ("FlexiComponent",)


class FlexiComponent(Component):
    """Base of the Flexi components: their ports are made of parameters, and change with them while they run."""

    options: ClassVar[tuple[Option, ...]] = (VERBOSITY,)
    """What a command line offers."""
    interface: ClassVar[str] = ""
    """The names of the ports, as documentation shows them."""

    help_text: ClassVar[str] = ""
    """What the help of its command says besides, with examples."""

    verbosity = Param(0, doc="how much is logged: 0 nothing, 1 the ports, 2 or more details")

    @property
    def in_line_order(self) -> bool:
        """Whether a filter feeds the in-ports in the order of its lines: each cycle takes all that they have."""
        return True

    _runs = False
    _told: tuple[str, ...] = ()

    def on_initialize(self) -> None:
        self._runs = True
        self.tell_ports()

    def make_ports(self) -> None:
        """Make the ports, and nothing else: for tools that construct a component and run nothing."""
        values = {name: getattr(self, name) for name in self.params}
        for name, port in self.ports_for(values).items():
            if name not in self.ports:
                self.add_port(name, port)

    def taking(self, use: Callable[..., None], *worked_out: Any) -> Callable[[], None]:
        """What `check_configuration` returns: `use` with what was worked out, and then the ports are told."""
        return partial(self._take, use, worked_out)

    def _take(self, use: Callable[..., None], worked_out: tuple[Any, ...]) -> None:
        use(*worked_out)
        if self._runs and tuple(self.ports) != self._told:
            self.tell_ports()

    def in_port(self, name: str) -> InPort[Any]:
        """The in-port of that name."""
        return cast("InPort[Any]", self.ports[name])

    def out_port(self, name: str) -> OutPort[Any]:
        """The out-port of that name."""
        return cast("OutPort[Any]", self.ports[name])

    def tell_ports(self) -> None:
        """Log the ports when that is asked for; called once they are made."""
        self._told = tuple(self.ports)
        if self.verbosity >= 1:
            # One line: the log folds what follows by the same template.
            ports = [f"{_direction(port)} {port.name}: {type_name(port.type)}" for port in self.ports.values()]
            self.log.info("ports: %s", ", ".join(ports))


def _direction(port: object) -> str:
    return "in-port" if isinstance(port, InPort) else "out-port"
