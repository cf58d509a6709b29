"""The client's end: short sessions with running kernels over blocking sockets, without an event loop.

with Client.open(entry) as client:
    client.call("activate", component="pid0")
    for item in client.stream("changes"):
        ...
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Final, Self

from aiorts import errors
from aiorts.control.ahead import Ahead, Waiting
from aiorts.control.folder import Entry, discard, is_served
from aiorts.control.protocol import (
    ANSWERS,
    BYE,
    NEWEST,
    OLDEST,
    REQUESTS,
    STALL_SECONDS,
    agreed,
    answer_in,
    error_in,
    framed,
    frames,
)
from aiorts.errors import AiortsError, ControlError, NoAnswerError, WireError
from aiorts.late import dataclass

TIMEOUT: Final = 5.0
"""Seconds that a call waits for its answer."""
_CHUNK: Final = 1 << 18
_SILENCE: Final = "no answer"


class Client:
    """A session with one kernel. It belongs to one thread.

    Attributes:
        entry: the kernel's entry; its epoch is that of the session.
        right: "view", "operate" or "code": what the kernel lets this session do.
        hello: what the kernel says of itself: name, address, pid.
        silence: what is said where it does not answer.

    Args:
        later: whether the session is to begin with the first call.
    """

    def __init__(self, entry: Entry, who: str = "", *, patience: float = TIMEOUT, later: bool = False) -> None:
        self.entry = entry
        self.right = ""
        self.hello: Mapping[str, Any] = {}
        self._buffer = bytearray()
        self._frames: deque[tuple[dict[Any, Any], int]] = deque()
        """What has come, and its bytes."""
        self._answers: dict[int, Waiting] = {}
        """Of calls that run: what has come for each."""
        self._ahead: Ahead | None = None
        self._last = 0
        self._gone = ""
        self.silence = _SILENCE
        self._who = who or _command()
        self._socket: socket.socket
        self.begun = False
        """Whether there is a session."""
        if not later:
            self._start(patience)

    def _start(self, patience: float = TIMEOUT) -> None:
        """Begin the session, if there is none."""
        if self.begun:
            return
        hello: dict[str, object] = {"oldest": OLDEST, "newest": NEWEST, "who": self._who}
        if self.entry.carried:
            hello["to"] = [self.entry.address, self.entry.epoch]
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(TIMEOUT)
            self._connect(self.entry, time.monotonic() + patience)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it has said why, which is read
                self._socket.sendall(framed({"hello": hello}))
        except BaseException:
            self._socket.close()
            raise
        self.begun = True

    @classmethod
    def open(cls, entry: Entry, *, timeout: float = TIMEOUT, who: str = "") -> Self:
        """A session that is ready for calls.

        Raises:
            NoAnswerError: the kernel does not answer within `timeout` seconds.
            AbsentError: it is gone.
            ControlError: it refuses the session, or speaks another protocol.
        """
        until = time.monotonic() + timeout
        client = cls(entry, who, patience=timeout)
        try:
            client._greet(until)
        except BaseException:
            client.close()
            raise
        return client

    def _connect(self, entry: Entry, until: float) -> None:
        while True:
            try:
                self._socket.connect(entry.path)
                return
            except BlockingIOError:  # more wait to be let in than the system keeps
                if time.monotonic() >= until:
                    raise NoAnswerError(f"{entry.address}: no answer") from None
                time.sleep(0.005)
            except OSError as error:
                if error.errno in (errno.ECONNREFUSED, errno.ENOENT):
                    discard(entry)
                    raise errors.AbsentError(f"{entry.address}: is gone; `aiorts ls` shows what runs") from None
                if isinstance(error, TimeoutError):
                    raise NoAnswerError(f"{entry.address}: no answer") from None
                raise ControlError(f"{entry.address}: {entry.path}: {error.strerror}") from None

    def _greet(self, until: float) -> None:
        while not self.hello:
            self._receive(until)
            while self._frames and not self.hello:
                self._take_hello(self._frames.popleft()[0])

    def _take_hello(self, frame: dict[Any, Any]) -> None:
        if "error" in frame:
            raise error_in(frame["error"], self.entry.address)
        hello = frame.get("hello")
        if not isinstance(hello, dict):
            raise WireError(f"{self.entry.address}: no hello; what listens there is no kernel of aiorts")
        agreed(hello.get("protocol"), hello.get("protocol"), self.entry.address)
        self.right = str(hello.get("right", ""))
        process = hello.get("pid")
        process = process if type(process) is int else self.entry.pid
        epoch = str(hello.get("epoch", ""))
        self.entry = Entry(self.entry.address, process, epoch, self.entry.path, self.entry.carried)
        self.hello = hello

    def close(self) -> None:
        """End the session in order: what it began in the kernel ends with it. Idempotent."""
        if self._last:
            self._say_bye()
        if self._ahead is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._ahead.join()
        if self.begun:
            self._socket.close()

    def _say_bye(self) -> None:
        with contextlib.suppress(OSError):  # it has ended, or takes nothing
            if self._ahead is None:
                self._socket.settimeout(0.0)
            self._socket.send(BYE, socket.MSG_DONTWAIT)

    def read_ahead(self) -> None:
        """From now on a thread takes what comes: this process may be held back, and the kernel does not notice.

        A stream keeps `ahead.ITEMS` items for who does not take them; the others are `missed`. `read` and `fileno` are
        not for who calls this. Idempotent.
        """
        if self._ahead is None:
            self._start()
            self._socket.settimeout(None)
            self._ahead = Ahead(self.read, self._sort)

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
        """The result of an operation, as plain data.

        Args:
            operation: its name in the table.
            wait: seconds; None waits forever. Given by position, since an argument may have this name.
            arguments: of the operation.

        Raises:
            NoAnswerError: there was none in time.
            AiortsError: what the operation raised, by its code.
        """
        return self.result(self.begin(operation, **arguments), wait)

    def begin(self, operation: str, /, **arguments: object) -> int:
        """Send a call and do not wait; `result` gives its result by the number that is returned."""
        number = self._last + 1
        self._answers[number] = Waiting()
        try:
            self._send({"id": number, "op": operation, "epoch": self.entry.epoch, "args": arguments})
        except BaseException:
            del self._answers[number]
            raise
        self._last = number
        return number

    def result(self, number: int, wait: float | None = TIMEOUT) -> Any:
        """Wait for the result of a call that was begun. Raises as `call` does."""
        try:
            return self._next(number, wait)["ok"]
        finally:
            self._answers.pop(number, None)

    def stream(self, operation: str, wait: float | None = TIMEOUT, /, **arguments: object) -> Stream:
        """Begin an operation that streams; the stream's items come as they are made. Arguments and errors as `call`."""
        number = self.begin(operation, **arguments)
        try:
            began = self._next(number, wait)["ok"]
        except BaseException:
            self._answers.pop(number, None)
            raise
        return Stream(self, number, began)

    def wait_end(self, seconds: float) -> None:
        """Wait until the kernel's process, or the session, has ended.

        Raises:
            NoAnswerError: it runs on after so many seconds.
        """
        until = time.monotonic() + seconds
        try:
            while True:
                self._receive(until)
                self._frames.clear()
        except errors.ClosedError:
            return

    def _send(self, message: Mapping[str, Any]) -> None:
        frame = framed(message)
        if len(frame) > REQUESTS.frame:
            raise errors.LimitError(f"a call of {len(frame)} bytes; at most {REQUESTS.frame} are allowed")
        self._start()
        try:
            self._socket.settimeout(TIMEOUT)
            self._socket.sendall(frame)
        except TimeoutError:
            raise NoAnswerError(f"{self.entry.address}: does not take what is sent") from None
        except OSError:
            self._gone = self._gone or f"{self.entry.address}: has ended"  # what it said last may still be read

    def _next(self, number: int, timeout: float | None) -> dict[Any, Any]:
        """The next that comes for a call."""
        waiting = self._answers[number]
        until = None if timeout is None else time.monotonic() + timeout
        if self._ahead is None:
            while not waiting:
                self._receive(until)
                self._sort()
        elif not waiting and not self._ahead.wait(lambda: len(waiting) > 0, until):
            raise NoAnswerError(f"{self.entry.address}: {self.silence}")
        answer = waiting.take()
        if "error" in answer:
            raise error_in(answer["error"], self.entry.address)
        return answer

    def _sort(self) -> None:
        while self._frames:
            frame, size = self._frames.popleft()
            if not self.hello:
                self._take_hello(frame)
                continue
            if "id" not in frame and "error" in frame:
                raise error_in(frame["error"], self.entry.address)
            number, busy = frame.get("id"), frame.get("busy")
            waiting = self._answers.get(number) if type(number) is int else None
            if waiting is not None:
                waiting.put(frame, size, bounded=self._ahead is not None)
                self.silence = _SILENCE
            elif type(busy) is float or type(busy) is int:
                self.silence = f"no answer: its event loop has been busy for at least {busy:.1f} s"

    def _receive(self, until: float | None) -> None:
        """Wait until at least one frame has come."""
        while not self._frames:
            if until is not None and time.monotonic() >= until:
                raise NoAnswerError(f"{self.entry.address}: {self.silence}")
            self._socket.settimeout(None if until is None else max(0.001, until - time.monotonic()))
            self.read()

    def read(self) -> None:
        """Take what has come.

        Raises:
            ClosedError: the kernel has ended the session, or its process has ended.
        """
        try:
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            return
        except OSError as error:
            raise errors.ClosedError(f"{self.entry.address}: the session has ended ({error.strerror})") from None
        if not data:
            raise self._ended()
        self._buffer += data
        self._frames.extend((answer_in(frame), len(frame)) for frame in frames(self._buffer, ANSWERS))

    def _ended(self) -> errors.ClosedError:
        """Why nothing comes any more."""
        if not self._gone and self.hello and is_served(self.entry):
            return CutOff(
                f"{self.entry.address}: runs on, and has cut off this process, which took nothing for "
                f"{STALL_SECONDS:.0f} s; what it missed at the end is not counted"
            )
        return errors.ClosedError(self._gone or f"{self.entry.address}: has ended")

    def answered(self, number: int) -> bool:
        """Whether something has come for a call, after `read`."""
        if self._ahead is None:
            self._sort()
        return bool(self._answers.get(number))


class CutOff(errors.ClosedError):
    """The kernel runs on, and has ended the session of a client that took nothing."""


class Stream:
    """The items of an operation that streams, in order; iterating waits for the next.

    Attributes:
        began: what the operation said when it began.
        missed: items that were dropped so far, in the kernel or here, since this end was too slow.
        result: what it said when it ended.
    """

    def __init__(self, client: Client, number: int, began: Any) -> None:
        self.client = client
        self.began = began
        self.missed = 0
        self.result: Any = None
        self._number = number
        self._waiting = client._answers[number]
        self._ended = False

    def __iter__(self) -> Iterator[Any]:
        while (item := self.next()) is not END:
            yield item

    def until(self, end: float | None) -> Iterator[Any]:
        """The items that come before `end`, a time of `time.monotonic()`; None is without an end."""
        while end is None or time.monotonic() < end:
            try:
                item = self.next(None if end is None else end - time.monotonic())
            except NoAnswerError:
                return
            if item is END:
                return
            yield item

    @property
    def ended(self) -> bool:
        """Whether the kernel has ended it: no item comes any more."""
        return self._ended

    def next(self, timeout: float | None = None) -> Any:
        """The next item; END when there are no more.

        Raises:
            NoAnswerError: none came within `timeout` seconds.
        """
        if self._ended:
            return END
        try:
            answer = self.client._next(self._number, timeout)
        except errors.ClosedError:
            self.missed += self._waiting.missed_last()
            raise
        self.missed += answer["missed"]
        if "item" in answer:
            return answer["item"]
        self._ended = True
        self.result = answer.get("end")
        self.client._answers.pop(self._number, None)
        return END

    def take(self, timeout: float) -> list[Any]:
        """The items that have come: at least one, or none at all within `timeout` seconds; END is the last."""
        try:
            found = [self.next(timeout)]
        except NoAnswerError:
            return []
        while found[-1] is not END and self.client.answered(self._number):
            found.append(self.next(0.0))
        return found

    def close(self) -> None:
        """End the operation; idempotent."""
        if not self._ended:
            self._ended = True
            self.client._send({"id": self._number, "cancel": True})
            self.client._answers.pop(self._number, None)


END: Final = object()
"""What a stream gives when it is over."""


# -- several kernels ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Silent:
    """A kernel that did not answer."""

    entry: Entry
    why: str


def open_all(
    found: Iterable[Entry], operation: str, *, timeout: float = 1.0, grace: float = 0.25, **arguments: object
) -> tuple[list[tuple[Client, Any]], list[Silent]]:
    """Open a session with each kernel and make one call in each, all at the same time.

    A kernel that says nothing, not even hello, delays the others by `grace` seconds at the most; one whose loop is busy
    by `timeout`.

    Args:
        timeout: seconds to wait when none has answered, and for those that have said hello.
        grace: seconds to wait for the others once one has answered.

    Returns:
        The sessions with the result of the call, in the order given; and who did not answer.
    """
    pending: dict[int, tuple[Client, int]] = {}
    silent: list[Silent] = []
    order: list[Client] = []
    until = time.monotonic() + grace
    for entry in found:
        try:
            client = Client(entry, patience=until - time.monotonic())
            number = client.begin(operation, **arguments)
        except errors.AbsentError:
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
        elif isinstance(answer, errors.AbsentError):  # it went meanwhile
            client.close()
        else:
            client.close()
            silent.append(Silent(client.entry, _why(client.entry, answer)))
    return opened, silent


def _why(entry: Entry, answer: object) -> str:
    return str(answer).removeprefix(f"{entry.address}: ")


def _wait_all(pending: Mapping[int, tuple[Client, int]], *, timeout: float, grace: float) -> dict[Client, Any]:
    """The results of calls that were begun, by client, as far as they come in time; an error in place of one.

    Args:
        pending: by descriptor, the client and the number of its call.
        timeout: seconds to wait when none has answered, and for those that have said hello.
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
        busy = any(client.hello for client, _ in left.values())  # their processes run: only their loops take long
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


def _command() -> str:
    words: Sequence[str] = sys.argv[:2]
    return " ".join(os.path.basename(word) for word in words)[:60]
