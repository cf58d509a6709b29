"""Taps: a service takes what an out-port writes, or gives an in-port samples, without being a part of the system.

A tap is a port of no component. `Port.connectors`, `Kernel.connectors`, profiles, supervision and the end of a run do
not know it: with a tap a system is what it is without. It reads and writes like any port, also across threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from aiorts.kernel.ports import wiring
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.host import PortHost
from aiorts.kernel.ports.in_port import InPort, receiver_of
from aiorts.kernel.ports.out_port import OutPort
from aiorts.kernel.ports.port import Turns, refresh

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.model.profile import ConnectorProfile


class Tap(InPort[Any]):
    """The reading end of a service. See `Connections.tap`."""

    __slots__ = ()
    is_tap = True


class Injector(OutPort[Any]):
    """The writing end of a service. See `Connections.inject`."""

    __slots__ = ()
    is_tap = True


def make_injector(kernel: KernelSide, owner: str, in_: InPort[Any], profile: ConnectorProfile) -> Connector:
    """Connect an out-port of its own to an in-port."""
    host = PortHost(owner, Turns())
    host.kernel = kernel
    injector = host.ports[in_.path] = Injector(in_.type)
    injector._attach(host, in_.path)
    return wiring.wire(kernel, injector, in_, profile)


def make_tap(
    kernel: KernelSide, owner: str, out: OutPort[Any], profile: ConnectorProfile, take: Callable[[InPort[Any]], object]
) -> Connector:
    """Connect a tap of its own to an out-port; `take` is called with it when there is something to read."""
    host = PortHost(owner, Turns())
    host.kernel = kernel
    tap = host.ports[out.path] = Tap(out.type)
    tap._attach(host, out.path)
    connector = wiring.wire(kernel, out, tap, profile)
    receiver_of(tap).add_callback(partial(_taken, take))
    return connector


def resize(connector: Connector, length: int) -> None:
    """Let a tap hold so many samples; the next write of a thread may still go by the length before."""
    transport_of(connector).length = length
    connector.profile = replace(connector.profile, length=length)
    refresh(connector.out)


def _taken(take: Callable[[InPort[Any]], object], tap: InPort[Any]) -> bool:
    take(tap)
    return True  # also the next sample is told
