"""Two transports that reach each other over the loopback of this machine."""

from __future__ import annotations

import socket
from typing import Any

from aiorts import Kernel
from aiorts.errors import LinkError
from aiorts.links import BaseTransport, Links, Peer, Transport
from aiorts_zenoh import NetworkSettings, ZenohTransport
from aiorts_zenoh.network import engine_settings


def free_port() -> int:
    """A port of the loopback that nobody has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def loopback() -> tuple[Transport, Transport]:
    """One that listens, and one that connects to it."""
    endpoint = f"127.0.0.1:{free_port()}"
    listens = NetworkSettings(listen=endpoint, insecure=True)
    connects = NetworkSettings(connect=endpoint, insecure=True)
    return (
        ZenohTransport("one.local", engine=engine_settings(listens)),
        ZenohTransport("two.local", engine=engine_settings(connects)),
    )


class _Alone(BaseTransport[Any]):
    """A transport that finds no kernel."""

    async def open(self, kernel: Any) -> None:
        self.begin(kernel)

    async def close(self) -> None:
        self.end_all()

    async def channel(self, offer: Any, events: Any) -> Any:
        raise LinkError("no kernel is reached here")

    async def ask(self, peer: Peer, what: str, body: bytes, *, within: float) -> bytes:
        raise LinkError("no kernel is reached here")


def by_network_alone(kernel: Kernel) -> None:
    """Have a kernel reach others by the network alone, as on a host of its own: sockets know no certificates."""
    kernel.service(Links).use(_Alone())
