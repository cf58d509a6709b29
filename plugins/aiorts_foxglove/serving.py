"""The server: viewers come and go, and each gets the channels of one kernel that it wants."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping
from contextlib import aclosing, suppress
from http import HTTPStatus
from itertools import count
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError, MissingExtra, WireError
from aiorts.sessions import AsyncClient
from aiorts_foxglove import protocol
from aiorts_foxglove.admission import VIEWERS, refusal
from aiorts_foxglove.channels import Channel, Kind
from aiorts_foxglove.source import Source
from aiorts_foxglove.viewer import Viewer

if TYPE_CHECKING:
    from websockets.asyncio.server import Server as Listening
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

HOST: Final = "127.0.0.1"
_GOODBYE: Final = 1.0
"""Seconds that viewers have to take the last line."""


class Serving:
    """The server's state: the kernel that is shown, and its viewers. It is the audience of one source at a time.

    Args:
        origins: pages that may connect, in addition to those of this machine.
        say: takes lines for the user of the command.
    """

    def __init__(self, origins: Collection[str], say: Callable[[str], None]) -> None:
        self._origins = origins
        self._say = say
        self._said: set[str] = set()
        self._viewers: set[Viewer] = set()
        self._session = ("aiorts", "0")
        self._channels: dict[int, Channel] = {}
        self._by_port: dict[str, Channel] = {}
        self._numbers = count(1)
        self._troubles: dict[str, tuple[int, str]] = {}
        """The lines that every viewer shows, by key."""
        self._source: Source | None = None

    # -- the kernel ------------------------------------------------------------------------------------------------

    async def show(self, client: AsyncClient) -> str:
        """Show a kernel until it ends, and close the session; return why the kernel ended."""
        async with aclosing(client):
            self._session = client.entry.name, client.entry.epoch
            self._trouble("kernel", "")
            self._source = source = Source(client, self)
            self._show()
            try:
                return await source.run()
            finally:
                self._source = None
                self.ports({})

    def gone(self, text: str) -> None:
        """Tell all viewers, also those that come later, that the kernel is not there."""
        self._trouble("kernel", text, protocol.ERROR)

    def ports(self, found: Mapping[str, Kind]) -> None:
        """See `Audience`. An unchanged port keeps its channel."""
        before = self._by_port
        self._by_port = {
            port: before[port]
            if port in before and before[port].kind == kind
            else Channel(next(self._numbers), port, kind)
            for port, kind in found.items()
        }
        for key in [key for key in self._troubles if key.startswith("port ")]:
            self._trouble(key, "")
        if self._by_port != before:
            self._channels = {one.number: one for one in self._by_port.values()}
            self._show()
            self._watch()

    def sample(self, port: str, time_ns: int, payload: bytes) -> None:
        """See `Audience`."""
        if (channel := self._by_port.get(port)) is not None:
            for viewer in self._viewers:
                if channel.number in viewer.wanted:
                    viewer.offer(channel.number, time_ns, payload)
        self.time(time_ns)

    def lost(self, port: str, count: int) -> None:
        """See `Audience`."""
        if (channel := self._by_port.get(port)) is not None:
            for viewer in self._viewers:
                if channel.number in viewer.wanted:
                    viewer.lose(count)

    def time(self, time_ns: int) -> None:
        """See `Audience`."""
        for viewer in self._viewers:
            viewer.show_time(time_ns)

    def trouble(self, about: str, text: str) -> None:
        """See `Audience`."""
        name = about or self._session[0]
        self._trouble(f"port {about}" if about else "kernel", text and f"{name}: {text.removeprefix(f'{name}: ')}")

    def _trouble(self, key: str, text: str, level: int = protocol.WARNING) -> None:
        if self._troubles.get(key) == (level, text):
            return
        if text:
            self._troubles[key] = level, text
        else:
            self._troubles.pop(key, None)
        for viewer in self._viewers:
            viewer.say(key, level, text)

    def _show(self) -> None:
        for viewer in self._viewers:
            viewer.show(self._session, self._channels)

    def _watch(self) -> None:
        """Take samples of the channels that any viewer wants, and of no others."""
        if self._source is not None:
            wanted = {number for viewer in self._viewers for number in viewer.wanted}
            self._source.watch(frozenset(self._channels[number].port for number in wanted & self._channels.keys()))

    # -- viewers ---------------------------------------------------------------------------------------------------

    async def listen(self, port: int) -> Listening:
        """Listen for viewers.

        Raises:
            MissingExtra: websockets is not installed.
            ConfigurationError: the port is taken.
        """
        try:
            from websockets.asyncio.server import serve
        except ImportError:
            raise MissingExtra("aiorts foxglove", "websockets", "foxglove") from None
        from websockets.typing import Subprotocol

        try:
            return await serve(
                self._attend,
                HOST,
                port,
                subprotocols=[Subprotocol(name) for name in protocol.SUBPROTOCOLS],
                process_request=self._admit,
                compression=None,
                max_size=protocol.REQUEST,
                logger=_silent(),
            )
        except OSError as error:
            raise ConfigurationError(f"--port {port}: {error.strerror or error}") from None

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if why := refusal(hosts, origins, self._origins):
            if why not in self._said and len(self._said) < VIEWERS:
                self._said.add(why)
                self._say(f"refused a viewer: {why}")
            return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
        if len(self._viewers) >= VIEWERS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{VIEWERS} viewers are connected already\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        viewer = Viewer()
        viewer.show(self._session, self._channels)
        for key, (level, text) in self._troubles.items():
            viewer.say(key, level, text)
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send(connection, viewer), name="foxglove viewer")
        try:
            with suppress(ConnectionClosed):
                async for message in connection:
                    self._take(viewer, message)
        finally:
            self._viewers.discard(viewer)
            self._watch()
            sending.cancel()
            with suppress(asyncio.CancelledError):
                await sending

    def _take(self, viewer: Viewer, message: str | bytes) -> None:
        try:
            request = protocol.request_in(message)
        except WireError as error:
            viewer.say("request", protocol.ERROR, str(error))
            return
        if isinstance(request, protocol.Subscribe):
            viewer.subscribe(request.wanted)
        else:
            viewer.unsubscribe(request.subscriptions)
        self._watch()


async def _send(connection: ServerConnection, viewer: Viewer) -> None:
    from websockets.exceptions import ConnectionClosed

    with suppress(ConnectionClosed):
        async for message in viewer.messages():
            await connection.send(message)


async def goodbye(listening: Listening) -> None:
    """Give viewers time for the last line, and close; a viewer that does not read is cut off."""
    if viewers := tuple(listening.connections):
        await asyncio.sleep(_GOODBYE)
    listening.close()
    with suppress(TimeoutError):
        async with asyncio.timeout(_GOODBYE):
            await listening.wait_closed()
    for connection in viewers:
        connection.transport.abort()


def _silent() -> Any:
    """A silent logger for errors of viewers: a scanner of ports must not fill the terminal."""
    import logging

    logger = logging.getLogger("aiorts.foxglove")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger
