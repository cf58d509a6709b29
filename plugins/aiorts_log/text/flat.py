"""Reads a recording in lines of text, with the interface of `RecordingReader`; each format parses its own lines.

The file is read once, in blocks, when it is opened: for ports, times, counts, and places to look for a time. Lines have
no checksum: the reader finds lines that cannot be parsed, a torn last line, and an end report with another count.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

from aiorts.errors import RecordError, WireError
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.encodings import SCHEMA_ENCODING, named_type
from aiorts_log.mcap.format import Attachment, BadBytes, Channel, Schema
from aiorts_log.mcap.reader import RecordedPort, RecordedSample, Recording
from aiorts_log.mcap.source import Header, Limits, Piece, open_regular, read_at
from aiorts_log.mcap.survey import Gap

LONGEST: Final = 2**25
"""Bytes of a line; writers refuse a sample that would have more."""
_BLOCK: Final = 2**20
_PIECE: Final = 2**16
_APART: Final = 1_000_000_000
"""Nanoseconds without samples after which a new piece begins, so that gaps show."""
_MOST_PORTS: Final = 65_535
_MOST_GAPS: Final = 10_000
"""Places of damage that are reported one by one; the last of them includes what follows."""


class Head(NamedTuple):
    """The content of a line: its port (a key of the format's own), its log time in ns, and the bytes of its sample."""

    key: Any
    log_time: int
    data: bytes


class FlatPort(RecordedPort):
    """A port of a recording in lines, which names the types without explaining them."""

    @cached_property
    def unknown(self) -> str:
        """The reason why its samples cannot become records; "" when they can."""
        return named_type(self.type_name)[1]


class _Runs:
    """Collects lines that follow each other into pieces small enough to search for a time.

    Args:
        before: gets the number of lines in front of each piece, by its offset.
    """

    def __init__(self, before: dict[int, int]) -> None:
        self.pieces: list[Piece] = []
        self._before = before
        self._open: list[int] = []
        """Offset, first and last log time of the open piece."""

    def add(self, at: int, number: int, time: int) -> None:
        """Add the sample of that time in the line `number`, at the offset `at`."""
        run = self._open
        if run and at - run[0] < _PIECE and time - run[2] < _APART:
            if time < run[1]:
                run[1] = time
            elif time > run[2]:
                run[2] = time
            return
        self.end(at)
        self._before[at] = number - 1
        self._open = [at, time, time]

    def skip(self, at: int) -> None:
        """Pass over a line without a sample; many such lines end the piece, which could have any size otherwise."""
        if self._open and at - self._open[0] >= _PIECE:
            self.end(at)

    def end(self, at: int) -> None:
        """End the open piece at this offset."""
        if self._open:
            begin, low, high = self._open
            self.pieces.append(Piece(low, high, begin, at - begin, chunk=False))
            self._open = []


def note(gaps: list[Gap], gap: Gap, *, apart: bool = False) -> None:
    """Add a line that is no sample to the gaps. After very many gaps it widens the last one, unless `apart`."""
    if apart or len(gaps) < _MOST_GAPS:
        gaps.append(gap)
    else:
        gaps[-1] = gaps[-1]._replace(length=gap.offset + gap.length - gaps[-1].offset)


class FlatReader(Recording):
    """An open recording in lines; attributes and errors as those of `RecordingReader`."""

    encoding: ClassVar[str] = "json"
    """The encoding of its samples' bytes."""
    port_kind: ClassVar[type[FlatPort]] = FlatPort
    made_by: ClassVar[str] = ""

    def __init__(self, path: str | os.PathLike[str], *, limits: Limits | None = None) -> None:
        self.path = Path(path)
        self.limits = limits or Limits()
        self.header = Header("", self.made_by)
        self.complete = True
        """Whether the last line has an end."""
        self._ids: dict[Any, int] = {}
        self._ports = {}
        self._lines_before: dict[int, int] = {}
        self._counts = {}
        self._attachments: list[Attachment] = []
        self._about: dict[tuple[str, str], dict[str, str]] = {}
        self._file, self.size = open_regular(self.path)
        try:
            self._scan()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; samples cannot be read any more."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)

    # -- what a format defines ----------------------------------------------------------------------------------------

    def head(self, line: bytes) -> Head:
        """Parse a line. BadBytes for one that is no sample."""
        raise NotImplementedError

    def whole(self, data: bytes) -> None:
        """Check that the bytes of a sample are whole, as of a last line without an end. BadBytes when they are torn."""
        try:
            json.loads(data)
        except (ValueError, RecursionError) as error:
            raise BadBytes(f"no JSON: {str(error)[:80]}") from None

    def named(self, key: Any) -> tuple[str, str]:
        """Port and type of a key. BadBytes for one that is impossible."""
        raise NotImplementedError

    def published(self, data: bytes, log_time: int) -> int:
        """The time stamp in the bytes of a sample, or `log_time` when there is none."""
        raise NotImplementedError

    def remark(self, line: bytes, number: int) -> None:
        """Read a line that begins with #; by default it is passed over."""

    # -- what it holds ---------------------------------------------------------------------------------------------

    def attachments(self) -> Iterator[Attachment]:
        """The files within the file."""
        return iter(self._attachments)

    def check(self) -> tuple[Gap, ...]:
        """Find what is damaged, and samples that are no value of their type."""
        gaps = [*self.damage, *([self.torn] if self.torn else [])]
        for piece in self.pieces:
            for channel, line, _, _, data in self._load(piece):
                port = self._ports[channel]
                try:
                    _ = port.plain(data) if port.unknown else port.decode(data)
                except (WireError, RecordError) as error:
                    gaps.append(Gap(piece.offset, len(data), f"line {line}: {error}"))
        if self.fault and not gaps:
            gaps.append(Gap(0, 0, self.fault))
        return tuple(gaps)

    def port_of(self, key: Any) -> RecordedPort:
        """The port of a key. BadBytes for one that is impossible."""
        return self._ports[self._ids.get(key) or self._define(key)]

    def lines(self) -> Iterator[bytes]:
        """Every line as it is, without its end. DamagedError for a line that is longer than allowed."""
        parts: list[bytes] = []
        at = held = 0
        self.complete = True
        while at < self.size and (block := read_at(self.path, self._file, min(_BLOCK, self.size - at), at)):
            at += len(block)
            first, *lines = block.split(b"\n")
            parts.append(first)
            held += len(first)
            if held > LONGEST:
                raise DamagedError(
                    f"{self.path}: byte {at - held}: a line has more than the {LONGEST} bytes that are allowed", at
                )
            if lines:
                yield b"".join(parts)
                parts = [lines.pop()]
                held = len(parts[0])
                yield from lines
        if held:
            self.complete = False
            yield b"".join(parts)

    # -- reading ---------------------------------------------------------------------------------------------------

    def _scan(self) -> None:
        """Find ports, times and counts; a line that cannot be parsed is damage, or the torn end."""
        damage: list[Gap] = []
        runs = _Runs(self._lines_before)
        at = 0
        for number, line in enumerate(self.lines(), 1):
            if line[:1] == b"#" or not line.strip():
                runs.skip(at)
                self.remark(line, number)
            else:
                try:
                    key, time, data = self.head(line)
                    if not self.complete:
                        self.whole(data)
                    channel = self._ids.get(key) or self._define(key)
                except BadBytes as error:
                    note(damage, Gap(at, len(line), f"line {number}: {error}"), apart=not self.complete)
                    runs.end(at)
                else:
                    self._counts[channel] += 1
                    runs.add(at, number, time)
            at += len(line) + 1
        runs.end(min(at, self.size))
        self.pieces, self.damage = tuple(runs.pieces), tuple(damage)
        for channel, port in self._ports.items():
            port.count = self._counts[channel]
        self._end_scan()

    def _end_scan(self) -> None:
        """Separate the torn end from damage: the torn end is the last line, if it has no line end."""
        if self.complete or not self.size:
            if self.damage and not self.fault:
                self.fault = self.damage[0].why
            return
        self.clean = False
        last = self.damage[-1] if self.damage else None
        if last is not None and last.offset + last.length == self.size:
            self.torn, self.damage = last, self.damage[:-1]
        if self.damage and not self.fault:
            self.fault = self.damage[0].why

    def _define(self, key: Any) -> int:
        name, type_name = self.named(key)
        if len(self._ids) >= _MOST_PORTS:
            raise BadBytes(f"a recording has at most {_MOST_PORTS} ports")
        number = self._ids[key] = len(self._ids) + 1
        about = self._about.get((name, type_name), {})
        channel = Channel(number, number, name, self.encoding, about)
        self._ports[number] = self.port_kind(channel, Schema(number, type_name, SCHEMA_ENCODING, b"{}"), 0)
        self._counts[number] = 0
        return number

    def _loader(self) -> Callable[[Piece], Any]:
        return self._load

    def _load(self, piece: Piece) -> list[Any]:
        if self._file < 0:
            raise RecordingError(f"{self.path}: is closed here; open it again")
        block = read_at(self.path, self._file, piece.length, piece.offset)
        found, number = [], self._lines_before[piece.offset]
        for line in block.split(b"\n"):
            number += 1
            if line[:1] == b"#" or not line.strip():
                continue
            try:
                key, time, data = self.head(line)
                found.append((self._ids[key], number, time, self.published(data, time), data))
            except (BadBytes, KeyError):
                raise DamagedError(f"{self.path}: line {number}: has changed since the file was opened") from None
        return found

    def _place(self, sample: RecordedSample) -> str:
        return f"line {sample.sequence}"

    def _damaged(self, gap: Gap) -> DamagedError:
        return DamagedError(f"{self.path}: {gap.why}; aiorts log salvage copies what is whole", gap.offset)
