"""One client's connection as the thread of the socket sees it: bytes in, calls out, answers in, bytes out.

No call of a client waits for another client: answers that a client does not read hold up its own calls alone.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.session import nothing
from aiorts.errors import AiortsError, BusyError, ControlError, DeniedError, StaleError, WireError
from aiorts.kernel.execution.file_access import acting
from aiorts.model.reading import from_plain
from aiorts.sessions import BYE, REQUESTS, STALL_SECONDS, WAITING, agreed, framed, frames, has_frame, request_in

if TYPE_CHECKING:
    from aiorts.control.server.clients import Client
    from aiorts.control.server.listener import Listener
    from aiorts.control.session import Session

HELLO_SECONDS: Final = 5.0
"""Seconds within which a client has to send hello."""
CALLS_PER_SECOND: Final = 2_000
"""Calls of one client in a second; a client with more is read more slowly."""
_BURST: Final = 500
_PER_TURN: Final = 8
"""Calls of one client that are taken before it is the turn of other clients."""
_PAUSE: Final = 0.01
"""Seconds until a client that has used up its calls may make some again."""
_CHUNK: Final = 1 << 16


class Call:
    """A client's request on its way to the loop."""

    __slots__ = ("begun_at", "connection", "handed_at", "number", "run", "took", "view")

    def __init__(self, connection: Connection, number: int, run: Callable[[], None], *, view: bool) -> None:
        self.connection = connection
        self.number = number
        self.run = run
        self.view = view
        """Whether the call only looks; such calls are carried out one after the other."""
        self.handed_at = time.monotonic()
        self.begun_at: float | None = None
        self.took: float | None = None
        """Seconds of the loop that the call took; the work that it began may go on."""

    def __call__(self) -> None:
        """Carry out the call; on the loop."""
        self.begun_at = began = time.monotonic()
        try:
            self.run()
        finally:
            self.took = time.monotonic() - began


class Connection:
    """One client's connection. All methods are called in the thread of the socket, except `put` and `has_room`."""

    def __init__(self, listener: Listener, connected: socket.socket, client: Client, *, carried: bool = False) -> None:
        self.socket = connected
        self.client = client
        self.carried = carried
        """Whether another carrier has admitted the client."""
        self.right = self._allowed = client.right
        """The right of the session, which the hello may lower, and the right that the kernel allows the client."""
        self.since = time.monotonic()
        self.session: Session | None = None
        self.closed = False
        self.said_bye = False
        """Whether the client has ended its session in order."""
        self.closing = False
        """Whether the connection is closed once all is sent."""
        self.watched = 0
        """The registered events of the selector: EVENT_READ, EVENT_WRITE."""
        self.unsent = 0
        """Bytes that wait to be sent."""
        self._listener = listener
        self._in = bytearray()
        self._out: deque[tuple[memoryview, Callable[[], None]]] = deque()
        self._over_at = {"hello": self.since + HELLO_SECONDS}
        """The times at which the client is cut off, by the step that it then has not done."""
        self._open: dict[int, bool] = {}
        """Calls without their last answer: by number, whether the call streams."""
        self._tokens = float(_BURST)
        self._filled_at = self.since

    # -- in --------------------------------------------------------------------------------------------------------

    @property
    def takes(self) -> bool:
        """Whether more of the client's bytes are read now."""
        return not self.closing and not self.asks and self.has_room()

    @property
    def asks(self) -> bool:
        """Whether a whole frame of the client waits to be taken."""
        return has_frame(self._in, REQUESTS.frame)

    @property
    def waits(self) -> bool:
        """Whether the client waits for an answer."""
        return bool(self._open)

    @property
    def resumes_at(self) -> float | None:
        """The time at which waiting calls of the client are taken; None: there are none."""
        if self.closing or not self.asks or not self.has_room():
            return None
        return self._filled_at if self._tokens >= 1 else self._filled_at + _PAUSE

    def overdue(self, now: float) -> bool:
        """Whether to cut the client off; a hello that has come counts, also while it waits to be taken."""
        return any(now >= at for what, at in self._over_at.items() if what != "hello" or not self.asks)

    def read(self) -> None:
        """Read the bytes that the client has sent."""
        try:
            data = self.socket.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.closed = True
            return
        self._in += data
        self._look()

    def _look(self) -> None:
        """Check for a whole frame; a frame that has begun has `STALL_SECONDS` to be completed."""
        try:
            whole = self.asks
        except WireError as error:
            self.refuse(error)
            return
        if whole or not self._in:
            self._over_at.pop("frame", None)
        else:
            self._over_at.setdefault("frame", time.monotonic() + STALL_SECONDS)

    def work(self) -> None:
        """Take the client's requests, as many as its turn and its share allow."""
        now = time.monotonic()
        self._tokens = min(_BURST, self._tokens + (now - self._filled_at) * CALLS_PER_SECOND)
        self._filled_at = now
        for _ in range(_PER_TURN):
            if self.closing or not self.asks or self._tokens < 1 or not self.has_room() or not self._listener.ready:
                return
            self._tokens -= 1
            self._take(next(frames(self._in, REQUESTS.frame)))
            self._look()

    def _take(self, frame: bytes) -> None:
        try:
            request = request_in(frame)
            if self.session is None:
                self._greet(request)
                return
        except AiortsError as error:
            self.refuse(error)
            return
        if request.get("bye"):
            self.said_bye = self.closed = True
            return
        session, number = self.session, request.get("id")
        if type(number) is not int or not 0 < number < 2**53:
            self.refuse(WireError(f"a call without a number: id = {number!r:.50}"))
            return
        if request.get("cancel"):
            if number in self._open:
                self._listener.hand_over(Call(self, number, lambda: session.cancel(number), view=False))
            return
        credit = request.get("credit")
        if credit is not None and (type(credit) is not int or not 0 < credit < 2**31):
            self.refuse(WireError(f"a call with a credit that is none: {credit!r:.50}"))
            return
        if credit is not None and "op" not in request:
            if number in self._open:
                session.credit(number, credit)
            return
        try:
            operation, arguments = self._checked(number, request)
        except AiortsError as error:
            if isinstance(error, DeniedError):
                session.audit(f"{request['op']:.60}", f"refused {error.code}: {error}")
            self._answer({"id": number, "error": {"code": error.code, "text": str(error)}})
            return
        self._open[number] = operation.streams
        self.client.calls += 1
        view = operation.right is Right.VIEW
        access = None if self.right.allows(Right.CODE) else self._listener.files

        def begin() -> None:
            with acting(access):
                session.begin(number, operation, arguments, credit)

        self._listener.hand_over(Call(self, number, begin, view=view))

    def _greet(self, request: dict[Any, Any]) -> None:
        hello = request.get("hello")
        if not isinstance(hello, dict):
            raise ControlError("expected hello first; what connects is no client of aiorts")
        client = "".join(one if one.isprintable() else " " for one in f"{hello.get('who', ''):.100}")
        who = f"{client} [{self.client.name}]"
        try:
            protocol = agreed(hello.get("oldest"), hello.get("newest"), who)
        except ControlError as error:
            self._listener.warn(str(error))
            raise
        self.right = _least(self._allowed, hello.get("right"))
        self.client = self._listener.lowered(self.client, self.right)
        self.session = self._listener.greeted(self, who)
        self._over_at.pop("hello", None)
        own = {"protocol": protocol, "credits": True, "right": self.right.value}
        self._answer({"hello": {**self._listener.hello, **own}})

    def _checked(self, number: int, request: dict[Any, Any]) -> tuple[Operation, Any]:
        """The called operation and its arguments; raises where the call is not allowed."""
        name = request.get("op")
        operation = self._listener.operations.get(name) if isinstance(name, str) else None
        if operation is None:
            raise ControlError(f"no operation {name!r:.60}; this kernel is of another release, or the client is wrong")
        if request.get("epoch") != self._listener.epoch:
            raise StaleError(
                f"{name}: meant for a kernel that has ended; another has its address now. Nothing was done; try again"
            )
        unknown: dict[str, Any] = {}
        arguments = from_plain(operation.arguments, request.get("args", {}), unknown=unknown)
        if unknown:
            raise ControlError(f"{name}: no argument {', '.join(unknown)[:200]}; this kernel is of another release")
        needed = operation.needed(arguments)
        if not self.right.allows(needed):
            raise DeniedError(f"{name}: needs the right {needed.value!r}, and {self._why_not(needed)}")
        if number in self._open:
            raise BusyError(f"{name}: a call with the number {number} runs already")
        if len(self._open) >= WAITING:
            raise BusyError(f"{name}: {WAITING} calls of this client wait already; wait for their answers")
        self.client.check_calls(operation.name, self._allowed)
        return operation, arguments

    def _why_not(self, needed: Right) -> str:
        """The text that says why the client lacks a right, and how it can get it."""
        allowed = self._allowed
        if allowed.allows(needed):
            return f"this client asked for {self.right.value!r}; begin the session with right={needed.value!r}"
        said = f"this kernel allows {allowed.value!r}"
        if not self.carried:
            return f"{said}; start it with --control on"
        if needed is Right.CODE:
            return f"{said} to this client: code is never taken over a network"
        return f"{said} to this client: over a network it takes --allow-control, and a name that may operate"

    def refuse(self, error: AiortsError) -> None:
        """Send an error and end the session."""
        self._in.clear()
        self.closing = True
        self._over_at["end"] = time.monotonic() + HELLO_SECONDS
        self._answer({"error": {"code": error.code, "text": str(error)}})

    # -- out -------------------------------------------------------------------------------------------------------

    def put(self, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send a message; `sent` is called once the socket has taken it. From any thread."""
        self._listener.put(self, message, sent)

    def has_room(self) -> bool:
        """Whether the unsent bytes are within the present limit for one client. From any thread."""
        return self.unsent <= max(self._listener.room, _CHUNK)

    def say_busy(self, seconds: float) -> None:
        """Tell a client that waits that the loop is held up."""
        if (self._open or self.asks) and not self._out:
            self._answer({"busy": round(seconds, 1)})

    def _answer(self, message: Mapping[str, Any]) -> None:
        self._queue(message, nothing)

    def deliver(self, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send an answer to one of the client's calls."""
        number: int = message["id"]
        if "error" in message or "end" in message or ("ok" in message and not self._open.get(number)):
            self.client.calls -= self._open.pop(number, None) is not None
        self._queue(message, sent)

    def _queue(self, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        frame = framed(message)
        self._out.append((memoryview(frame), sent))
        self.unsent += len(frame)
        self._listener.unsent += len(frame)
        if len(self._out) == 1:
            self.write()

    @property
    def has_more(self) -> bool:
        """Whether unsent messages wait."""
        return bool(self._out)

    def write(self) -> None:
        """Send as much as the socket takes."""
        while self._out:
            rest, sent = self._out[0]
            try:
                count = self.socket.send(rest)
            except BlockingIOError:
                self._over_at.setdefault("read", time.monotonic() + STALL_SECONDS)
                return
            except OSError:
                self.closed = True
                return
            self.unsent -= count
            self._listener.unsent -= count
            self._over_at.pop("read", None)
            if count < len(rest):
                self._out[0] = (rest[count:], sent)
            else:
                self._out.popleft()
                sent()
        self.closed = self.closed or self.closing

    def hear_last(self) -> None:
        """Read the last bytes for a "bye", which ends the session in order; other requests in them are ignored."""
        with contextlib.suppress(OSError):
            self._in += self.socket.recv(_CHUNK)
        self.said_bye = self.said_bye or self._in.endswith(BYE)

    def end(self) -> None:
        """Close the connection; unsent messages are dropped."""
        self.closed = True
        self.socket.close()
        self.client.calls -= len(self._open)
        self._open.clear()
        self._listener.unsent -= self.unsent
        self.unsent = 0
        while self._out:
            self._out.popleft()[1]()


def _least(allowed: Right, wanted: object) -> Right:
    """The smaller of the allowed right and the right that a hello wants; without a wanted right, the allowed one."""
    if wanted is None:
        return allowed
    for right in Right:
        if right.value == wanted:
            return right if allowed.allows(right) else allowed
    raise ControlError(f"hello: right: expected {', '.join(one.value for one in Right)}, got {wanted!r:.50}")


def turn_away(connected: socket.socket, error: AiortsError) -> None:
    """Send a new client the reason of its refusal, as far as its socket takes that at once, and close."""
    with connected, contextlib.suppress(OSError):
        connected.setblocking(False)
        connected.send(framed({"error": {"code": error.code, "text": str(error)}}))
        connected.recv(_CHUNK)  # unread bytes would turn the close into a reset


def peer_credentials(connected: socket.socket) -> tuple[int, int] | None:
    """The process and the user at the other end; None where the system does not tell."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    size = struct.calcsize("3i")
    process, user, _ = struct.unpack("3i", connected.getsockopt(socket.SOL_SOCKET, option, size))
    return process, user
