"""What many kernels say to one call, where one socket carries the sessions with them: one question, and no session.

The frame `{"every": "names"}` asks; `{"said": [["host/kernel", epoch, value], ...]}` has those that answered in time.
A few kernels are not asked so: sessions with them begin at once, and are wanted next.
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
"""So many kernels of one socket have sessions at once."""
_SECONDS: Final = 5.0
"""Within which the socket's process answers, which waits for kernels less long."""
_CHUNK: Final = 1 << 18

Answers = Mapping[tuple[str, str], Any]
"""What was said, by address and epoch."""


def said_by_many(wanted: Iterable[Entry], operation: str) -> Answers:
    """What kernels say to a call, of those sockets that carry sessions with more than a few of these.

    Who does not answer is not in it: that says nothing of it.
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
    """Raises what a socket raises, and AiortsError, ValueError or TypeError for an answer that is none."""
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
