"""Taps: a service takes what an out-port writes, or gives an in-port samples, without being a part of the system.

A tap is a port of no component. `Port.connectors`, `Kernel.connectors`, profiles, supervision and the end of a run do
not show taps: a system is the same with a tap and without. A tap reads and writes like any port, also across threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from aiorts.kernel.ports import wiring
from aiorts.kernel.ports.connector import transport_of
from aiorts.kernel.ports.far import stand_in
from aiorts.kernel.ports.host import PortHost
from aiorts.kernel.ports.in_port import InPort, receiver_of
from aiorts.kernel.ports.out_port import OutPort
from aiorts.kernel.ports.port import Port, Turns, refresh
from aiorts.model.policy import OnLinkLost, Push, Subscription

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.model.profile import ConnectorProfile

_NUMBERS: Final = count(1)
"""The numbers that make the names of taps' connectors over links unique: both kernels find a connector by its name."""


class Tap(InPort[Any]):
    """The in-port by which a service reads what an out-port writes. See `Connections.tap`."""

    __slots__ = ()
    is_tap = True


class Injector(OutPort[Any]):
    """The out-port by which a service writes to an in-port. See `Connections.inject`."""

    __slots__ = ()
    is_tap = True


def make_injector(kernel: KernelSide, owner: str, in_: InPort[Any], profile: ConnectorProfile) -> Connector:
    """Connect a new out-port of a service to an in-port."""
    host = PortHost(owner, Turns())
    host.kernel = kernel
    injector, name, end = Injector(in_.type), in_.path, in_
    if in_.elsewhere is not None:
        end, profile, name = _beyond(kernel, in_, profile)
    host.ports[name] = injector
    injector._attach(host, name)
    return wiring.wire(kernel, injector, end, profile)


def make_tap(
    kernel: KernelSide, owner: str, out: OutPort[Any], profile: ConnectorProfile, take: Callable[[InPort[Any]], object]
) -> Connector:
    """Connect a new tap to an out-port; `take` is called with the tap when there is a sample to read."""
    host = PortHost(owner, Turns())
    host.kernel = kernel
    tap, name, end = Tap(out.type), out.path, out
    if out.elsewhere is not None:
        end, profile, name = _beyond(kernel, out, profile)
    host.ports[name] = tap
    tap._attach(host, name)
    connector = wiring.wire(kernel, end, tap, profile)
    receiver_of(tap).add_callback(partial(_taken, take))
    return connector


def _beyond(kernel: KernelSide, port: Port[Any], profile: ConnectorProfile) -> tuple[Any, ConnectorProfile, str]:
    """A stand-in for a port in another process, the options of a connector to it, and a unique name for the tap."""
    number = str(next(_NUMBERS))
    end = stand_in(kernel, port)
    linked = replace(
        profile,
        name=f"{profile.name}-{number}",
        subscription=Subscription.NEW,
        push=Push.ALL,
        on_link_lost=OnLinkLost.WAIT,
        far_end="writer" if isinstance(end, OutPort) else "reader",
    )
    return end, linked, number


def resize(connector: Connector, length: int) -> None:
    """Set how many samples a tap holds; a thread's next write may still use the former length."""
    transport_of(connector).length = length
    connector.profile = replace(connector.profile, length=length)
    refresh(connector.out)


def _taken(take: Callable[[InPort[Any]], object], tap: InPort[Any]) -> bool:
    take(tap)
    return True  # the next sample notifies, too
