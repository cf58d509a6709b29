"""The microkernel: components, ports, connectors, what every context is. It knows no concrete context, transport,
format or command.

Its names are imported when they are used: who only asks what plugins there are (`catalogue.py`) needs none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from aiorts.kernel.bus import Bus
    from aiorts.kernel.component import Component
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.parameters import Param
    from aiorts.kernel.ports import InPort, OutPort

__all__ = ("Bus", "Component", "Connector", "Context", "InPort", "Kernel", "OutPort", "Param")

_HOMES: Final = {
    "Bus": "bus",
    "Component": "component",
    "Connector": "connector",
    "Context": "context",
    "InPort": "ports",
    "Kernel": "kernel",
    "OutPort": "ports",
    "Param": "parameters",
}

# Hidden from type checkers, which would otherwise believe in every name.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return found
