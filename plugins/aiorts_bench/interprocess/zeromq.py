"""A pair of sockets of ZeroMQ between two processes, over TCP."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

STREAM: Final = b"s"
"""The first byte of messages that are not sent back."""
LAST: Final = STREAM + b"last"


@contextmanager
def opened(role: str, endpoint: str) -> Iterator[Any]:
    """A socket that listens or connects (`role`), with methods to await."""
    import zmq.asyncio  # type: ignore[import-not-found, unused-ignore]

    context: Any = zmq.asyncio.Context()
    sock = context.socket(zmq.PAIR)
    try:
        sock.setsockopt(zmq.LINGER, 0)
        (sock.bind if role == "listen" else sock.connect)(endpoint)
        yield sock
    finally:
        sock.close()
        context.term()
