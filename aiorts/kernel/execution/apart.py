"""The check that the writer and the reader of a connector with `length = 0` run in different contexts.

Members of a context run one after the other, so a write that waits for its reader there waits for itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from aiorts.errors import StateError, WiringError
from aiorts.kernel.ports import InPort, OutPort
from aiorts.kernel.ports.port import host_of

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.kernel.ports.connector import Connector


class Ported(Protocol):
    """A component: a name and ports."""

    @property
    def name(self) -> str: ...
    @property
    def ports(self) -> Mapping[str, Port[Any]]: ...


def check_connection(out: OutPort[Any], in_: InPort[Any]) -> None:
    """Raise WiringError when a write of `out` that waits for a read of `in_` would wait for itself."""
    writer: Any = host_of(out)
    reader: Any = host_of(in_)
    shared = [one.context.name for one in writer.members if one.context in {other.context for other in reader.members}]
    if writer is reader:
        where = f"both are ports of {writer.name}"
    elif shared:
        where = f"both run in {shared[0]}"
    elif writer.group is not None and reader.group is not None and writer.group.root is reader.group.root:
        where = f"both are members of {writer.group.root.name}"
    else:
        return
    raise WiringError(
        f"{out.path} -> {in_.path}: length = 0: the write would wait for a read that cannot begin before it is done: "
        f"{where}; run one of them in another context, or set length = 1 or more"
    )


def check_apart(components: Sequence[Ported], others: Iterable[Ported], where: str) -> None:
    """Raise StateError when a connector with `length = 0` joins one of `components` to another, or to `others`."""
    hosts: set[object] = set()
    for component in components:
        for connector in _rendezvous_of(component):
            hosts = hosts or {host_of(port) for one in (*components, *others) for port in one.ports.values()}
            if host_of(connector.out) in hosts and host_of(connector.in_) in hosts:
                raise StateError(
                    f"{component.name}: cannot run in {where}: the connector {connector.name} has length = 0, so a "
                    f"write of {connector.out.path} would wait for a read of {connector.in_.path}, which cannot begin "
                    "before it is done; run one of them in another context, or connect with length = 1 or more"
                )


def _rendezvous_of(component: Ported) -> Iterator[Connector]:
    for port in component.ports.values():
        if isinstance(port, InPort | OutPort):
            for connector in port.connectors:
                if not connector.profile.length:
                    yield connector
