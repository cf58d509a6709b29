"""A recording in lines of text, read with the face of `RecordingReader`; what a line says is for the form to know.

The file is read once when it is opened, in blocks: ports, times and counts, and where to look for a time. Lines have
no checksum: what is found is that a line is none, that the last one is torn, or that the end counts other samples.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Final, Literal, NamedTuple, Self

from aiorts.errors import RecordError, WireError
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.form import Attachment, BadOctets, Channel, Schema
from aiorts_log.forms import SCHEMA_ENCODING, known_type, taker
from aiorts_log.merge import merged
from aiorts_log.reader import RecordedPort, RecordedSample
from aiorts_log.source import Header, Limits, Piece
from aiorts_log.survey import Gap

__all__ = ("LONGEST", "FlatPort", "FlatReader", "Head", "note", "open_regular")

LONGEST: Final = 2**25
"""Octets of a line; who writes one refuses a sample that would have more."""
_BLOCK: Final = 2**20
_PIECE: Final = 2**16
_APART: Final = 1_000_000_000
"""Nanoseconds without samples after which a new piece begins, so that gaps show."""
_SHOWN: Final = 60
_MOST_PORTS: Final = 65_535
_MOST_GAPS: Final = 10_000
"""Places of damage that are told one by one; what follows is told with the last of them."""


class Head(NamedTuple):
    """What a line says of its sample: its port (a key of the form's own), its log time in ns, and its octets."""

    key: Any
    log_time: int
    data: bytes


class FlatPort(RecordedPort):
    """A port of a recording in lines, which names the types but does not explain them."""

    @cached_property
    def unknown(self) -> str:
        """Why its samples cannot become records here; "" when they can."""
        if known_type(self.type_name) is None:
            return f"no type {self.type_name[:80]!r} is known here; import the module that defines it"
        return ""

    @cached_property
    def decode(self) -> Callable[[bytes], Any]:
        """Makes a record of the octets of a sample; RecordingError when its type is not known here."""
        if self.unknown:
            raise RecordingError(f"port {self.name!r}: {self.unknown}")
        return taker(self.type, self.encoding)


class _Runs:
    """Lines that follow each other, in pieces small enough to look for a time in; where each lies.

    Args:
        before: takes the number of lines in front of each piece, by its offset.
    """

    def __init__(self, before: dict[int, int]) -> None:
        self.pieces: list[Piece] = []
        self._before = before
        self._open: list[int] = []
        """Offset, first and last log time of the open piece."""

    def add(self, at: int, number: int, time: int) -> None:
        """The line of that number, at that offset, is a sample of that time."""
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
        """The line there is nothing to load; many of them would make a piece of any size."""
        if self._open and at - self._open[0] >= _PIECE:
            self.end(at)

    def end(self, at: int) -> None:
        """The open piece ends there."""
        if self._open:
            begin, low, high = self._open
            self.pieces.append(Piece(low, high, begin, at - begin, chunk=False))
            self._open = []


def note(gaps: list[Gap], gap: Gap, *, apart: bool = False) -> None:
    """Add a line that is no sample to those before it; where there are very many it widens the last, unless `apart`."""
    if apart or len(gaps) < _MOST_GAPS:
        gaps.append(gap)
    else:
        gaps[-1] = gaps[-1]._replace(length=gap.offset + gap.length - gaps[-1].offset)


def open_regular(path: Path) -> tuple[int, int]:
    """The descriptor of a regular file, opened without waiting, and its size. RecordingError says why there is none."""
    flags = os.O_RDONLY | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        file = os.open(path, flags)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    found = os.fstat(file)
    if not stat.S_ISREG(found.st_mode):
        os.close(file)
        what = "a folder" if stat.S_ISDIR(found.st_mode) else "no regular file"
        raise RecordingError(f"{path}: is {what}; name a recording")
    return file, found.st_size


class FlatReader:
    """An open recording in lines; attributes and errors as those of `RecordingReader`."""

    encoding: ClassVar[str] = "json"
    """Of the octets of its samples."""
    port_kind: ClassVar[type[FlatPort]] = FlatPort
    made_by: ClassVar[str] = ""

    def __init__(self, path: str | os.PathLike[str], *, limits: Limits | None = None) -> None:
        self.path = Path(path)
        self.limits = limits or Limits()
        self.header = Header("", self.made_by)
        self.fault = ""
        self.torn: Gap | None = None
        self.damage: tuple[Gap, ...] = ()
        self.clean = True
        self.complete = True
        """Whether the last line has an end."""
        self.skipped = 0
        self.pieces: tuple[Piece, ...] = ()
        self._ids: dict[Any, int] = {}
        self._ports: dict[int, RecordedPort] = {}
        self._lines_before: dict[int, int] = {}
        self._counts: dict[int, int] = {}
        self._attachments: list[Attachment] = []
        self._documents: dict[str, list[Any]] = {"metadata": [], "end": []}
        self._about: dict[tuple[str, str], dict[str, str]] = {}
        self._file, self.octets = open_regular(self.path)
        try:
            self._scan()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let the file go; samples cannot be had any more."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)

    # -- the form says ---------------------------------------------------------------------------------------------

    def head(self, line: bytes) -> Head:
        """What a line says. BadOctets for one that is no sample."""
        raise NotImplementedError

    def whole(self, data: bytes) -> None:
        """Look closer at the octets of a sample, as of the last line without an end. BadOctets when they are torn."""
        try:
            json.loads(data)
        except (ValueError, RecursionError) as error:
            raise BadOctets(f"no JSON: {str(error)[:80]}") from None

    def named(self, key: Any) -> tuple[str, str]:
        """Port and type of a key. BadOctets for one that cannot be."""
        raise NotImplementedError

    def published(self, data: bytes, log_time: int) -> int:
        """The time stamp in the octets of a sample, or `log_time` when there is none."""
        raise NotImplementedError

    def remark(self, line: bytes, number: int) -> None:
        """Take a line that begins with #."""

    # -- what it holds ---------------------------------------------------------------------------------------------

    @cached_property
    def ports(self) -> Mapping[str, RecordedPort]:
        """Its ports by name; a name that has two types stands there twice, as NAME and NAME#NUMBER."""
        found: dict[str, RecordedPort] = {}
        for port in self._ports.values():
            found[port.name if port.name not in found else f"{port.name}#{port.id}"] = port
        return found

    @property
    def count(self) -> int:
        """How many samples it has."""
        return sum(self._counts.values())

    @cached_property
    def start(self) -> int:
        """The first log time, in ns; 0 when it has no samples."""
        return min((piece.start for piece in self.pieces), default=0)

    @cached_property
    def end(self) -> int:
        """The last log time, in ns."""
        return max((piece.end for piece in self.pieces), default=0)

    def attachments(self) -> Iterator[Attachment]:
        """The files within the file."""
        return iter(self._attachments)

    @property
    def metadata(self) -> tuple[Any, ...]:
        """What was known of the system when the recording was begun, and each time that it was continued."""
        return tuple(self._documents["metadata"])

    @property
    def endings(self) -> tuple[Any, ...]:
        """What the writer counted and why it ended, each time that it did."""
        return tuple(self._documents["end"])

    def samples(
        self,
        *,
        start: int | None = None,
        end: int | None = None,
        ports: Collection[str] | None = None,
        order: Literal["time", "file"] = "time",
    ) -> Iterator[RecordedSample]:
        """Samples in the order of their log time; `sequence` is the number of the line. As `RecordingReader.samples`.

        Raises:
            DamagedError: a line is no sample; everything before was given.
        """
        wanted = self._wanted(ports)
        first, last = start if start is not None else -1, end if end is not None else 2**64
        hole = self.damage[0].offset if self.damage else self.octets
        pieces = [piece for piece in self.pieces if piece.end >= first and piece.start < last]
        whole = [piece for piece in pieces if piece.offset < hole]
        for message in merged(whole, self._load, self.limits.overlap, order == "time"):
            channel, line, log_time, _, data = message
            if first <= log_time < last and (port := wanted.get(channel)) is not None:
                yield RecordedSample(port, log_time, self.published(data, log_time), line, data)
        if self.damage and (last == 2**64 or len(whole) < len(pieces)):
            raise self._damaged(self.damage[0])

    def records(self, **chosen: Any) -> Iterator[tuple[str, int, Any]]:
        """Port, log time and record of each sample; arguments and errors as of `samples`.

        Raises:
            RecordingError: the type of one of the ports is not known here.
            DamagedError: a line is none of its type.
        """
        for sample in self.samples(**chosen):
            try:
                yield sample.port.name, sample.log_time, sample.port.decode(sample.data)
            except (WireError, RecordError) as error:
                raise DamagedError(f"{self.path}: line {sample.sequence}: {error}") from None

    def check(self) -> tuple[Gap, ...]:
        """Read everything; what is damaged, and what is no value of its type."""
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
        """The port of a key. BadOctets for one that cannot be."""
        return self._ports[self._ids.get(key) or self._define(key)]

    def lines(self) -> Iterator[bytes]:
        """Every line as it is, without its end. DamagedError for one that is longer than is allowed."""
        parts: list[bytes] = []
        at = held = 0
        self.complete = True
        while at < self.octets and (block := os.pread(self._file, min(_BLOCK, self.octets - at), at)):
            at += len(block)
            first, *lines = block.split(b"\n")
            parts.append(first)
            held += len(first)
            if held > LONGEST:
                raise DamagedError(
                    f"{self.path}: octet {at - held}: a line has more than the {LONGEST} octets that are allowed", at
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
        """Find ports, times and counts; what is no line is damage, or the torn end."""
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
                except BadOctets as error:
                    note(damage, Gap(at, len(line), f"line {number}: {error}"), apart=not self.complete)
                    runs.end(at)
                else:
                    self._counts[channel] += 1
                    runs.add(at, number, time)
            at += len(line) + 1
        runs.end(min(at, self.octets))
        self.pieces, self.damage = tuple(runs.pieces), tuple(damage)
        for channel, port in self._ports.items():
            port.count = self._counts[channel]
        self._end_scan()

    def _end_scan(self) -> None:
        """Tell a torn end from damage: the last line of a file that does not end with a line's end."""
        if self.complete or not self.octets:
            if self.damage and not self.fault:
                self.fault = self.damage[0].why
            return
        self.clean = False
        last = self.damage[-1] if self.damage else None
        if last is not None and last.offset + last.length == self.octets:
            self.torn, self.damage = last, self.damage[:-1]
        if self.damage and not self.fault:
            self.fault = self.damage[0].why

    def _define(self, key: Any) -> int:
        name, type_name = self.named(key)
        if len(self._ids) >= _MOST_PORTS:
            raise BadOctets(f"a recording has at most {_MOST_PORTS} ports")
        number = self._ids[key] = len(self._ids) + 1
        about = self._about.get((name, type_name), {})
        channel = Channel(number, number, name, self.encoding, about)
        self._ports[number] = self.port_kind(channel, Schema(number, type_name, SCHEMA_ENCODING, b"{}"), 0)
        self._counts[number] = 0
        return number

    def _load(self, piece: Piece) -> list[Any]:
        if self._file < 0:
            raise RecordingError(f"{self.path}: is closed here; open it again")
        octets = os.pread(self._file, piece.length, piece.offset)
        found, number = [], self._lines_before[piece.offset]
        for line in octets.split(b"\n"):
            number += 1
            if line[:1] == b"#" or not line.strip():
                continue
            try:
                key, time, data = self.head(line)
                found.append((self._ids[key], number, time, time, data))
            except (BadOctets, KeyError):
                raise DamagedError(f"{self.path}: line {number}: has changed since the file was opened") from None
        return found

    def _wanted(self, names: Collection[str] | None) -> dict[int, RecordedPort]:
        if names is None:
            return self._ports
        if missing := [name for name in names if name not in self.ports]:
            there = ", ".join(list(self.ports)[:20]) or "none"
            raise RecordingError(f"{self.path}: no port {missing[0][:_SHOWN]!r}; there are {there}")
        return {self.ports[name].id: self.ports[name] for name in names}

    def _damaged(self, gap: Gap) -> DamagedError:
        return DamagedError(f"{self.path}: {gap.why}; aiorts log salvage gets what is whole", gap.offset)
