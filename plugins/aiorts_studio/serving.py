"""The server: it listens, and answers until its end."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError
from aiorts_studio.guard import BODY, App

if TYPE_CHECKING:
    import uvicorn

HOST: Final = "127.0.0.1"
_LAST: Final = 1
"""Seconds that answers under way have at the end."""
_HEAD: Final = 16 << 10
"""Bytes of the head of a request."""
_PING: Final = 20.0
"""Seconds between signs of life of a WebSocket, and seconds that its client has to answer one."""


def bound(host: str, port: int) -> socket.socket:
    """A socket bound to host and port, which listens once it is served.

    Raises:
        ConfigurationError: the port is taken, or the address is none of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        # asyncio sets TCP_NODELAY only where a socket names TCP as its protocol: else a request took 44 ms, not 2.5.
        bound.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        raise ConfigurationError(f"{host}, --port {port}: {error.strerror or error}") from None
    return bound


def secured(certificates: Path, name: str, address: str) -> tuple[ssl.SSLContext, list[str]]:
    """The TLS context of the server, and the addresses that its certificate is for.

    Raises:
        ConfigurationError: the folder has no certificate of this name that is good, or it is for other addresses.
    """
    from aiorts_zenoh.security.folder import Folder

    folder = Folder(certificates)
    identity, addresses = folder.identity(name), folder.facts(name).addresses
    if address not in addresses:
        advice = f"aiorts certs issue {name} --address {address}"
        raise ConfigurationError(f"{identity.certificate}: is not for {address}; {advice}")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(identity.certificate, identity.key)
    return context, [address, *(one for one in addresses if one != address)]


@asynccontextmanager
async def served(listening: socket.socket, app: App, secured: ssl.SSLContext | None = None) -> AsyncIterator[None]:
    """Serve an application for as long as the block takes.

    Args:
        listening: a bound socket; it is closed at the end.
        secured: the certificate of the server, for TLS.
    """
    import uvicorn

    from aiorts_studio.connections import Connection, Socket

    _log()
    waiting: dict[Connection, None] = {}
    config = uvicorn.Config(
        app,
        http=partial(Connection, waiting=waiting),  # type: ignore[arg-type] # made as the class is
        ws=Socket,
        ws_max_size=BODY,
        ws_max_queue=8,
        ws_ping_interval=_PING,
        ws_ping_timeout=_PING,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=_LAST,
        h11_max_incomplete_event_size=_HEAD,
        ssl_context_factory=None if secured is None else lambda *_: secured,
    )
    server = _server(config)
    serving = asyncio.create_task(server.serve([listening]), name="studio server")
    try:
        await server.begun.wait()
        yield
    finally:
        server.over.set()
        await serving
        listening.close()


def _server(config: uvicorn.Config) -> Any:
    import uvicorn

    class Server(uvicorn.Server):
        """A server that waits for its end, where uvicorn looks ten times a second, and leaves signals to its caller."""

        def __init__(self, config: uvicorn.Config) -> None:
            super().__init__(config)
            self.begun, self.over = asyncio.Event(), asyncio.Event()

        @contextmanager
        def capture_signals(self) -> Iterator[None]:
            yield

        async def main_loop(self) -> None:
            self.begun.set()
            await self.over.wait()

    return Server(config)


def _log() -> None:
    """Show errors of this server, and not those of clients."""
    logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
