"""Two transports that reach each other over the loopback of this machine."""

from __future__ import annotations

import socket

from aiorts.links import Transport
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
