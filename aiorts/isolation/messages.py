"""The messages between a kernel and the processes of its components: the first message, requests and reports.

Requests and answers are JSON. The bytes in them, such as those of samples, stand behind it as they are.

Both ends are of one program. Requests are operations of the control table; the first message is all that a process
needs before it has a kernel: nothing of it is in the process's arguments, which other users can read.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from aiorts.errors import AiortsError, ControlError, error_of_code
from aiorts.late import dataclass
from aiorts.model.plain import plain

OPERATE: Final = "operate"
"""The question by which the kernel asks for an operation in the process."""
REPORT: Final = "report"
"""The question by which the process reports a change of state."""
MARK: Final = "\x1e"
"""Begins a line of standard error that is a record of the log: this, the level's number, a blank, the text."""
_LENGTH: Final = struct.Struct("<I")
_HEAD: Final = struct.Struct("<QI")
"""The head of a request and an answer: the length of the JSON, and how many byte strings follow it. Their lengths come
next."""
_BYTES: Final = "\x1ebytes"
"""The only key of an object that stands for bytes; its value is their place among the byte strings."""
_LONGEST: Final = 10_000
"""Letters of the text of an error."""


@dataclass(frozen=True, slots=True)
class First:
    """The first message to a process."""

    kernel: str
    """The name of the process's kernel."""
    component: str
    path: list[str]
    """The `sys.path` of the process."""
    plugins: list[str]
    """Folders with plugins."""
    loop: str
    """"uvloop" or "asyncio"."""
    log_level: int
    memory: int | None
    """Bytes that the process may use in addition to those in use once the component is made."""
    awaited: bool
    """Whether links wait until the component is active: what is sent to it before would be dropped."""
    program: str
    """In hexadecimal: the secret by which kernels of one program know each other."""

    def send(self, sock: socket.socket) -> None:
        """Send the message, blocking: it is small, and nothing else is in the socket."""
        body = json.dumps(asdict(self)).encode()
        sock.sendall(_LENGTH.pack(len(body)) + body)

    @classmethod
    def receive(cls, sock: socket.socket) -> First:
        """Wait for the message, and read nothing behind it. ConnectionError: the other end is gone."""
        (length,) = _LENGTH.unpack(_exactly(sock, _LENGTH.size))
        return cls(**json.loads(_exactly(sock, length)))


def _exactly(sock: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = sock.recv(size - len(data))
        if not more:
            raise ConnectionError("the kernel that started this process is gone")
        data += more
    return data


@dataclass(frozen=True, slots=True)
class Report:
    """A report on the component in a process."""

    state: str
    """The lifecycle state in its context."""
    finished: bool
    """Whether the component was a source that has no more samples."""
    error: str
    """The error of the component, where it is in error."""
    ports: list[Any] | None = None
    """Its ports, where they have changed."""

    def to_bytes(self) -> bytes:
        """The report as a body."""
        return json.dumps(asdict(self) | {"error": _short(self.error)}).encode()

    @classmethod
    def from_bytes(cls, body: bytes) -> Report:
        """The report of a body."""
        return cls(**json.loads(body))


def request(operation: str, arguments: Mapping[str, Any]) -> bytes:
    """The body of a request."""
    return _body([operation, arguments])


def asked(body: bytes) -> tuple[str, dict[str, Any]]:
    """The operation and the arguments of a request."""
    operation, arguments = _value(body)
    return operation, arguments


def done(value: Any) -> bytes:
    """The answer to a request that was carried out."""
    return _body({"value": value})


def refused(error: AiortsError) -> bytes:
    """The answer to a request that was not carried out."""
    return _body({"code": error.code, "text": _short(str(error))})


def value_of(body: bytes) -> Any:
    """The result of a request.

    Raises:
        AiortsError: the error that refused the request, of the class that has its code.
    """
    answer = _value(body)
    if "code" in answer:
        raise error_of_code(answer["code"], answer["text"]) or ControlError(answer["text"])
    return answer["value"]


def _body(value: Any) -> bytes:
    strings: list[bytes] = []
    text = json.dumps(plain(_apart(value, strings))).encode()
    lengths = struct.pack(f"<{len(strings)}Q", *map(len, strings))
    return b"".join((_HEAD.pack(len(text), len(strings)), lengths, text, *strings))


def _apart(value: Any, strings: list[bytes]) -> Any:
    """The value, with each byte string moved to the end of `strings`."""
    kind = type(value)
    if kind is bytes:
        strings.append(value)
        return {_BYTES: len(strings) - 1}
    if kind is dict:
        return {key: _apart(one, strings) for key, one in value.items()}
    return [_apart(one, strings) for one in value] if kind in (list, tuple) else value


def _value(body: bytes) -> Any:
    size, count = _HEAD.unpack_from(body)
    start = _HEAD.size + 8 * count
    strings, end = [], start + size
    for length in struct.unpack_from(f"<{count}Q", body, _HEAD.size):
        strings.append(body[end : end + length])
        end += length

    def found(values: dict[str, Any]) -> Any:
        return strings[values[_BYTES]] if values.keys() == {_BYTES} else values

    return json.loads(body[start : start + size], object_hook=found if strings else None)


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({len(text):,} letters)"
