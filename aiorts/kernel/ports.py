"""Data ports: the typed ends of a stream. A class attribute is a declaration, `bind` makes the live port."""

from __future__ import annotations

from aiorts.kernel.in_port import InPort
from aiorts.kernel.out_port import OutPort
from aiorts.kernel.port import Port, Turns

__all__ = ("InPort", "OutPort", "Port", "Turns")
