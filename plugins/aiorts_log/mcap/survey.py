"""Reads a recording from its beginning without trusting its index: finds what is whole, damaged, and torn off.

Files that were not closed are opened by a survey, and `salvage` uses it. Every chunk is verified; none is kept.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from aiorts_log.mcap.chunks import Tally, signed
from aiorts_log.mcap.format import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    HEAD,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    BadBytes,
    Channel,
    ChunkHead,
    Cursor,
    Schema,
)
from aiorts_log.mcap.source import MINOR, Piece, Source
from aiorts_log.mcap.summary import Summary

MISSED: Final = ("overwritten", "rejected", "timeout", "lost", "inactive")
"""Reasons of a connector's drops that mean a loss for its user."""
GAP: Final = 1_000_000_000
"""Nanoseconds without samples that count as a gap; the writer begins a new chunk after such a time."""

_CANDIDATE: Final = re.compile(rb"\x06[\x00-\xff]{4}\x00{4}", re.DOTALL)
_WINDOW: Final = 2**20
_RUN: Final = 2**18
_PATIENCE: Final = 16
"""The multiple of a file's size that is read while whole chunks are searched for in damaged parts: a file made to look
like many chunks within each other must not take hours."""
_LOOKED: Final = 64
"""Bytes that each place without a chunk costs of that budget."""
_IN_DATA: Final = (CHUNK, MESSAGE, SCHEMA, CHANNEL, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END)
"""Kinds of records before the summary. A record of another kind is damaged, or of a newer version of the format."""
_IN_OURS: Final = (CHUNK, MESSAGE_INDEX, ATTACHMENT, DATA_END)
"""Kinds of records that aiorts writes there: a chunk whose kind a flipped bit has changed is not skipped as another."""


class Gap(NamedTuple):
    """A range of bytes from which nothing can be read."""

    offset: int
    length: int
    why: str


@dataclass(slots=True)
class Survey:
    """The content that was found in a file.

    Attributes:
        pieces: every whole chunk, in the order of the file.
        damage: the broken ranges between them.
        torn: the broken range behind the last of them; None when the data end properly.
        ended: whether the writer marked the data as complete.
        stop: where the data end.
        missing: by channel, how far the numbers of the samples are ahead of their count.
    """

    summary: Summary = field(default_factory=Summary)
    pieces: list[Piece] = field(default_factory=list)
    damage: list[Gap] = field(default_factory=list)
    torn: Gap | None = None
    ended: bool = False
    stop: int = 0
    missing: dict[int, int] = field(default_factory=dict)

    def take(self, piece: Piece, content: Tally) -> int:
        """Count the content of a piece; return how many samples are missing before it, by their numbers.

        Raises:
            BadBytes: the piece contradicts another.
        """
        summary = self.summary
        for schema in content.schemas:
            summary.define(schema)
        for channel in content.channels:
            summary.define(channel=channel)
        missing = 0
        for number, (count, first, ahead) in content.counts.items():
            expected = summary.counts.get(number, 0) + self.missing.get(number, 0)
            ahead += signed(first - expected)
            summary.counts[number] = summary.counts.get(number, 0) + count
            if ahead:
                self.missing[number] = self.missing.get(number, 0) + ahead
                missing += ahead
        summary.skipped += content.skipped
        self.pieces.append(piece._replace(filled=bool(content.counts)))
        return missing


def survey(source: Source) -> Survey:
    """Read a whole file."""
    return _Walk(source).survey()


class _Walk:
    """One pass through a file."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._found = Survey()
        self._suspect: tuple[int, str] | None = None
        """A chunk whose checksum is wrong, and the reason: its length, and so its end, may be wrong as well."""
        self._run: tuple[int, int] | None = None
        self._is_own = source.header.profile == "aiorts"
        self._may_stand = _IN_OURS if self._is_own else _IN_DATA
        self._may_be_newer = not self._is_own or source.minor > MINOR
        self._patience = _PATIENCE * source.size + _WINDOW
        self._unpacked = self._messages = 0
        """Bytes of chunks, and messages, that were found so far."""

    def survey(self) -> Survey:
        source, found = self._source, self._found
        at = source.begin
        while at < source.size and not found.ended:
            try:
                opcode, length = source.head(at)
                if opcode not in self._may_stand and (opcode <= DATA_END or not self._may_be_newer):
                    raise BadBytes(f"a record {opcode}, of a kind that does not stand there")
            except BadBytes as error:
                at = self._broken(at, str(error))
                continue
            if opcode != MESSAGE:
                self._end_run(at)
            at = self._step(opcode, at, length)
        self._end_run(min(at, source.size))
        if self._suspect is not None:
            self._note(self._suspect[0], at, self._suspect[1])
        self._split_tail()
        return found

    def _step(self, opcode: int, at: int, length: int) -> int:
        """Take the record at `at`; return where to look for the next."""
        found, summary = self._found, self._found.summary
        try:
            if opcode == CHUNK:
                piece, held = self._chunk(at, *self._source.chunk_head(at))
                missing = found.take(piece, held)
                self._messages += held.held
                self._source.allow(chunks=len(found.pieces), messages=self._messages)
                self._trusted(at)
                self._note_missing(at, missing)
            elif opcode == MESSAGE:
                self._extend_run(at, length)
            elif opcode in (SCHEMA, CHANNEL):
                content = self._source.read(at + HEAD.size, length - HEAD.size)
                if opcode == SCHEMA:
                    summary.define(Schema.take(content))
                else:
                    summary.define(channel=Channel.take(content))
            elif opcode == ATTACHMENT:
                self._source.attachment(at, length)
                summary.attachments.append((at, length, None))
            elif opcode == MESSAGE_INDEX:
                cursor = Cursor(self._source.read(at + HEAD.size, min(6, length - HEAD.size)))
                if cursor.u16() < 0 or cursor.u32() != length - HEAD.size - 6:
                    raise BadBytes("an index that contradicts itself")
            elif opcode == DATA_END:
                if length != HEAD.size + 4:
                    raise BadBytes(f"the end of the data has {length} bytes")
                self._trusted(at)
                found.ended, found.stop = True, at
            elif opcode != METADATA:
                summary.skipped += 1
        except BadBytes as error:
            if opcode != CHUNK or self._suspect is not None:
                return self._broken(at, str(error))
            self._suspect = at, str(error)
        return at + length

    def _chunk(self, at: int, head: ChunkHead, length: int) -> tuple[Piece, Tally]:
        """The chunk with that head and its counts, after all checks; the chunk counts for the budget.

        Raises:
            BadBytes: there is no valid chunk.
            RecordingError: with it the recording costs too much.
        """
        if head.compression:
            self._unpacked += head.uncompressed
            self._source.allow(unpacked=self._unpacked)
        piece = Piece(head.start, head.end, at, length, unpacked=head.uncompressed)
        return piece, self._source.tally(piece)

    def _trusted(self, at: int) -> None:
        if self._suspect is not None:
            self._note(self._suspect[0], at, self._suspect[1])
            self._suspect = None

    def _note_missing(self, at: int, missing: int) -> None:
        """Report samples that are missing by their numbers: a chunk with a damaged kind looks like a record to skip."""
        last = self._found.pieces[-2] if len(self._found.pieces) > 1 else None
        begin = last.offset + last.length if last is not None else self._source.begin
        is_reported = self._found.damage and self._found.damage[-1].offset >= begin
        if self._is_own and missing > 0 and not is_reported:
            self._note(begin, at, f"{missing} samples are missing")

    def _broken(self, at: int, why: str) -> int:
        """Handle a broken chain of records: look for the next whole chunk."""
        self._end_run(at)
        begin, why = self._suspect or (at, why)
        self._suspect = None
        after = self._next_chunk(begin + 1)
        self._note(begin, after, why)
        return after

    def _note(self, begin: int, after: int, why: str) -> None:
        self._found.damage.append(Gap(begin, min(after, self._source.size) - begin, why))

    def _next_chunk(self, at: int) -> int:
        """The place of the next whole chunk, or the end of the file."""
        source = self._source
        while at < source.size and self._patience > 0:
            window = source.read(at, min(_WINDOW, source.size - at))
            for match in _CANDIDATE.finditer(window):
                if self._is_chunk(at + match.start()):
                    return at + match.start()
                if self._patience <= 0:
                    break
            at += max(1, len(window) - HEAD.size + 1)
            if len(window) < _WINDOW:
                break
        return source.size

    def _is_chunk(self, at: int) -> bool:
        self._patience -= _LOOKED
        try:
            head, length = self._source.chunk_head(at)
            self._patience -= length
            self._chunk(at, head, length)
        except BadBytes:
            return False
        return bool(head.crc)

    def _extend_run(self, at: int, length: int) -> None:
        if self._run is None:
            self._run = at, at
        begin = self._run[0]
        self._run = begin, at + length
        if at + length - begin > _RUN:
            self._end_run(at + length)

    def _end_run(self, at: int) -> None:
        if self._run is None:
            return
        (begin, end), self._run = self._run, None
        piece = Piece(0, 0, begin, end - begin, chunk=False)
        try:
            content = self._source.tally(piece)
        except BadBytes as error:
            self._note(begin, end, str(error))
            return
        self._found.take(piece._replace(start=content.start, end=content.end), content)

    def _split_tail(self) -> None:
        """Turn damage behind the last whole piece into the torn end, where the writer did not mark the data's end."""
        found = self._found
        last = found.pieces[-1].offset if found.pieces else self._source.begin - 1
        tail = [gap for gap in found.damage if gap.offset > last]
        if not found.ended:
            found.stop = tail[0].offset if tail else self._source.size
        if found.ended or not tail:
            return
        found.damage = found.damage[: len(found.damage) - len(tail)]
        found.torn = Gap(tail[0].offset, self._source.size - tail[0].offset, tail[0].why)
