"""Ports: the typed ends of a stream or of calls. A class attribute is a declaration, on an instance the live port."""

from __future__ import annotations

from aiorts.kernel.in_port import InPort
from aiorts.kernel.out_port import OutPort
from aiorts.kernel.port import Port, Turns
from aiorts.kernel.service_ends import Provided, Required
from aiorts.kernel.service_port import Service, ServiceEnd, ServicePort

__all__ = ("InPort", "OutPort", "Port", "Provided", "Required", "Service", "ServiceEnd", "ServicePort", "Turns")
