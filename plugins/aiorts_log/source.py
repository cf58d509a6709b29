"""A file that is read as a recording: opened without waiting, read by position within limits, told of by name.

Nothing that a file says of lengths is believed: everything is held against the file's size and a limit before it is
read. Any number of readers can share one.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from aiorts_log.chunks import Content, Tally, contents, tally, unpack
from aiorts_log.errors import DamagedError, RecordingError
from aiorts_log.form import (
    ATTACHMENT,
    CHUNK,
    HEAD,
    HEADER,
    MAGIC,
    MESSAGE_INDEX,
    Attachment,
    BadOctets,
    ChunkHead,
    ChunkPlace,
    Cursor,
)

__all__ = ("Header", "Limits", "Piece", "Source")

MIB: Final = 2**20
_VERSION: Final = re.compile(r"recording format (\d{1,9})\.(\d{1,9})")
MAJOR: Final = 1
MINOR: Final = 0


@dataclass(frozen=True, slots=True)
class Limits:
    """How much memory a file can ask for, in octets."""

    record: int = 64 * MIB + 4096
    """Of one record or chunk as it lies in the file."""
    chunk: int = 64 * MIB + 4096
    """Of a chunk that was unpacked."""
    summary: int = 64 * MIB
    """Of the index at the end."""
    overlap: int = 64 * MIB
    """Of chunks held at once because their times overlap."""


class Header(NamedTuple):
    """The first record of a file."""

    profile: str
    library: str


class Piece(NamedTuple):
    """A chunk, or a run of messages outside chunks: octets of the file with messages between two times."""

    start: int
    end: int
    offset: int
    length: int
    chunk: bool = True
    filled: bool = True
    """Whether there are messages in it: definitions alone have no times, which is 0 and 0, and 0 is a time, too."""


class Source:
    """An open file.

    Raises:
        RecordingError: it cannot be opened, or is no recording.
    """

    def __init__(self, path: str | os.PathLike[str], limits: Limits) -> None:
        self.path = Path(path)
        self.limits = limits
        flags = os.O_RDONLY | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        try:
            self._file = os.open(self.path, flags)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{self.path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
        try:
            found = os.fstat(self._file)
            if not stat.S_ISREG(found.st_mode):
                what = "a folder" if stat.S_ISDIR(found.st_mode) else "no regular file"
                raise RecordingError(f"{self.path}: is {what}; name a recording (.mcap)")
            self.size = found.st_size
            self.header, self.begin = self._begin()
        except BaseException:
            os.close(self._file)
            raise

    def _begin(self) -> tuple[Header, int]:
        first = os.pread(self._file, len(MAGIC), 0)
        if first[:5] == MAGIC[:5] and len(first) == len(MAGIC) and first[6:] == MAGIC[6:] and first != MAGIC:
            raise RecordingError(f"{self.path}: MCAP of version {chr(first[5])!r}; this reads version '0'")
        if first != MAGIC:
            what = "it is empty" if not first else f"it begins with {first!r}, not with {MAGIC!r}"
            if MAGIC.startswith(first) and first:
                what = f"it ends after {len(first)} octets"
            raise RecordingError(f"{self.path}: no recording: {what}")
        try:
            opcode, length = HEAD.unpack(self.read(len(MAGIC), HEAD.size))
            if opcode != HEADER or length > MIB:
                raise BadOctets(f"a record {opcode} of {length} octets stands where the header has to be")
            cursor = Cursor(self.read(len(MAGIC) + HEAD.size, length))
            header = Header(cursor.text(), cursor.text())
        except BadOctets as error:
            raise DamagedError(f"{self.path}: octet {len(MAGIC)}: {error}; nothing can be read", len(MAGIC)) from None
        found = _VERSION.search(header.library) if header.profile == "aiorts" else None
        if found is not None and int(found[1]) > MAJOR:
            raise RecordingError(
                f"{self.path}: written by {header.library[:60]}; this reads <= {MAJOR}; install a newer"
            )
        self.minor = int(found[2]) if found is not None else 0
        return header, len(MAGIC) + HEAD.size + length

    def read(self, offset: int, length: int) -> bytes:
        """So many octets from there. BadOctets where the file has less."""
        if self._file < 0:
            raise RecordingError(f"{self.path}: is closed here; open it again")
        if length > self.limits.record:
            raise BadOctets(f"a record says it has {length} octets; at most {self.limits.record} are allowed")
        if offset + length > self.size:
            raise BadOctets(f"{length} octets are said to follow, {max(0, self.size - offset)} do")
        found = os.pread(self._file, length, offset)
        while len(found) < length:
            more = os.pread(self._file, length - len(found), offset + len(found))
            if not more:
                raise BadOctets(f"{length} octets are said to follow, {len(found)} do")
            found += more
        return found

    def head(self, offset: int) -> tuple[int, int]:
        """What record stands there, and how many octets it has in all. BadOctets for one that cannot be."""
        opcode, length = HEAD.unpack(self.read(offset, HEAD.size))
        if opcode == 0 or length > self.size - offset - HEAD.size:
            raise BadOctets(f"a record {opcode} says it has {length} octets, {self.size - offset - HEAD.size} follow")
        return opcode, HEAD.size + length

    def chunk_head(self, offset: int) -> tuple[ChunkHead, int]:
        """The head of the chunk that stands there, and how many octets the chunk has in all.

        Raises:
            BadOctets: none stands there, or it says what cannot be.
        """
        opcode, length = self.head(offset)
        if opcode != CHUNK:
            raise BadOctets(f"a record {opcode} stands where a chunk has to be")
        head = ChunkHead.take(self.read(offset + HEAD.size, min(72, length - HEAD.size)))
        if head.uncompressed > self.limits.chunk:
            raise BadOctets(f"a chunk says it has {head.uncompressed} octets; at most {self.limits.chunk} are allowed")
        if HEAD.size + head.size + head.stored != length or head.start > head.end:
            raise BadOctets("the head of a chunk contradicts itself")
        return head, length

    def load(self, piece: Piece) -> Content:
        """What stands in a chunk or run, after its sum was checked.

        Raises:
            BadOctets: the octets are not what was written, or not what the index says.
        """
        return contents(*self._records(piece))

    def tally(self, piece: Piece) -> Tally:
        """How much of what stands in a piece, after the same checks; keeps none of it. BadOctets as of `load`."""
        return tally(*self._records(piece))

    def _records(self, piece: Piece) -> tuple[bytes, int, int, int]:
        """The octets of a piece, where its records begin, and the times between which they are."""
        if not piece.chunk:
            return self.read(piece.offset, piece.length), 0, 0, 2**64 - 1
        head, length = self.chunk_head(piece.offset)
        if (head.start, head.end, length) != (piece.start, piece.end, piece.length):
            raise BadOctets("the index says something else of a chunk than the chunk")
        octets, at = unpack(head, self.read(piece.offset, length), HEAD.size + head.size)
        return octets, at, head.start, head.end

    def place(self, piece: Piece) -> ChunkPlace:
        """What an index is to say of a whole chunk. BadOctets if none stands there."""
        head, length = self.chunk_head(piece.offset)
        indexes: dict[int, int] = {}
        at = after = piece.offset + length
        with contextlib.suppress(BadOctets):
            while at < self.size and self.head(at)[0] == MESSAGE_INDEX:
                size = self.head(at)[1]
                indexes[Cursor(self.read(at + HEAD.size, 2)).u16()] = at
                at += size
        sizes = head.compression, head.stored, head.uncompressed
        return ChunkPlace(head.start, head.end, piece.offset, length, indexes, at - after, *sizes)

    def attachment(self, offset: int, length: int) -> Attachment:
        """The file within the file that stands there. BadOctets if it is not what was written."""
        if self.head(offset) != (ATTACHMENT, length):
            raise BadOctets("no attachment stands where the index says")
        return Attachment.take(self.read(offset, length)[HEAD.size :])

    def close(self) -> None:
        """Let the file go; again it does nothing."""
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)
