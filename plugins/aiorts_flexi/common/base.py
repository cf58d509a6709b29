"""The base class of the Flexi components: ports follow the parameters; tables describe the command line and the README.

`ports_for` of a component gives the ports for any values of its parameters, and `check_configuration` the results
derived from them. Both are computed before anything is changed, at its creation and while it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, cast

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import type_name
from aiorts_flexi.common.options import VERBOSITY, Option


class FlexiComponent(Component):
    """The base of the Flexi components, whose ports are made from parameters and change with them while they run."""

    options: ClassVar[tuple[Option, ...]] = (VERBOSITY,)
    """The options of its command line."""
    alone: ClassVar[Mapping[str, object]] = {"kind": "event"}
    """The context of a component that runs alone; without in-ports it sends from its own task, at its own pace."""
    interface: ClassVar[str] = ""
    """The names of the ports, for the documentation."""

    help_text: ClassVar[str] = ""
    """Further help for its command, with examples."""

    verbosity = Param(0, doc="how much is logged: 0 nothing, 1 the ports, 2 or more details")

    @property
    def in_line_order(self) -> bool:
        """Whether a filter feeds the in-ports in the order of its lines; each cycle then has to drain all of them."""
        return True

    _runs = False
    _logged: tuple[str, ...] = ()

    def on_initialize(self) -> None:
        self._runs = True
        self.log_ports()

    def make_ports(self) -> None:
        """Make the ports and nothing else, for tools that construct a component without running it."""
        values = {name: getattr(self, name) for name in self.params}
        for name, port in self.ports_for(values).items():
            if name not in self.ports:
                self.add_port(name, port)

    def taking(self, use: Callable[..., None], *worked_out: Any) -> Callable[[], None]:
        """A result for `check_configuration`: a function that calls `use` with derived values, then logs the ports."""
        return partial(self._take, use, worked_out)

    def _take(self, use: Callable[..., None], worked_out: tuple[Any, ...]) -> None:
        use(*worked_out)
        if self._runs and tuple(self.ports) != self._logged:
            self.log_ports()

    def in_port(self, name: str) -> InPort[Any]:
        """The in-port of that name."""
        return cast("InPort[Any]", self.ports[name])

    def out_port(self, name: str) -> OutPort[Any]:
        """The out-port of that name."""
        return cast("OutPort[Any]", self.ports[name])

    def log_ports(self) -> None:
        """Log the ports if `verbosity` asks for that; called after the ports are made."""
        self._logged = tuple(self.ports)
        if self.verbosity >= 1:
            # One line: the log folds further lines of the same template.
            ports = [f"{_direction(port)} {port.name}: {type_name(port.type)}" for port in self.ports.values()]
            self.log.info("ports: %s", ", ".join(ports))


def _direction(port: object) -> str:
    return "in-port" if isinstance(port, InPort) else "out-port"
