"""One client's connection as the thread of the socket sees it: bytes in, calls out, answers in, bytes out.

No call of a client waits for another client: what is not read by one stays with that one, and its own calls wait then.
"""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from aiorts.control.operation import Operation
from aiorts.control.protocol import REQUESTS, WAITING, agreed, framed, frames, request_in
from aiorts.errors import AiortsError, BusyError, ControlError, DeniedError, StaleError, WireError
from aiorts.model.reading import from_plain
from aiorts.wire.limits import MIB

if TYPE_CHECKING:
    from aiorts.control.server.listener import Listener
    from aiorts.control.session import Session

HELLO_SECONDS: Final = 5.0
"""Within which a client has to say hello."""
STALL_SECONDS: Final = 30.0
"""After which a client that does not read what was sent is cut off."""
CALLS_PER_SECOND: Final = 2_000
"""Of one client; beyond that it is read more slowly."""
_BURST: Final = 500
_PER_TURN: Final = 32
"""Calls of one client that are taken before the others have their turn."""
_PAUSE: Final = 0.01
"""Seconds until a client that has used up its calls has some again."""
_UNREAD: Final = 8 * MIB
"""Bytes that may wait for a client before no more of its calls are taken."""
_CHUNK: Final = 1 << 16


class Connection:
    """One client. Everything here is called in the thread of the socket, `put` excepted."""

    def __init__(self, listener: Listener, connected: socket.socket) -> None:
        self.socket = connected
        self.since = time.monotonic()
        self.session: Session | None = None
        self.closed = False
        self.closing = False
        """Whether it is closed once all is sent."""
        self.over_at: float | None = self.since + HELLO_SECONDS
        """When it is cut off unless something happens."""
        self.watched = 0
        """What the selector looks for: EVENT_READ, EVENT_WRITE."""
        self._listener = listener
        self._in = bytearray()
        self._frames: deque[bytes] = deque()
        self._out: deque[tuple[memoryview, Callable[[], None]]] = deque()
        self._unsent = 0
        self._calls = 0
        """That wait or run; those of streams until they have begun."""
        self._tokens = float(_BURST)
        self._filled_at = self.since
        self._process = _peer(connected)

    # -- in --------------------------------------------------------------------------------------------------------

    @property
    def takes(self) -> bool:
        """Whether more of what it sends is read now."""
        return not self.closing and self._unsent < _UNREAD and len(self._frames) == 0

    @property
    def resumes_at(self) -> float | None:
        """When calls that wait for its share of time are taken; None: there are none."""
        if not self._frames or self._unsent >= _UNREAD:
            return None
        return self._filled_at if self._tokens >= 1 else self._filled_at + _PAUSE

    def read(self) -> None:
        """Take what it has sent."""
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
        try:
            self._frames.extend(frames(self._in, REQUESTS.frame))
        except WireError as error:
            self.refuse(error)
        self.work()

    def work(self) -> None:
        """Carry out what it asked for, as far as it is its turn."""
        now = time.monotonic()
        self._tokens = min(_BURST, self._tokens + (now - self._filled_at) * CALLS_PER_SECOND)
        self._filled_at = now
        for _ in range(_PER_TURN):
            if not self._frames or self._tokens < 1 or self._unsent >= _UNREAD or self.closing:
                return
            self._tokens -= 1
            self._take(self._frames.popleft())

    def _take(self, frame: bytes) -> None:
        try:
            request = request_in(frame)
            if self.session is None:
                self._greet(request)
                return
        except AiortsError as error:
            self.refuse(error)
            return
        number = request.get("id")
        if type(number) is not int or not 0 < number < 2**53:
            self.refuse(WireError(f"a call without a number: id = {number!r:.50}"))
            return
        if request.get("cancel"):
            self._listener.hand_over(lambda session=self.session: session.cancel(number))  # type: ignore[misc]
            return
        try:
            operation, arguments = self._checked(request)
        except AiortsError as error:
            self._answer({"id": number, "error": {"code": error.code, "text": str(error)}})
            return
        self._calls += 1
        self._listener.hand_over(
            lambda session=self.session: session.begin(number, operation, arguments)  # type: ignore[misc]
        )

    def _greet(self, request: dict[Any, Any]) -> None:
        hello = request.get("hello")
        if not isinstance(hello, dict):
            raise ControlError("expected hello first; what connects is no client of aiorts")
        client = str(hello.get("who", ""))[:100].replace("\n", " ")
        who = f"{client} [{self._process}]"
        protocol = agreed(hello.get("oldest"), hello.get("newest"), who)
        self.session = self._listener.greeted(self, who)
        self.over_at = None
        self._answer({"hello": {"protocol": protocol, **self._listener.hello}})

    def _checked(self, request: dict[Any, Any]) -> tuple[Operation, Any]:
        """What is called, and with what; raises when it may not be."""
        name = request.get("op")
        operation = self._listener.operations.get(name) if isinstance(name, str) else None
        if operation is None:
            raise ControlError(f"no operation {name!r:.60}; this kernel is of another release, or the client is wrong")
        if request.get("epoch") != self._listener.epoch:
            raise StaleError(
                f"{name}: meant for a kernel that has ended; another has its address now. Nothing was done; try again"
            )
        arguments = from_plain(operation.arguments, request.get("args") or {})
        needed, right = operation.needed(arguments), self._listener.right
        if not right.allows(needed):
            raise DeniedError(f"{name}: needs the right {needed.value!r}, and this kernel allows {right.value!r}")
        if self._calls >= WAITING:
            raise BusyError(f"{name}: {WAITING} calls of this client wait already; wait for their answers")
        return operation, arguments

    def refuse(self, error: AiortsError) -> None:
        """Say what is wrong, and end the session."""
        self._frames.clear()
        self._answer({"error": {"code": error.code, "text": str(error)}})
        self.closing = True
        self.over_at = time.monotonic() + HELLO_SECONDS

    # -- out -------------------------------------------------------------------------------------------------------

    def put(self, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send a message; `sent` is called once it is on its way. From any thread."""
        self._listener.put(self, message, sent)

    def _answer(self, message: Mapping[str, Any]) -> None:
        self.queue(message, _nothing)

    def queue(self, message: Mapping[str, Any], sent: Callable[[], None]) -> None:
        """Send a message when the client takes it."""
        if "item" not in message and "end" not in message and "id" in message:
            self._calls = max(0, self._calls - 1)
        frame = framed(message)
        self._out.append((memoryview(frame), sent))
        self._unsent += len(frame)
        if len(self._out) == 1:
            self.write()

    @property
    def has_more(self) -> bool:
        """Whether something waits to be sent."""
        return bool(self._out)

    def write(self) -> None:
        """Send what the client takes."""
        while self._out:
            rest, sent = self._out[0]
            try:
                count = self.socket.send(rest)
            except BlockingIOError:
                self.over_at = self.over_at or time.monotonic() + STALL_SECONDS
                return
            except OSError:
                self.closed = True
                return
            self._unsent -= count
            self.over_at = None if self.session is not None and not self.closing else self.over_at
            if count < len(rest):
                self._out[0] = (rest[count:], sent)
            else:
                self._out.popleft()
                sent()
        self.closed = self.closed or self.closing


def _peer(connected: socket.socket) -> str:
    credentials = peer_credentials(connected)
    return "a process" if credentials is None else f"process {credentials[0]}"


def peer_credentials(connected: socket.socket) -> tuple[int, int] | None:
    """Process and user at the other end; None where the system does not say."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return None
    size = struct.calcsize("3i")
    process, user, _ = struct.unpack("3i", connected.getsockopt(socket.SOL_SOCKET, option, size))
    return process, user


def _nothing() -> None:
    """Of a message that nobody counts."""
