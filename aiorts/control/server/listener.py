"""The thread that serves a kernel's socket: it decodes, checks and sends, and hands calls over to the loop.

The loop gets only whole, checked calls, at most `CALLS_PER_SECOND` of each client. In simulated time calls are carried
out between two instants: neither the socket nor a waiting client stops time.
"""

from __future__ import annotations

import contextlib
import os
import select
import selectors
import socket
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.operators import Operators
from aiorts.control.pace import Pace
from aiorts.control.server.clients import Client, Clients, FullError
from aiorts.control.server.connection import Call, Connection, peer_credentials, turn_away
from aiorts.control.session import LOG, Session
from aiorts.errors import BusyError, ControlError, format_error
from aiorts.wire.limits import MIB

if TYPE_CHECKING:
    from aiorts.kernel.execution.file_access import FileAccess
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.sessions import Claim

_TICK: Final = 1.0
"""Seconds between two checks for overdue clients."""
_ACCEPTED: Final = 16
"""Connections that are accepted in one turn."""
_HANDED: Final = 16
"""Calls that may wait for the loop."""
_UNSENT: Final = 12 * MIB
"""Bytes that may wait for all clients; one client may use all that is free."""
_LOOP: Final = (0.2, 0.5)
"""The share of the loop that calls of all clients may take, and the seconds of it that are saved up."""
_THREAD: Final = (0.2, 0.25)
"""The share of a processor for reading and checking clients' frames, and the seconds of it that are saved up."""
_SLICE: Final = 0.005
"""Seconds for which the thread takes calls in one turn, and for which it sleeps when it has used up its share."""
_VIEW_SECONDS: Final = 0.5
"""Seconds after which the next call that looks is carried out although the last one has no answer."""
_HELD_SECONDS: Final = 0.1
"""Seconds after which clients are notified that the loop is held up, first and again."""
_REST_SECONDS: Final = 0.75
"""Seconds at the kernel's end in which clients can still read waiting messages."""


class Listener:
    """The server of one kernel's socket, until `close()`.

    Args:
        kernel: an open kernel.
        claim: the listening socket, and the kernel's entry.
        right: the highest right of clients.
        hello: the kernel's hello.
        files: the folder whose files clients without the right `code` may name.
    """

    def __init__(
        self, kernel: Microkernel, claim: Claim, right: Right, hello: Mapping[str, Any], files: FileAccess
    ) -> None:
        self.right = right
        self.files = files
        self.hello = hello
        self.epoch = claim.entry.epoch
        self._kernel, self._operators = kernel, Operators(kernel)
        self._listener = claim.listener
        self._listener.setblocking(False)
        self.loop_pace = Pace(*_LOOP)
        self.unsent = 0
        """Bytes that wait to be sent to all clients."""
        self._thread_pace = Pace(*_THREAD)
        self._clients = Clients()
        self._connections: set[Connection] = set()
        self._handed: deque[Call] = deque()
        """Calls that were handed to the loop, begun or not."""
        self._view: Call | None = None
        """The last call that looks, while it has no answer."""
        self._told_at = 0.0
        self._deaf_until = 0.0
        """The time at which clients are accepted again; 0.0: they are accepted."""
        self._warned: set[str] = set()
        self._outbox: deque[tuple[Connection, Mapping[str, Any], Callable[[], None]]] = deque()
        self._awake = False
        """Whether the thread has been woken."""
        self._admitted: deque[Connection] = deque()
        self._ended = False
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        loop: Any = kernel.loop
        self._hand_over: Callable[[Callable[[], None]], object] = getattr(
            loop, "call_between_instants", loop.call_soon_threadsafe
        )
        self._selector = selectors.DefaultSelector()
        self._works = False
        """Whether the thread is working, not waiting for work."""
        give_way: Callable[[Callable[[], bool]], Callable[[], None]] = getattr(loop, "give_way", lambda _: _nothing)
        self._keep_way = give_way(self._wants)
        _LISTENERS.add(self)
        self._thread = threading.Thread(target=self._serve, name=f"aiorts control {kernel.name}", daemon=True)
        self._thread.start()

    @property
    def operations(self) -> Mapping[str, Operation]:
        """The table of operations, imported when the first client comes."""
        from aiorts.control.operations import OPERATIONS

        return OPERATIONS

    # -- from the loop ---------------------------------------------------------------------------------------------

    def put(self, connection: Connection, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send a message to a client. From any thread."""
        self._outbox.append((connection, message, sent))
        self._wake()

    def admit(self, right: Right, where: str) -> socket.socket:
        """Admit a client that another carrier has checked, such as one of another host; from any thread.

        Args:
            right: the client's right; at most the right of this kernel's clients.
            where: the client's place, for the log.

        Returns:
            The client's end of its connection.

        Raises:
            ControlError: the kernel ends.
            BusyError: the client, or all clients together, have as many connections as they may have.
        """
        if self._ended:
            raise ControlError(f"{self.hello['address']}: ends")
        client = self._clients.connect(where, right if self.right.allows(right) else self.right)
        try:
            theirs, ours = socket.socketpair()
        except BaseException:
            self._clients.disconnect(client)
            raise
        ours.setblocking(False)
        self._admitted.append(Connection(self, ours, client, carried=True))
        self._wake()
        if self._ended:  # it ended meanwhile: the thread may not see `_admitted` any more
            ours.close()
        return theirs

    def end_sessions(self) -> None:
        """End all sessions and undo what lasts as long as they do. On the loop."""
        for connection in tuple(self._connections):
            if connection.session is not None:
                connection.session.finish()

    def close(self, timeout: float) -> None:
        """End all sessions, send what waits, and end the thread, within `timeout` seconds. On the loop."""
        self.end_sessions()
        self._keep_way()
        self._ended = True
        self._wake()
        self._thread.join(timeout)

    def leave(self) -> None:
        """Close the inherited sockets in a forked child, which would keep them open."""
        for one in (
            self._listener,
            self._wake_in,
            self._wake_out,
            *(one.socket for one in (*self._connections, *self._admitted)),
        ):
            one.close()
        self._selector.close()

    def _wants(self) -> bool:
        """Whether the thread has work; a loop that never waits has to give way to it."""
        try:
            return self._works or bool(select.select([self._selector], [], [], 0)[0])
        except (ValueError, OSError):  # it is closed, or its descriptor is too high for select
            return False

    def _wake(self) -> None:
        if not self._awake:
            self._awake = True
            try:
                self._wake_in.send(b"\0")
            except OSError:
                return  # full: the thread wakes anyway; closed: it has ended

    # -- the thread ------------------------------------------------------------------------------------------------

    @property
    def room(self) -> int:
        """Bytes that may wait for one client."""
        return _UNSENT - self.unsent

    @property
    def ready(self) -> bool:
        """Whether the loop may get another call now."""
        self._settle()
        view = self._view
        if view is not None and time.monotonic() - view.handed_at < _VIEW_SECONDS:
            return False
        return len(self._handed) < _HANDED and not self.loop_pace.due()

    def _settle(self) -> None:
        """Count the loop time of finished calls."""
        while self._handed and (took := self._handed[0].took) is not None:
            self._took(self._handed.popleft().connection, took)

    def _took(self, connection: Connection, seconds: float) -> None:
        connection.client.use(seconds)
        self.loop_pace.spend(seconds)

    def hand_over(self, call: Call) -> None:
        """Hand a call to the loop."""
        self._handed.append(call)
        if call.view:
            self._view = call
        self._on_loop(call)

    def _on_loop(self, call: Callable[[], None]) -> None:
        try:
            self._hand_over(call)
        except RuntimeError:
            self._ended = True  # the loop is closed

    def warn(self, text: str) -> None:
        """Log a fault of a client; the same text only once."""
        if text not in self._warned and len(self._warned) < _ACCEPTED:
            self._warned.add(text)
            LOG.warning("%s", text)

    def lowered(self, client: Client, right: Right) -> Client:
        """See `Clients.lower`."""
        return self._clients.lower(client, right)

    def greeted(self, connection: Connection, who: str) -> Session:
        """Make the session of a client that has said hello."""
        room, carried = connection.has_room, connection.carried
        return Session(self._kernel, connection.right, who, connection.put, room, self._operators, carried=carried)

    def _serve(self) -> None:
        try:
            with self._selector as selector:
                selector.register(self._listener, selectors.EVENT_READ)
                selector.register(self._wake_out, selectors.EVENT_READ)
                while not self._ended:
                    self._turn(selector)
                self._deliver()
                self._send_rest()
        except Exception as error:  # noqa: BLE001 - the system goes on without it
            LOG.error("the socket is served no longer: %s", format_error(error), exc_info=error)
        finally:
            for connection in (*self._connections, *self._admitted):
                self._end(connection)
            self._wake_in.close()
            self._wake_out.close()

    def _turn(self, selector: selectors.BaseSelector) -> None:
        """Do one turn: sending is never held up; reading is, once it takes more than its share of a processor."""
        owed = self._thread_pace.due()
        if owed:
            self._works = False
            time.sleep(min(owed, _SLICE))
            self._works = True
        else:
            patience, self._works = self._patience(), False
            events = selector.select(patience)
            self._works = True
            began = time.thread_time()
            for key, mask in events:
                if key.fileobj is self._listener:
                    self._let_in(selector)
                elif key.fileobj is self._wake_out:
                    self._hear()
                elif isinstance(key.data, Connection) and mask & selectors.EVENT_READ and key.data.takes:
                    self._guarded(key.data, key.data.read)
            self._work(began + _SLICE)
            self._thread_pace.spend(time.thread_time() - began)
        self._deliver()
        self._tell_busy()
        now = time.monotonic()
        for connection in tuple(self._connections):
            if connection.has_more:
                self._guarded(connection, connection.write)
            if connection.overdue(now):
                connection.closed = True
            _watch(selector, connection)
            if connection.closed:
                self._end(connection)
        if self._deaf_until and now >= self._deaf_until:
            self._deaf_until = 0.0
            selector.register(self._listener, selectors.EVENT_READ)

    def _send_rest(self) -> None:
        """Send the last messages, as far as clients read them within `_REST_SECONDS`."""
        until = time.monotonic() + _REST_SECONDS
        with selectors.DefaultSelector() as selector:
            for connection in self._connections:
                if connection.has_more and not connection.closed:
                    selector.register(connection.socket, selectors.EVENT_WRITE, connection)
            while selector.get_map() and (left := until - time.monotonic()) > 0:
                for key, _ in selector.select(left):
                    self._guarded(key.data, key.data.write)
                    if key.data.closed or not key.data.has_more:
                        selector.unregister(key.fileobj)

    def _work(self, until: float) -> None:
        """Take calls until the thread time `until`, first of clients whose recent calls took the least time."""
        now = time.monotonic()
        asking = [one for one in self._connections if one.resumes_at is not None and not one.closed]
        for connection in sorted(asking, key=lambda one: (one.client.used(now), one.since)):
            began = time.thread_time()
            if not self.ready or began >= until:
                return
            self._guarded(connection, connection.work)
            connection.client.use(time.thread_time() - began)

    def _guarded(self, connection: Connection, do: Callable[[], None]) -> None:
        try:
            do()
        except Exception as error:  # noqa: BLE001 - a faulty client harms itself only
            self.warn(f"a client was cut off: {format_error(error)}")
            connection.closed = True

    def _patience(self) -> float:
        """Seconds for which the selector may wait."""
        due = [at for one in self._connections if (at := one.resumes_at) is not None]
        now = time.monotonic()
        if due and self.ready:
            return min(_TICK, max(0.0, min(due) - now))
        if due or self._handed:
            return self.loop_pace.due() or _HELD_SECONDS
        return max(0.0, self._deaf_until - now) if self._deaf_until else _TICK

    def _tell_busy(self) -> None:
        """Tell waiting clients when the loop has been held up in or before a call for a while."""
        self._settle()
        if not self._handed:
            return
        now = time.monotonic()
        held = now - (self._handed[0].begun_at or self._handed[0].handed_at)
        if held >= _HELD_SECONDS and now >= self._told_at + _HELD_SECONDS:
            self._told_at = now
            for connection in tuple(self._connections):
                if not connection.closed:
                    self._guarded(connection, partial(connection.say_busy, held))

    def _hear(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wake_out.recv(64)
        self._awake = False  # a later `put` wakes again; earlier ones are delivered in this turn
        while self._admitted:
            self._connections.add(self._admitted.popleft())

    def _deliver(self) -> None:
        while self._outbox:
            connection, message, sent = self._outbox.popleft()
            if connection.closed:
                sent()
                continue
            item = "item" in message
            began = time.thread_time()
            try:
                connection.deliver(message, sent)
            except Exception as error:  # noqa: BLE001 - a result that cannot be sent harms its own client only
                LOG.error("an answer could not be sent: %s", format_error(error), exc_info=error)
                connection.closed = True
            if not item:
                self._thread_pace.spend(time.thread_time() - began)
                self._answered(connection, message["id"])

    def _answered(self, connection: Connection, number: int) -> None:
        view = self._view
        if view is not None and view.connection is connection and view.number == number:
            self._view = None
            if view.begun_at is not None:
                self._took(connection, max(0.0, time.monotonic() - view.begun_at - (view.took or 0.0)))

    def _let_in(self, selector: selectors.BaseSelector) -> None:
        for _ in range(_ACCEPTED):
            try:
                connected, _address = self._listener.accept()
            except BlockingIOError:
                return
            except OSError:  # no descriptor is left: waiting clients are accepted later
                selector.unregister(self._listener)
                self._deaf_until = time.monotonic() + _TICK
                return
            self._accept(connected)

    def _accept(self, connected: socket.socket) -> None:
        credentials = peer_credentials(connected)
        if credentials is not None and credentials[1] != os.geteuid():
            self.warn(f"a client of user {credentials[1]} was refused")
            connected.close()
            return
        connected.setblocking(False)
        where = "a process" if credentials is None else f"process {credentials[0]}"
        try:
            client = self._clients.connect(where, self.right)
        except BusyError as error:
            turn_away(connected, error)
            self._forget_stranger(where if isinstance(error, FullError) else None)
            return
        self._connections.add(Connection(self, connected, client))

    def _forget_stranger(self, name: str | None) -> None:
        """End the connection that has waited longest without a hello: of the client `name`, if a name is given."""
        strangers = [one for one in self._connections if one.session is None and name in (None, one.client.name)]
        if strangers:
            min(strangers, key=lambda one: one.since).closed = True

    def _end(self, connection: Connection) -> None:
        self._connections.discard(connection)
        self._clients.disconnect(connection.client)
        connection.hear_last()
        connection.end()
        if self._view is not None and self._view.connection is connection:
            self._view = None
        if connection.session is not None:
            self._on_loop(partial(connection.session.end, lost=not connection.said_bye))


_LISTENERS: Final[weakref.WeakSet[Listener]] = weakref.WeakSet()


def _leave_all() -> None:
    for one in tuple(_LISTENERS):
        one.leave()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_all)


def _nothing() -> None:
    """Do nothing: ends the giving way of loops that have no `give_way`."""


def _watch(selector: selectors.BaseSelector, connection: Connection) -> None:
    """Register with the selector the events that a connection can handle now."""
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
