"""The client's end: short sessions with running kernels over blocking sockets, without an event loop.

with Client.open(entry) as client:
    client.call("activate", component="pid0")
    for item in client.stream("changes"):
        ...
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Iterable, Iterator, Mapping
from threading import Condition, Thread
from types import TracebackType
from typing import Any, Final, Self

from aiorts.errors import AbsentError, AiortsError, ClosedError, NoAnswerError
from aiorts.late import dataclass
from aiorts.sessions.base_client import END, TIMEOUT, BaseClient, refusal
from aiorts.sessions.folder import Entry, discard, is_served
from aiorts.sessions.protocol import RightName
from aiorts.sessions.session import ITEMS, Answer, Call

_CHUNK: Final = 1 << 18
_JOIN: Final = 1.0
"""Seconds to wait for the end of the thread that reads ahead, once the socket is shut down."""


class Client(BaseClient):
    """A session with one kernel. It belongs to one thread.

    Args:
        right: as `open`.
        later: whether the session begins with the first call, not at once.
    """

    def __init__(
        self, entry: Entry, who: str = "", *, right: RightName = "", patience: float = TIMEOUT, later: bool = False
    ) -> None:
        super().__init__(entry, who, right)
        self._news = Condition()
        """Held during each access to the session; notified when an answer has come."""
        self._thread: Thread | None = None
        """The thread that reads ahead, or None."""
        self._deaf = False
        """Whether sending failed; the kernel's last frames may still be read."""
        self._socket: socket.socket
        self.begun = False
        """Whether there is a session."""
        if not later:
            self._start(patience)

    def _start(self, patience: float = TIMEOUT) -> None:
        """Begin the session, if there is none."""
        if self.begun:
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(TIMEOUT)
            self._connect(self.entry, time.monotonic() + patience)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the kernel's reason is still to be read
                self._socket.sendall(self._greeting())
        except BaseException:
            self._socket.close()
            raise
        self.begun = True

    @classmethod
    def open(cls, entry: Entry, *, timeout: float = TIMEOUT, who: str = "", right: RightName = "") -> Self:
        """Open a session that is ready for calls.

        Args:
            right: the highest right wanted: "view", "operate" or "code"; by default all that the kernel allows.

        Raises:
            NoAnswerError: the kernel does not answer within `timeout` seconds.
            AbsentError: the kernel is gone.
            ControlError: the kernel refuses the session, or speaks another protocol.
        """
        until = time.monotonic() + timeout
        client = cls(entry, who, right=right, patience=timeout)
        try:
            while client._session.state != "open":
                client._receive(until)
        except BaseException:
            client.close()
            raise
        return client

    def _connect(self, entry: Entry, until: float) -> None:
        while True:
            try:
                self._socket.connect(entry.path)
                return
            except BlockingIOError:  # the listener's backlog is full
                if time.monotonic() >= until:
                    raise NoAnswerError(f"{entry.address}: no answer") from None
                time.sleep(0.005)
            except TimeoutError:
                raise NoAnswerError(f"{entry.address}: no answer") from None
            except OSError as error:
                why = refusal(entry, error)
                if isinstance(why, AbsentError):
                    discard(entry)
                raise why from None

    def close(self) -> None:
        """End the session in order: its calls in the kernel end, too. Idempotent."""
        with self._news:
            bye = self._session.bye()
        if self.begun and self._session.last:
            with contextlib.suppress(OSError):  # the kernel has ended, or does not read
                if self._thread is None:
                    self._socket.settimeout(0.0)
                self._socket.send(bye, socket.MSG_DONTWAIT)
        if self._thread is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._thread.join(_JOIN)
        if self.begun:
            self._socket.close()

    def read_ahead(self) -> None:
        """Start a thread that reads the socket, so that a pause of this program does not hold up the kernel.

        A stream keeps `session.ITEMS` items that wait; further items are `missed`. After this call, `read` and `fileno`
        must not be called. Idempotent.
        """
        if self._thread is None:
            self._start()
            self._socket.settimeout(None)
            self._session.credit = ITEMS
            self._thread = Thread(target=self._read_on, name="aiorts client", daemon=True)
            self._thread.start()

    def _read_on(self) -> None:
        try:
            while self._session.error is None:
                self._take()
        finally:
            self._end(ClosedError(f"{self.entry.address}: is not read any more"))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def fileno(self) -> int:
        """The socket's descriptor, for `select`."""
        self._start()
        return self._socket.fileno()

    # -- calls -----------------------------------------------------------------------------------------------------

    def call(self, operation: str, wait: float | None = TIMEOUT, /, **arguments: object) -> Any:
        """Call an operation; returns its result as plain data.

        Args:
            operation: the name of the operation in the table.
            wait: seconds; None waits without limit. By position only, since an argument may have this name.
            arguments: the arguments of the operation.

        Raises:
            NoAnswerError: no answer came in time.
            AiortsError: the error that the operation raised, as the class of its code.
        """
        return self.result(self.begin(operation, **arguments), wait)

    def begin(self, operation: str, /, **arguments: object) -> int:
        """Send a call without waiting; returns the number by which `result` gives its result."""
        return self._begin(operation, arguments).number

    def _begin(self, operation: str, arguments: Mapping[str, object], *, streams: bool = False) -> Call:
        self._start()
        with self._news:
            call, frame = self._session.begin(operation, arguments, streams=streams)
        self._send(frame)
        return call

    def result(self, number: int, wait: float | None = TIMEOUT) -> Any:
        """Wait for the result of a call that was begun. Raises as `call` does."""
        call = self._session.calls[number]
        try:
            return self._next(call, wait).result()
        finally:
            self._leave(call)

    def stream(self, operation: str, wait: float | None = TIMEOUT, /, **arguments: object) -> Stream:
        """Begin an operation that streams; items come as they are made. Arguments and errors as `call`."""
        call = self._begin(operation, arguments, streams=True)
        try:
            began = self._next(call, wait).result()
        except BaseException:
            self._cancel(call)  # a call that is only left runs on in the kernel
            raise
        return Stream(self, call, began)

    def wait_end(self, seconds: float) -> None:
        """Wait until the kernel's process, or the session, has ended.

        Raises:
            NoAnswerError: neither has ended after `seconds`.
        """
        until = time.monotonic() + seconds
        with self._news:
            while self._session.error is None:
                self._receive(until)

    def answered(self, number: int) -> bool:
        """Whether an answer has come for a call, after `read`."""
        return bool(self._session.calls.get(number))

    # -- the socket ------------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Read the socket and take the answers in it.

        Raises:
            ClosedError: the kernel has ended the session, or its process has ended.
        """
        self._take()
        self._session.check()

    def _send(self, data: bytes) -> None:
        try:
            self._socket.settimeout(TIMEOUT)
            self._socket.sendall(data)
        except TimeoutError:
            self._end(NoAnswerError(f"{self.entry.address}: does not take what is sent"))  # it may be half sent
            self._session.check()
        except OSError:
            self._deaf = True

    def _leave(self, call: Call) -> None:
        with self._news:
            self._session.leave(call)

    def _cancel(self, call: Call) -> None:
        with self._news:
            frame = self._session.cancel(call)
        self._send(frame)

    def _next(self, call: Call, timeout: float | None) -> Answer:
        """Wait for the next answer of a call."""
        until = None if timeout is None else time.monotonic() + timeout
        if not call:
            with self._news:
                while not call:
                    self._receive(until)
        return call.take()

    def _receive(self, until: float | None) -> None:
        """Wait until an answer comes; `_news` is held. Raises the error that has ended the session."""
        self._session.check()
        left = None if until is None else until - time.monotonic()
        if left is not None and left <= 0:
            raise NoAnswerError(f"{self.entry.address}: {self.silence}")
        if self._thread is not None:
            self._news.wait(left)
        else:
            self._socket.settimeout(None if left is None else max(0.001, left))
            self._take()

    def _take(self) -> None:
        """Take the bytes that come within the socket's timeout; where the socket is closed, the session ends."""
        try:
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            return
        except OSError as error:
            self._end(ClosedError(f"{self.entry.address}: the session has ended ({error.strerror})"))
            return
        if not data:
            if self._session.error is None:  # not by this end
                served = not self._deaf and self.hello != {} and is_served(self.entry)
                self._end(self._ended(served=served))
            return
        heard = self._session.decode(data)
        with self._news:
            self._hear(heard)
            self._news.notify_all()

    def _end(self, error: AiortsError) -> None:
        with self._news:
            self._session.end(error)
            self._news.notify_all()


class Stream:
    """The items of an operation that streams, in order; iterating waits for the next.

    Attributes:
        began: the first answer of the operation, from before its items.
        missed: items that were dropped so far, in the kernel or here, since this end was too slow.
        ended: whether the stream is over: no item comes any more.
        result: the last answer of the operation.
    """

    def __init__(self, client: Client, call: Call, began: Any) -> None:
        self.client = client
        self.began = began
        self.missed = 0
        self.result: Any = None
        self._call = call
        self.ended = False

    def __iter__(self) -> Iterator[Any]:
        while (item := self.next()) is not END:
            yield item

    def until(self, end: float | None) -> Iterator[Any]:
        """The items that come before `end`, a time of `time.monotonic()`; None: no limit."""
        while end is None or time.monotonic() < end:
            try:
                item = self.next(None if end is None else end - time.monotonic())
            except NoAnswerError:
                return
            if item is END:
                return
            yield item

    def next(self, timeout: float | None = None) -> Any:
        """Wait for the next item; END when there are no more.

        Raises:
            NoAnswerError: no item came within `timeout` seconds.
        """
        if self.ended:
            return END
        try:
            answer = self.client._next(self._call, timeout)
        except ClosedError:
            self.missed += self._call.missed_last()
            raise
        self.missed += answer.missed
        if answer.said == "item":
            return answer.value
        self.ended = True
        self.client._leave(self._call)
        self.result = answer.result()
        return END

    def take(self, timeout: float) -> list[Any]:
        """Wait for items; returns all that have come, or none after `timeout` seconds. END comes last in a stream."""
        try:
            found = [self.next(timeout)]
        except NoAnswerError:
            return []
        while found[-1] is not END and self._call:
            found.append(self.next(0.0))
        return found

    def close(self) -> None:
        """End the operation; idempotent."""
        if not self.ended:
            self.ended = True
            self.client._cancel(self._call)


# -- several kernels ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Silent:
    """A kernel that did not answer."""

    entry: Entry
    why: str


def open_all(
    found: Iterable[Entry],
    operation: str,
    *,
    timeout: float = 1.0,
    grace: float = 0.25,
    right: RightName = "",
    **arguments: object,
) -> tuple[list[tuple[Client, Any]], list[Silent]]:
    """Open a session with each kernel and make one call in each, all at the same time.

    A kernel that sends not even hello delays the others by at most `grace` seconds; a kernel with a busy loop, by at
    most `timeout`.

    Args:
        timeout: seconds to wait while no kernel has answered, and for kernels that have said hello.
        grace: seconds to wait for the others once one has answered.
        right: as `Client.open`.

    Returns:
        The sessions with the result of the call, in the order given; and the kernels that did not answer.
    """
    pending: dict[int, tuple[Client, int]] = {}
    silent: list[Silent] = []
    order: list[Client] = []
    until = time.monotonic() + grace
    for entry in found:
        try:
            client = Client(entry, right=right, patience=until - time.monotonic())
            number = client.begin(operation, **arguments)
        except AbsentError:
            continue
        except (AiortsError, OSError) as error:
            silent.append(Silent(entry, _why(entry, error)))
            continue
        pending[client.fileno()] = (client, number)
        order.append(client)
    answers = _wait_all(pending, timeout=timeout, grace=grace)
    opened: list[tuple[Client, Any]] = []
    for client in order:
        answer = answers.get(client, client.silence)
        if client in answers and not isinstance(answer, AiortsError):
            opened.append((client, answer))
        elif isinstance(answer, AbsentError):  # the kernel ended meanwhile
            client.close()
        else:
            client.close()
            silent.append(Silent(client.entry, _why(client.entry, answer)))
    return opened, silent


def _why(entry: Entry, answer: object) -> str:
    return str(answer).removeprefix(f"{entry.address}: ")


def _wait_all(pending: Mapping[int, tuple[Client, int]], *, timeout: float, grace: float) -> dict[Client, Any]:
    """Wait for the results of calls that were begun; returns those that come in time, or their errors, by client.

    Args:
        pending: by descriptor, the client and the number of its call.
        timeout: seconds to wait while no kernel has answered, and for kernels that have said hello.
        grace: seconds to wait for the others once one has answered.
    """
    left = dict(pending)
    results: dict[Client, Any] = {}
    poll = select.poll()
    for descriptor in left:
        poll.register(descriptor, select.POLLIN)
    latest = time.monotonic() + timeout
    patient_until = latest
    while left:
        busy = any(client.hello for client, _ in left.values())  # their processes run: only their loops are slow
        wait = (latest if busy else patient_until) - time.monotonic()
        if wait <= 0:
            break
        for descriptor, _ in poll.poll(wait * 1000):
            client, number = left[descriptor]
            try:
                client.read()
                if not client.answered(number):
                    continue
                results[client] = client.result(number)
            except AiortsError as error:
                results[client] = error
            poll.unregister(descriptor)
            del left[descriptor]
            patient_until = min(patient_until, time.monotonic() + grace)
    return results
