"""Connections of the server, bounded: in number, and in the time that a client may need to ask and to read.

The connections of uvicorn itself wait without a limit for a request, and for a client that does not read.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

REQUEST_SECONDS: Final = 10.0
"""Seconds within which the head of a request has to be there."""
STALL_SECONDS: Final = 30.0
"""Seconds after which a client that does not take what is sent is cut off."""
WAITING: Final = 128
"""The most connections without a whole request; for another one the oldest is closed."""


class _Reading(asyncio.Protocol):
    """A mixin of protocols: a client that does not read is cut off."""

    transport: Any
    loop: Any
    _stalled: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Start the time-out of a client that does not read."""
        super().pause_writing()
        self._stalled = self.loop.call_later(STALL_SECONDS, self.transport.abort)

    def resume_writing(self) -> None:
        """End the time-out: the client reads again."""
        super().resume_writing()
        self._forget()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the time-out: the client has gone."""
        self._forget()
        super().connection_lost(exc)

    def _forget(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None


class Socket(_Reading, WebSocketsSansIOProtocol):
    """A WebSocket."""


class Connection(_Reading, H11Protocol):
    """A connection that takes one request after the other.

    Args:
        waiting: the connections of this server that have no whole request; each puts itself there.
    """

    def __init__(self, *args: Any, waiting: dict[Connection, None], **options: Any) -> None:
        super().__init__(*args, **options)
        self._waiting = waiting
        self._late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._look()

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self._look()

    def on_response_complete(self) -> None:
        """Begin to wait for the next request."""
        super().on_response_complete()
        self._look()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the wait for a request: the client has gone."""
        self._wait_no_more()
        super().connection_lost(exc)

    def _look(self) -> None:
        """Check whether the connection waits for a request, or for the rest of one."""
        state = self.conn.their_state
        if state not in (h11.IDLE, h11.SEND_BODY) or self.transport.get_protocol() is not self:
            self._wait_no_more()
        elif not self.transport.is_closing():
            self._waiting[self] = None
            if len(self._waiting) > WAITING:
                next(iter(self._waiting))._give_way()
            if state is h11.SEND_BODY:  # the guard has a limit of its own for that, and says so
                self._hurry_no_more()
            elif self._late is None:
                self._late = self.loop.call_later(REQUEST_SECONDS, self.transport.abort)

    def _give_way(self) -> None:
        self._wait_no_more()  # its loss is reported later, and more may come until then
        self.transport.abort()

    def _wait_no_more(self) -> None:
        self._waiting.pop(self, None)
        self._hurry_no_more()

    def _hurry_no_more(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None
