"""Decides which lines of a process are passed on: so many in a second, each so long; the rest is counted.

It never waits and never asks the time. What it keeps is bounded, whatever a process writes.
"""

from __future__ import annotations

from collections import deque

from aiorts.late import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

LINES = 200
"""Lines in a second that are passed on."""
BYTES = 65536
"""Bytes in a second that are passed on."""
LONGEST = 4096
"""Bytes of a line; what is beyond is left out."""
LAST = 20
"""Lines that are kept for a report."""


class Output:
    """Standard output and standard error of one process."""

    def __init__(self) -> None:
        self.due: float | None = None
        """The time at which `due_at` has a remark; None: nothing was left out."""
        self._parts = {"stdout": b"", "stderr": b""}
        self._last: deque[bytes] = deque(maxlen=LAST)
        self._until = 0.0
        self._lines_free = self._bytes_free = 0
        self._lines_left_out = self._bytes_left_out = 0

    def feed(self, stream: str, data: bytes, now: float) -> Iterator[tuple[str, str]]:
        """Add what was read; yield the lines that are passed on, each with its stream."""
        yield from self.due_at(now)
        while self._lines_free > 0 and self._bytes_free > 0:
            line, newline, data = data.partition(b"\n")
            if not newline:
                self._keep(stream, line)
                return
            yield stream, self._taken(stream, line)
        ended, newline, rest = data.rpartition(b"\n")
        if newline:
            lines = ended.rsplit(b"\n", LAST)
            lines[0] = lines[0].rpartition(b"\n")[2]
            self.leave_out(ended.count(b"\n") + 1, len(self._parts[stream]) + len(ended) + 1)
            self._last.extend(line[:LONGEST] for line in lines)
            self._parts[stream] = b""
        self._keep(stream, rest)

    def leave_out(self, lines: int, size: int) -> None:
        """Count what is not passed on."""
        self._lines_left_out += lines
        self._bytes_left_out += size
        self.due = self._until

    def due_at(self, now: float) -> Iterator[tuple[str, str]]:
        """The remark on lines that were left out in the second that is over, if any were."""
        if now < self._until:
            return
        self._until = now + 1.0
        self._lines_free, self._bytes_free = LINES, BYTES
        yield from self._summary()

    def end(self) -> Iterator[tuple[str, str]]:
        """Lines without an end, and what was left out: the process writes no more."""
        for stream, part in self._parts.items():
            if part:
                yield stream, self._taken(stream, b"")
        yield from self._summary()

    @property
    def last_lines(self) -> list[str]:
        """The last lines of both streams, in the order in which they were read."""
        return [_text(line) for line in self._last]

    def _summary(self) -> Iterator[tuple[str, str]]:
        lines, size, self.due = self._lines_left_out, self._bytes_left_out, None
        self._lines_left_out = self._bytes_left_out = 0
        if size:
            yield "stderr", f"... {lines} lines ({size} bytes) left out"

    def _keep(self, stream: str, data: bytes) -> None:
        """Keep the beginning of a line that has not ended yet."""
        part = self._parts[stream] + data
        if len(part) > LONGEST:
            self.leave_out(0, len(part) - LONGEST)
        self._parts[stream] = part[:LONGEST]

    def _taken(self, stream: str, data: bytes) -> str:
        self._keep(stream, data)
        line, self._parts[stream] = self._parts[stream], b""
        self._last.append(line)
        self._lines_free -= 1
        self._bytes_free -= len(line) + 1
        return _text(line)


def _text(line: bytes) -> str:
    return line.decode("utf-8", "replace")
