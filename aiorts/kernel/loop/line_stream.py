"""Writes lines to a stream that may be slow: at once where that cannot block, else from a worker thread.

The event loop never waits for the stream: a thread waits until a pipe or terminal takes more, and only the task that
writes the line waits with it. A line that is longer than a pipe takes for sure is written by the thread itself.
"""

from __future__ import annotations

import asyncio
import io
import os
import select
import stat
import sys
import threading
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import IO, Any, Final, TextIO

from aiorts.errors import AiortsError

SURE: Final = 4096
"""Bytes that a ready pipe takes without blocking (PIPE_BUF on Linux)."""
_LOOK_MS: Final = 100
"""Milliseconds between two checks of a thread that waits for room, whether its task still waits."""


class OutputError(AiortsError, OSError):
    """A stream takes no lines any more although its reader is there: the disk is full, for example."""

    code = "E-OUTPUT"


def standard_output() -> TextIO:
    """The process's standard output as it is now (it may be redirected).

    Raises:
        OutputError: there is none.
    """
    if sys.stdout is None:
        raise OutputError("standard output is closed; redirect it, to /dev/null for one")
    return sys.stdout


class LineStream:
    """Writes lines to the stream given, or to standard output as it is at each write (it may be redirected)."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream

    async def write(self, lines: Iterable[str]) -> None:
        """Write these lines, each with its end.

        Raises:
            BrokenPipeError: its reader has gone, or it was closed.
            OutputError: the system refused the lines (`errno` has the reason), or there is no standard output.
        """
        lines = iter(lines)
        if (first := next(lines, None)) is None:
            return
        lines = chain((first,), lines)
        stream = standard_output() if self._stream is None else self._stream
        for part in _parts(lines, getattr(stream, "encoding", None) or "utf-8"):
            descriptor = slow(stream)
            if descriptor is None:
                put(stream, part)
            elif _is_short(part):
                while not has_room(descriptor):
                    await _room(descriptor)
                put(stream, part)
            else:
                await asyncio.to_thread(put, stream, part)


def put(stream: Any, data: str | bytes) -> None:
    """Write everything to a text or binary stream, waiting for room where the stream itself does not (O_NONBLOCK).

    Raises:
        BrokenPipeError: its reader has gone, or it was closed.
        OutputError: the system refused it; `errno` has the reason.
    """
    try:
        descriptor = _own_descriptor(stream)
        if descriptor is None:
            stream.write(data)
            stream.flush()
        else:
            _put_all(descriptor, data.encode(stream.encoding) if isinstance(data, str) else data)
    except ValueError as error:
        raise BrokenPipeError(f"standard output is closed: {error}") from None
    except BrokenPipeError:
        raise
    except OSError as error:
        refused = OutputError(f"standard output: {error.strerror or error}; its last lines are lost")
        refused.errno = error.errno
        raise refused from None


def _own_descriptor(stream: Any) -> int | None:
    """The descriptor of a stream that only encodes and buffers, with an empty buffer; else None."""
    binary = getattr(stream, "buffer", stream)
    if not isinstance(getattr(binary, "raw", binary), io.FileIO) or os.linesep != "\n" or not hasattr(select, "poll"):
        return None
    descriptor: int = stream.fileno()
    while True:
        try:
            stream.flush()
        except BlockingIOError:  # what had no room is still in the buffer
            has_room(descriptor, _LOOK_MS)
        else:
            return descriptor


def _put_all(descriptor: int, data: bytes) -> None:
    left = memoryview(data)
    while left:
        try:
            left = left[os.write(descriptor, left) :]
        except BlockingIOError:
            has_room(descriptor, _LOOK_MS)


def _parts(lines: Iterable[str], encoding: str) -> Iterator[str]:
    """The lines in parts of at most `SURE` bytes, a longer line alone; characters outside the encoding are escaped."""
    part: list[str] = []
    size = 0
    narrow = len("\n".encode(encoding)) == 1
    for line in lines:
        text, length = f"{line}\n", len(line) + 1
        if not (narrow and text.isascii()):
            data = text.encode(encoding, "backslashreplace")
            text, length = data.decode(encoding), len(data)
        if part and size + length > SURE:
            yield "".join(part)
            part, size = [], 0
        part.append(text)
        size += length
    if part:
        yield "".join(part)


def slow(stream: IO[Any]) -> int | None:
    """The descriptor of a stream that may block its writer; None for files, memory and closed streams."""
    try:
        descriptor = stream.fileno()
        mode = os.fstat(descriptor).st_mode
    except (OSError, ValueError, AttributeError):
        return None  # in memory, or closed: writing raises the error
    return None if stat.S_ISREG(mode) or not hasattr(select, "poll") else descriptor


def _is_short(text: str) -> bool:
    return len(text) * 4 <= SURE or len(text.encode("utf-8", "replace")) <= SURE


def has_room(descriptor: int, wait_ms: int = 0) -> bool:
    """Whether a short text can be written, or writing it would only raise an error."""
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    try:
        return bool(poll.poll(wait_ms))
    except OSError:
        return True


async def _room(descriptor: int) -> None:
    """Wait for room in a thread, which ends soon after its task has stopped waiting: it must not delay the exit."""
    given_up = threading.Event()

    def wait() -> None:
        while not given_up.is_set() and not has_room(descriptor, _LOOK_MS):
            pass

    try:
        await asyncio.to_thread(wait)
    finally:
        given_up.set()
