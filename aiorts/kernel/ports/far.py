"""Far ports: stand-ins for ports of other kernels, each as one end of an ordinary connector of this kernel.

A service drains a far in-port and sends on what it reads, or writes at a far out-port what it received. The connector
is a part of the system like any other: it is in `Kernel.connectors`, in profiles, and has its options and its ledger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.errors import StateError, WiringError
from aiorts.kernel.ports.host import PortHost
from aiorts.kernel.ports.in_port import InPort
from aiorts.kernel.ports.out_port import OutPort
from aiorts.kernel.ports.port import Port, Turns
from aiorts.model.names import Path

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.kernel.ports.host import KernelSide


class FarInPort(InPort[Any]):
    """A stand-in for an in-port of another kernel: a sample written to it is sent there."""

    __slots__ = ("far",)
    is_far = True
    far: Path
    """The path of the port that it stands for; its own `path` may differ."""


class FarOutPort(OutPort[Any]):
    """A stand-in for an out-port of another kernel: a sample received from there is written at it."""

    __slots__ = ("clock", "far", "held")
    is_far = True
    far: Path
    """The path of the port that it stands for; its own `path` may differ."""
    held: Callable[[], int]
    """A function, set by the service, that counts the received samples not written yet for lack of room at a reader."""
    clock: tuple[int, int] | None
    """How far the writer's clock is ahead of this kernel's, and the error of that value, both in ns; None: one clock.
    Set by the service."""


class RemoteInPort(InPort[Any]):
    """The in-port of a component that runs in another kernel: connecting it makes a far in-port and a link."""

    __slots__ = ("elsewhere",)
    elsewhere: Path | None

    def bind(self, host: PortHost, name: str) -> RemoteInPort:
        limits: dict[str, Any] = {"max_connectors": self.max_connectors, "length": self.length}
        port = RemoteInPort(self.type, unit=self.unit, shape=self.shape, doc=self.doc, **limits)
        port.elsewhere = getattr(self, "elsewhere", None)
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
    elsewhere: Path | None

    def bind(self, host: PortHost, name: str) -> RemoteOutPort:
        port = RemoteOutPort(
            self.type, unit=self.unit, shape=self.shape, doc=self.doc, max_connectors=self.max_connectors
        )
        port.elsewhere = getattr(self, "elsewhere", None)
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


class FarLedger(Protocol):
    """The counts of both ends of a connector; `str()` shows them."""

    @property
    def buffered(self) -> int:
        """Samples that wait at either end: to be sent, or to be read."""
        ...

    @property
    def read(self) -> Mapping[str, Sequence[int]] | None:
        """The measured ages of samples when they were read; None: the reader's end reports no ages."""
        ...


class FarPorts(Protocol):
    """The maker of far ports from paths."""

    def is_far(self, path: str) -> bool:
        """Whether `path` names a port in another kernel."""
        ...

    def open_as(self, *, elsewhere: bool) -> str:
        """The name by which other kernels, of this host or elsewhere, reach this one; "" while they cannot."""
        ...

    async def ledger(self, connector: Connector) -> FarLedger:
        """The counts of both ends of a connector. LinkError: the other kernel does not answer."""
        ...

    def resolve(self, ports: Sequence[Any], options: Mapping[str, Any]) -> tuple[list[Any], Mapping[str, Any]]:
        """The ports, of data or of services, with a far port for each path of another kernel, and the options with the
        defaults of links.

        Raises:
            WiringError: the ports do not go together.
        """
        ...

    def connector_made(self, connector: Connector) -> None:
        """Make the link of a connector with a far port."""
        ...

    def connector_ended(self, connector: Connector) -> None:
        """End the link of a connector that has ended."""
        ...


def far_ends(kernel: KernelSide, where: str, ports: Sequence[Any]) -> list[Any]:
    """These ports, with a stand-in in place of each port of another kernel.

    Args:
        ports: ports, and paths of ports in other kernels; where two of them are connected already, their far port is
            used again.

    Raises:
        WiringError: the ports do not go together.
    """
    known = [port for port in ports if not isinstance(port, str)]
    near = [port for port in known if port.elsewhere is None]
    if not known:
        raise WiringError(f"{where}: one of the ports must be in this process; connect them from one of theirs")
    directions = {port.direction for port in near or known}
    if near and (len(directions) > 1 or any(port.direction in directions for port in known if port.elsewhere)):
        raise WiringError(f"{where}: connect ports of this kernel and those of other kernels one after the other")
    if near:
        return [port if port in near else _far_end(kernel, near[0], port) for port in ports]
    if len(ports) != 2 or len(directions) != len(known):
        raise WiringError(f"{where}: expected one out-port and one in-port, since both are in other kernels")
    one, two = ports if ports[0] in known else ports[::-1]
    path = _path(two)
    for connector in one.connectors:
        here, there = (connector.out, connector.in_) if one.direction == "out" else (connector.in_, connector.out)
        if getattr(there, "far", None) == path:
            return [here if port is one else there for port in ports]
    return [stand_in(kernel, port) if port in known else _far_end(kernel, one, port) for port in ports]


def _far_end(kernel: KernelSide, like: InPort[Any] | OutPort[Any], given: str | Port[Any]) -> Port[Any]:
    """The stand-in for a port of another kernel: a stand-in already connected with `like`, else a new one."""
    path = _path(given)
    if not path.port:
        raise WiringError(f"{given}: is a component; give one of its ports")
    others = [one.in_ if isinstance(like, OutPort) else one.out for one in like.connectors]
    for port in others:
        if isinstance(port, FarInPort | FarOutPort) and port.far == path:
            return port
    if isinstance(given, str):
        return far_port(kernel, like, path, like.unit, like.shape)
    made = far_port(kernel, like, path, given.unit, given.shape, given.path)
    return _as_long(made, given)


def _path(port: str | Port[Any]) -> Path:
    """The path by which all kernels find a port that is in another kernel."""
    if isinstance(port, str):
        return Path.parse(port)
    assert port.elsewhere is not None  # noqa: S101 - else it is in this kernel
    return port.elsewhere


def far_port(
    kernel: KernelSide,
    like: Port[Any],
    path: Path,
    unit: str | None,
    shape: tuple[int, ...] | None,
    shown: str = "",
) -> FarInPort | FarOutPort:
    """The stand-in for the port of this path, as the other end of a connector of `like`, a port of this kernel.

    Args:
        shown: the path that the stand-in shows, if it is a path of this kernel; "" shows `path`.
    """
    kind = FarInPort if isinstance(like, OutPort) else FarOutPort
    return _made(kernel, kind(like.type, unit=unit, shape=shape), path, shown or str(path))


def stand_in(kernel: KernelSide, port: Port[Any]) -> FarInPort | FarOutPort:
    """A new stand-in for a port in another kernel; the connector's other end belongs to no component of this kernel."""
    kind = FarInPort if isinstance(port, InPort) else FarOutPort
    made = kind(port.type, unit=port.unit, shape=port.shape)
    return _as_long(_made(kernel, made, _path(port), port.path), port)


def _as_long(made: FarInPort | FarOutPort, port: Port[Any]) -> FarInPort | FarOutPort:
    """The stand-in `made`; if it is an in-port, it now has the connector length that `port` declares."""
    if isinstance(made, InPort) and isinstance(port, InPort):
        made.length = port.length
    return made


def _made(kernel: KernelSide, port: FarInPort | FarOutPort, path: Path, shown: str) -> FarInPort | FarOutPort:
    owner, _, name = shown.rpartition(".")
    host = PortHost(owner, Turns())
    host.kernel = kernel
    host.ports[name] = port
    port.far = path
    if isinstance(port, FarOutPort):
        port.held = _nothing
    port._attach(host, name)
    port._refresh()
    return port


def _nothing() -> int:
    return 0
