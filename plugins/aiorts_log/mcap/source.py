"""Reads a file as a recording: opened without waiting, read by position, within limits.

Lengths in a file are not trusted: each is compared with the file's size and a limit before anything is read. Any number
of readers can share a source.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.mcap.chunks import Content, Tally, contents, tally, unpack
from aiorts_log.mcap.format import (
    ATTACHMENT,
    CHUNK,
    HEAD,
    HEADER,
    MAGIC,
    MESSAGE_INDEX,
    Attachment,
    BadBytes,
    ChunkHead,
    ChunkPlace,
    Cursor,
)

MIB: Final = 2**20
_VERSION: Final = re.compile(r"recording format (\d{1,9})\.(\d{1,9})")
_DEFINED: Final = 20_000
"""The most definitions of a chunk, however well it is compressed: ports, types, entries of metadata; 8 bytes or more
each."""
MAJOR: Final = 1
MINOR: Final = 0


_FOR_EACH_BYTE: Final = {"messages": 1.0, "unpacked": 100.0, "chunks": 1 / 64}
"""The amounts that each byte of a file adds to the budgets, see `Limits`. Well compressed numbers take at least 4
bytes for a message; a chunk takes more than 64."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The memory and time that a file may cost.

    The first four are bytes of memory. The others are budgets of a whole recording that grow with its size: a small
    file costs little, and a large file can be read. None is no budget.
    """

    record: int = 64 * MIB + 4096
    """Bytes of one record or chunk as it is in the file."""
    chunk: int = 64 * MIB + 4096
    """Bytes of an unpacked chunk."""
    summary: int = 64 * MIB
    """Bytes of the index at the end."""
    overlap: int = 64 * MIB
    """Bytes of chunks held at once because their times overlap."""
    messages: int | None = 100_000
    """Messages; one more is allowed for each byte of the file."""
    unpacked: int | None = 16 * MIB
    """Bytes of all chunks, unpacked; 100 more are allowed for each byte of the file."""
    chunks: int | None = 10_000
    """Chunks; one more is allowed for each 64 bytes of the file."""

    @classmethod
    def unlimited(cls) -> Limits:
        """Limits without budgets, for a recording that is trusted."""
        return cls(messages=None, unpacked=None, chunks=None)


class Header(NamedTuple):
    """The first record of a file."""

    profile: str
    library: str


class Piece(NamedTuple):
    """A chunk, or a run of messages outside chunks: a range of the file with messages between two times."""

    start: int
    end: int
    offset: int
    length: int
    chunk: bool = True
    filled: bool = True
    """Whether the piece has messages. Without, it has the times 0 and 0, which are also valid times."""
    unpacked: int = 0
    """Bytes of the chunk, unpacked."""


def read_at(path: Path, file: int, length: int, offset: int) -> bytes:
    """Read bytes of an open file, fewer at the file's end. RecordingError with the file's name when the disk fails."""
    try:
        return os.pread(file, length, offset)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read at byte {offset}: {error.strerror or error}") from None


def open_regular(path: Path) -> tuple[int, int]:
    """Open a regular file without waiting; return descriptor and size. RecordingError with the reason when it fails."""
    # O_NONBLOCK: opening a named pipe would wait for a writer.
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


class Source:
    """An open file.

    Raises:
        RecordingError: it cannot be opened, or is no recording.
    """

    def __init__(self, path: str | os.PathLike[str], limits: Limits) -> None:
        self.path = Path(path)
        self.limits = limits
        self._file, self.size = open_regular(self.path)
        try:
            self.header, self.begin = self._begin()
        except BaseException:
            os.close(self._file)
            raise

    def _begin(self) -> tuple[Header, int]:
        first = read_at(self.path, self._file, len(MAGIC), 0)
        if first[:5] == MAGIC[:5] and len(first) == len(MAGIC) and first[6:] == MAGIC[6:] and first != MAGIC:
            raise RecordingError(f"{self.path}: MCAP of version {chr(first[5])!r}; this reads version '0'")
        if first != MAGIC:
            what = "it is empty" if not first else f"it does not begin with {MAGIC!r}"
            if MAGIC.startswith(first) and first:
                what = f"it ends after {len(first)} bytes"
            raise RecordingError(f"{self.path}: no recording: {what}")
        try:
            opcode, length = HEAD.unpack(self.read(len(MAGIC), HEAD.size))
            if opcode != HEADER or length > MIB:
                raise BadBytes(f"a record {opcode} of {length} bytes stands where the header has to be")
            cursor = Cursor(self.read(len(MAGIC) + HEAD.size, length))
            header = Header(cursor.text(), cursor.text())
        except BadBytes as error:
            raise DamagedError(f"{self.path}: byte {len(MAGIC)}: {error}; nothing can be read", len(MAGIC)) from None
        found = _VERSION.search(header.library) if header.profile == "aiorts" else None
        if found is not None and int(found[1]) > MAJOR:
            raise RecordingError(
                f"{self.path}: written by {header.library[:60]}; this reads <= {MAJOR}; install a newer"
            )
        self.minor = int(found[2]) if found is not None else 0
        return header, len(MAGIC) + HEAD.size + length

    def read(self, offset: int, length: int) -> bytes:
        """Read that many bytes. BadBytes where the file has fewer."""
        if self._file < 0:
            raise RecordingError(f"{self.path}: is closed here; open it again")
        if length > self.limits.record:
            raise BadBytes(f"a record of {length} bytes; at most {self.limits.record} are allowed")
        if offset + length > self.size:
            raise BadBytes(f"expected {length} more bytes, got {max(0, self.size - offset)}")
        found = read_at(self.path, self._file, length, offset)
        while len(found) < length:
            more = read_at(self.path, self._file, length - len(found), offset + len(found))
            if not more:
                raise BadBytes(f"expected {length} more bytes, got {len(found)}")
            found += more
        return found

    def allow(self, **held: int) -> None:
        """Compare amounts of the whole recording with the budgets of `Limits`. RecordingError when one is too much."""
        for name, count in held.items():
            budget = getattr(self.limits, name)
            if budget is not None and count > (most := budget + int(self.size * _FOR_EACH_BYTE[name])):
                what = "bytes unpacked" if name == "unpacked" else name
                raise RecordingError(
                    f"{self.path}: {self.size} bytes hold {count} {what}; {most} are read of such a file; "
                    "--unlimited of aiorts log reads it all the same"
                )

    def head(self, offset: int) -> tuple[int, int]:
        """The kind of the record at `offset` and its size in bytes. BadBytes for one that is impossible."""
        opcode, length = HEAD.unpack(self.read(offset, HEAD.size))
        if opcode == 0 or length > self.size - offset - HEAD.size:
            raise BadBytes(f"a record {opcode} should have {length} bytes, got {self.size - offset - HEAD.size}")
        return opcode, HEAD.size + length

    def chunk_head(self, offset: int) -> tuple[ChunkHead, int]:
        """The head of the chunk at `offset`, and the chunk's size in bytes.

        Raises:
            BadBytes: there is no chunk, or its head is impossible.
        """
        opcode, length = self.head(offset)
        if opcode != CHUNK:
            raise BadBytes(f"a record {opcode} stands where a chunk has to be")
        head = ChunkHead.take(self.read(offset + HEAD.size, min(72, length - HEAD.size)))
        if head.uncompressed > self.limits.chunk:
            raise BadBytes(f"a chunk of {head.uncompressed} bytes; at most {self.limits.chunk} are allowed")
        if HEAD.size + head.size + head.stored != length or head.start > head.end:
            raise BadBytes("the head of a chunk contradicts itself")
        return head, length

    def load(self, piece: Piece) -> Content:
        """The content of a chunk or run, after its checksum was verified.

        Raises:
            BadBytes: the bytes are not those that were written, or contradict the index.
        """
        return contents(*self._checked(piece))

    def tally(self, piece: Piece) -> Tally:
        """Count the content of a piece, after the checks of `load`, without keeping it. Errors as of `load`."""
        return tally(*self._checked(piece))

    def records(self, piece: Piece) -> tuple[bytes, int]:
        """The bytes of a piece, after the checks of `load` of the whole, and where its records begin."""
        return self._checked(piece)[:2]

    def _checked(self, piece: Piece) -> tuple[bytes, int, int, int, int]:
        """The bytes of a piece, where its records begin, the bounds of their times, and how much it may define."""
        if not piece.chunk:
            return self.read(piece.offset, piece.length), 0, 0, 2**64 - 1, piece.length
        head, length = self.chunk_head(piece.offset)
        if (head.start, head.end, length, head.uncompressed) != (piece.start, piece.end, piece.length, piece.unpacked):
            raise BadBytes("the index contradicts a chunk")
        data, at = unpack(head, self.read(piece.offset, length), HEAD.size + head.size)
        return data, at, head.start, head.end, max(piece.length // 8, _DEFINED)

    def place(self, piece: Piece) -> ChunkPlace:
        """The index entry of a whole chunk. BadBytes if there is none."""
        head, length = self.chunk_head(piece.offset)
        indexes: dict[int, int] = {}
        at = after = piece.offset + length
        with contextlib.suppress(BadBytes):
            while at < self.size and self.head(at)[0] == MESSAGE_INDEX:
                size = self.head(at)[1]
                indexes[Cursor(self.read(at + HEAD.size, 2)).u16()] = at
                at += size
        sizes = head.compression, head.stored, head.uncompressed
        return ChunkPlace(head.start, head.end, piece.offset, length, indexes, at - after, *sizes)

    def attachment(self, offset: int, length: int) -> Attachment:
        """The attachment at `offset`. BadBytes if it is not what was written."""
        if self.head(offset) != (ATTACHMENT, length):
            raise BadBytes("there is no attachment where the index has one")
        return Attachment.take(self.read(offset, length)[HEAD.size :])

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)
