"""The microkernel: components, ports, connectors, what every context is. It knows no concrete context, transport,
format or command.

Its names are imported when they are used: who only asks what plugins there are (`extensions/catalogue.py`) needs none
of them.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.connection import Connection
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Wait
    from aiorts.kernel.loop.bus import Bus
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.parameters import Param
    from aiorts.kernel.ports import InPort, OutPort, wait_any
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.service import KernelService, check_settings, setting

__all__ = (
    "Bus",
    "Component",
    "Connection",
    "Connector",
    "Context",
    "InPort",
    "KernelService",
    "Microkernel",
    "OutPort",
    "Param",
    "Wait",
    "check_settings",
    "setting",
    "wait_any",
)

late()
