"""Far ports: what stands in this kernel for a port of another one, as one end of an ordinary connector.

A service drains a far in-port and sends on what it reads, or writes at a far out-port what it received. The connector
is a part of the system like any other: it is in `Kernel.connectors`, in profiles, and has its options and its ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.errors import StateError
from aiorts.kernel.ports.host import PortHost
from aiorts.kernel.ports.in_port import InPort
from aiorts.kernel.ports.out_port import OutPort
from aiorts.kernel.ports.port import Port, Turns

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.model.names import Path


class FarInPort(InPort[Any]):
    """Stands for an in-port of another kernel: what is written to it is sent there."""

    __slots__ = ("far",)
    is_far = True
    far: Path
    """Which port it stands for; `path` may say it otherwise."""


class FarOutPort(OutPort[Any]):
    """Stands for an out-port of another kernel: what is received from there is written at it."""

    __slots__ = ("far", "held")
    is_far = True
    far: Path
    """Which port it stands for; `path` may say it otherwise."""
    held: Callable[[], int]
    """How many samples have come that are not written yet, since a reader has no room; set by the service."""


class RemoteInPort(InPort[Any]):
    """The in-port of a component that runs in another kernel: connecting it makes a far in-port and a link."""

    __slots__ = ("elsewhere",)

    def bind(self, host: PortHost, name: str) -> RemoteInPort:
        limits: dict[str, Any] = {"max_connectors": self.max_connectors, "length": self.length}
        port = RemoteInPort(self.type, unit=self.unit, shape=self.shape, doc=self.doc, **limits)
        port.elsewhere = None  # until its component has a process
        port._attach(host, name)
        return port

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The connectors of this kernel that end at the port."""
        return tuple(one for one in _connectors_of(self) if getattr(one.in_, "far", None) == self.elsewhere)

    def read_nowait(self) -> Any:
        raise _not_here(self)

    async def read(self, timeout: float | None = None) -> Any:
        raise _not_here(self)


class RemoteOutPort(OutPort[Any]):
    """The out-port of a component that runs in another kernel: connecting it makes a far out-port and a link."""

    __slots__ = ("elsewhere",)

    def bind(self, host: PortHost, name: str) -> RemoteOutPort:
        port = RemoteOutPort(
            self.type, unit=self.unit, shape=self.shape, doc=self.doc, max_connectors=self.max_connectors
        )
        port.elsewhere = None  # until its component has a process
        port._attach(host, name)
        return port

    @property
    def connectors(self) -> tuple[Connector, ...]:
        """The connectors of this kernel that begin at the port."""
        return tuple(one for one in _connectors_of(self) if getattr(one.out, "far", None) == self.elsewhere)

    def write_nowait(self, sample: Any) -> bool:
        raise _not_here(self)

    async def write(self, sample: Any) -> bool:
        raise _not_here(self)


def _connectors_of(port: Port[Any]) -> Iterable[Connector]:
    kernel = None if port._host is None else port._host.kernel
    return () if kernel is None or port.elsewhere is None else kernel.connections.connectors.values()


def _not_here(port: Port[Any]) -> StateError:
    return StateError(f"{port.path}: its component runs in a process of its own; connect the port with one of yours")


class FarPorts(Protocol):
    """Who makes far ports of paths."""

    def is_far(self, path: str) -> bool:
        """Whether this is the path of a port in another kernel."""
        ...

    @property
    def open_as(self) -> str:
        """The name by which other kernels reach this one; "" while they cannot."""
        ...

    async def ledger(self, connector: Connector) -> object:
        """What is counted of a connector at both ends; its text says it. LinkError: the other kernel says nothing."""
        ...

    def resolve(self, ports: Sequence[Any], options: Mapping[str, Any]) -> tuple[list[Any], Mapping[str, Any]]:
        """The ports, of data or of services, with a far one for each path of another kernel, and the options with
        what is usual there.

        Raises:
            WiringError: they do not go together.
        """
        ...


def far_port(
    kernel: KernelSide,
    like: Port[Any],
    path: Path,
    unit: str | None,
    shape: tuple[int, ...] | None,
    owner: str = "",
) -> FarInPort | FarOutPort:
    """What stands for the port of this path at the other end of a connector of `like`, a port of this kernel.

    Args:
        owner: the component of this kernel whose port it looks like; "" where it is that of another kernel.
    """
    host = PortHost(owner or str(replace(path, port="")), Turns())
    host.kernel = kernel
    kind = FarInPort if isinstance(like, OutPort) else FarOutPort
    port = kind(like.type, unit=unit, shape=shape)
    host.ports[path.port] = port
    port.far = path
    if isinstance(port, FarOutPort):
        port.held = _nothing
    port._attach(host, path.port)
    port._refresh()
    return port


def _nothing() -> int:
    return 0
