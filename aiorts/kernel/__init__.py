"""The microkernel: components, ports, connectors, what every context is. It knows no concrete context, transport,
format or command."""

from __future__ import annotations

from aiorts.kernel.bus import Bus
from aiorts.kernel.component import Component
from aiorts.kernel.connector import Connector
from aiorts.kernel.context import Context
from aiorts.kernel.kernel import Kernel
from aiorts.kernel.parameters import Param
from aiorts.kernel.ports import InPort, OutPort, Provided, Required, ServicePort
from aiorts.kernel.service_port import ServiceConnector

__all__ = (
    "Bus",
    "Component",
    "Connector",
    "Context",
    "InPort",
    "Kernel",
    "OutPort",
    "Param",
    "Provided",
    "Required",
    "ServiceConnector",
    "ServicePort",
)
