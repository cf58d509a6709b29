"""The thread that serves a kernel's socket: it decodes, checks and sends, and hands calls over to the loop.

The loop is disturbed by whole calls only, at most `CALLS_PER_SECOND` of each client. In simulated time calls are
carried out between two instants: neither the socket nor a client that waits holds time.
"""

from __future__ import annotations

import os
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.server.connection import Connection, peer_credentials
from aiorts.control.session import LOG, Session
from aiorts.errors import BusyError, format_error

if TYPE_CHECKING:
    from aiorts.control.folder import Claim
    from aiorts.kernel.microkernel import Microkernel

_CLIENTS: Final = 64
"""At most; the oldest that has not said hello makes room for another."""
_TICK: Final = 1.0
"""Seconds between two looks at clients that are overdue."""


class Listener:
    """Serves the socket of one kernel until `close()`.

    Args:
        kernel: open.
        claim: the socket that listens, and the kernel's entry.
        right: what clients may do.
        hello: what the kernel says of itself.
    """

    def __init__(self, kernel: Microkernel, claim: Claim, right: Right, hello: Mapping[str, Any]) -> None:
        self.right = right
        self.hello = hello
        self.epoch = claim.entry.epoch
        self._kernel = kernel
        self._listener = claim.listener
        self._listener.setblocking(False)
        self._connections: set[Connection] = set()
        self._outbox: deque[tuple[Connection, Mapping[str, Any], Callable[[], None]]] = deque()
        self._awake = False
        """Whether the thread has been told to look."""
        self._ended = False
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        loop: Any = kernel.loop
        self._hand_over: Callable[[Callable[[], None]], object] = getattr(
            loop, "call_between_instants", loop.call_soon_threadsafe
        )
        self._thread = threading.Thread(target=self._serve, name=f"aiorts control {kernel.name}", daemon=True)
        self._thread.start()

    @property
    def operations(self) -> Mapping[str, Operation]:
        """The table; read when the first client comes."""
        from aiorts.control.operations import OPERATIONS

        return OPERATIONS

    # -- from the loop ---------------------------------------------------------------------------------------------

    def put(self, connection: Connection, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send a message to a client. From any thread."""
        self._outbox.append((connection, message, sent))
        self._wake()

    def end_sessions(self) -> None:
        """Undo what lasts as long as sessions do. On the loop."""
        for connection in tuple(self._connections):
            if connection.session is not None:
                connection.session.finish()

    def close(self, timeout: float) -> None:
        """Send what waits, end all sessions and the thread, within `timeout` seconds. On the loop."""
        self.end_sessions()
        self._ended = True
        self._wake()
        self._thread.join(timeout)

    def _wake(self) -> None:
        if not self._awake:
            self._awake = True
            try:
                self._wake_in.send(b"\0")
            except OSError:
                return  # full, so it wakes; or closed, so it has ended

    # -- the thread ------------------------------------------------------------------------------------------------

    def hand_over(self, call: Callable[[], None]) -> None:
        """Have the loop carry out a call."""
        try:
            self._hand_over(call)
        except RuntimeError:
            self._ended = True  # the loop is closed

    def greeted(self, connection: Connection, who: str) -> Session:
        """A client has said hello: its session."""
        return Session(self._kernel, self.right, who, connection.put)

    def _serve(self) -> None:
        try:
            with selectors.DefaultSelector() as selector:
                selector.register(self._listener, selectors.EVENT_READ)
                selector.register(self._wake_out, selectors.EVENT_READ)
                while not self._ended:
                    self._turn(selector)
                self._deliver()
        except Exception as error:  # noqa: BLE001 - the system goes on without it
            LOG.error("the socket is served no longer: %s", format_error(error), exc_info=error)
        finally:
            for connection in tuple(self._connections):
                self._end(connection)
            self._wake_in.close()
            self._wake_out.close()

    def _turn(self, selector: selectors.BaseSelector) -> None:
        for key, _ in selector.select(self._patience()):
            if key.fileobj is self._listener:
                self._accept(selector)
            elif key.fileobj is self._wake_out:
                self._hear()
            elif isinstance(key.data, Connection):
                if key.data.has_more:
                    key.data.write()
                if key.data.takes:
                    key.data.read()
        self._deliver()
        now = time.monotonic()
        for connection in tuple(self._connections):
            if connection.resumes_at is not None:
                connection.work()
            if connection.over_at is not None and now >= connection.over_at:
                connection.closed = True
            _watch(selector, connection)
            if connection.closed:
                self._end(connection)

    def _patience(self) -> float:
        """Seconds until something is due although nothing comes."""
        resumes = [one.resumes_at for one in self._connections]
        due = min((at for at in resumes if at is not None), default=None)
        return _TICK if due is None else min(_TICK, max(0.0, due - time.monotonic()))

    def _hear(self) -> None:
        self._awake = False
        try:
            self._wake_out.recv(64)
        except BlockingIOError:
            return

    def _deliver(self) -> None:
        while self._outbox:
            connection, message, sent = self._outbox.popleft()
            if connection.closed:
                sent()
                continue
            try:
                connection.queue(message, sent)
            except Exception as error:  # noqa: BLE001 - a result that cannot be sent harms its own client only
                LOG.error("an answer could not be sent: %s", format_error(error), exc_info=error)
                connection.closed = True

    def _accept(self, selector: selectors.BaseSelector) -> None:
        try:
            connected, _ = self._listener.accept()
        except OSError:
            return
        credentials = peer_credentials(connected)
        if credentials is not None and credentials[1] != os.geteuid():
            LOG.warning("a client of user %d was refused", credentials[1])
            connected.close()
            return
        connected.setblocking(False)
        connection = Connection(self, connected)
        if len(self._connections) >= _CLIENTS:
            strangers = [one for one in self._connections if one.session is None]
            if strangers:
                min(strangers, key=lambda one: one.since).closed = True
            else:
                connection.refuse(BusyError(f"{_CLIENTS} clients look into this kernel already; end one of them"))
        self._connections.add(connection)

    def _end(self, connection: Connection) -> None:
        self._connections.discard(connection)
        connection.socket.close()
        if connection.session is not None:
            self.hand_over(connection.session.end)


def _watch(selector: selectors.BaseSelector, connection: Connection) -> None:
    """Have the selector look for what can be done with a connection now."""
    wanted = 0
    if not connection.closed:
        wanted = selectors.EVENT_READ * connection.takes | selectors.EVENT_WRITE * connection.has_more
    before, connection.watched = connection.watched, wanted
    if before == wanted:
        return
    if before == 0:
        selector.register(connection.socket, wanted, connection)
    elif wanted == 0:
        selector.unregister(connection.socket)
    else:
        selector.modify(connection.socket, wanted, connection)
