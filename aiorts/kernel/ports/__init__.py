"""Ports: the typed ends of a stream, and the connectors between them.

A class attribute is a declaration, on an instance the live port. A room above adds a kind of port by deriving from
`PortDeclaration`, which says how it is declared, added and connected.
"""

from __future__ import annotations

from aiorts.kernel.ports.in_port import InPort
from aiorts.kernel.ports.out_port import OutPort
from aiorts.kernel.ports.port import Port, PortDeclaration, Turns
from aiorts.kernel.ports.waiting import wait_any

__all__ = ("InPort", "OutPort", "Port", "PortDeclaration", "Turns", "wait_any")
