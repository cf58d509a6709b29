"""Call an operation in many kernels behind one socket with a single question, without opening sessions.

The frame `{"every": "names"}` asks; `{"said": [["host/kernel", epoch, value], ...]}` has the answers that came in time.
With up to `FEW` kernels, sessions begin at once instead, since they are needed next.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, Final

from aiorts.errors import AiortsError
from aiorts.sessions.folder import Entry
from aiorts.sessions.protocol import ANSWERS, answer_in, framed, frames

FEW: Final = 16
"""The most kernels of one socket with which sessions begin at once."""
_SECONDS: Final = 5.0
"""Seconds within which the socket's process answers; it waits a shorter time for its kernels."""
_CHUNK: Final = 1 << 18

Answers = Mapping[tuple[str, str], Any]
"""The kernels' answers, by address and epoch."""


def said_by_many(wanted: Iterable[Entry], operation: str) -> Answers:
    """The answers of kernels to a call, from sockets that carry sessions with more than `FEW` of the wanted kernels. A
    kernel that is missing here has not answered, but may run.
    """
    by_path: dict[str, int] = {}
    for entry in wanted:
        if entry.carried:
            by_path[entry.path] = by_path.get(entry.path, 0) + 1
    found: dict[tuple[str, str], Any] = {}
    for path, count in by_path.items():
        if count > FEW:
            with suppress(OSError, AiortsError, ValueError, TypeError):
                found |= _asked(path, operation, time.monotonic() + _SECONDS)
    return found


def _asked(path: str, operation: str, until: float) -> Answers:
    """Ask one socket. Raises OSError, and AiortsError, ValueError or TypeError for a malformed answer."""
    buffer = bytearray()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.settimeout(max(0.001, until - time.monotonic()))
        asking.connect(path)
        asking.sendall(framed({"every": operation}))
        while True:
            asking.settimeout(max(0.001, until - time.monotonic()))
            if not (data := asking.recv(_CHUNK)):
                return {}
            buffer += data
            for frame in frames(buffer, ANSWERS):
                said = answer_in(frame).get("said") or ()
                return {(address, epoch): value for address, epoch, value in said if isinstance(value, dict)}
