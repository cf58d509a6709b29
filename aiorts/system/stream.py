"""Writing lines to a stream that may be slow: a line is written at once where that cannot block, else in a thread.

The event loop never waits for who reads: a pipe or terminal that takes no more is written to in a worker thread, and
only who asked for the line waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import stat
import sys
from collections.abc import Iterable, Iterator
from typing import Final, TextIO

__all__ = ("LineStream",)

_SURE: Final = 4096
"""Bytes that a pipe which is ready takes without blocking (PIPE_BUF on Linux)."""


class LineStream:
    """Lines to standard output as it is at each write (somebody may have redirected it), or to the stream given."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream

    async def write(self, lines: Iterable[str]) -> None:
        """Write these lines, each with its end.

        Raises:
            OSError: the stream takes nothing any more (BrokenPipeError: its reader has gone).
        """
        stream = sys.stdout if self._stream is None else self._stream
        if stream is None:
            return  # started without standard output
        for part in _parts(lines, getattr(stream, "encoding", None) or "utf-8"):
            if _takes(stream, part):
                _put(stream, part)
            else:
                await asyncio.to_thread(_put, stream, part)


def _put(stream: TextIO, text: str) -> None:
    try:
        stream.write(text)
        stream.flush()
    except ValueError as error:
        raise BrokenPipeError(f"standard output is closed: {error}") from None


def _parts(lines: Iterable[str], encoding: str) -> Iterator[str]:
    """The lines joined to parts of at most `_SURE` bytes each, a longer line alone; what the encoding lacks escaped."""
    part: list[str] = []
    size = 0
    narrow = len("\n".encode(encoding)) == 1
    for line in lines:
        text, length = f"{line}\n", len(line) + 1
        if not (narrow and text.isascii()):
            data = text.encode(encoding, "backslashreplace")
            text, length = data.decode(encoding), len(data)
        if part and size + length > _SURE:
            yield "".join(part)
            part, size = [], 0
        part.append(text)
        size += length
    if part:
        yield "".join(part)


def _takes(stream: TextIO, text: str) -> bool:
    """Whether the stream takes the text without making us wait."""
    try:
        descriptor = stream.fileno()
        mode = os.fstat(descriptor).st_mode
    except (OSError, ValueError, AttributeError):
        return True  # in memory, or closed: writing says which
    if stat.S_ISREG(mode) or not hasattr(select, "poll"):
        return True
    if len(text) * 4 > _SURE and len(text.encode("utf-8", "replace")) > _SURE:
        return False
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    with contextlib.suppress(OSError):
        return bool(poll.poll(0))
    return True
