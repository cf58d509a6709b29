"""The records of an MCAP file (version 0) as octets and back: pure, little-endian, every length checked before use.

The published format: https://mcap.dev/spec. What does not fit is a BadOctets; who reads a file says where it stood.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

__all__ = (
    "ATTACHMENT",
    "ATTACHMENT_INDEX",
    "CHANNEL",
    "CHUNK",
    "CHUNK_INDEX",
    "DATA_END",
    "FOOTER",
    "FOOTER_SIZE",
    "HEAD",
    "HEADER",
    "MAGIC",
    "MESSAGE",
    "MESSAGE_HEAD",
    "MESSAGE_INDEX",
    "METADATA",
    "METADATA_INDEX",
    "SCHEMA",
    "STATISTICS",
    "SUMMARY_OFFSET",
    "Attachment",
    "BadOctets",
    "Channel",
    "ChunkHead",
    "ChunkPlace",
    "Cursor",
    "Footer",
    "Schema",
    "Statistics",
    "message_index",
    "record",
)

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER: Final = 0x01
FOOTER: Final = 0x02
SCHEMA: Final = 0x03
CHANNEL: Final = 0x04
MESSAGE: Final = 0x05
CHUNK: Final = 0x06
MESSAGE_INDEX: Final = 0x07
CHUNK_INDEX: Final = 0x08
ATTACHMENT: Final = 0x09
ATTACHMENT_INDEX: Final = 0x0A
STATISTICS: Final = 0x0B
METADATA: Final = 0x0C
METADATA_INDEX: Final = 0x0D
SUMMARY_OFFSET: Final = 0x0E
DATA_END: Final = 0x0F

HEAD: Final = struct.Struct("<BQ")
"""In front of every record: what it is, and how many octets follow."""
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""HEAD and what stands in front of a message's data: channel, sequence, log time, publish time."""
_U16: Final = struct.Struct("<H")
_U32: Final = struct.Struct("<I")
_U64: Final = struct.Struct("<Q")
_PAIR: Final = struct.Struct("<QQ")
_CHUNK: Final = struct.Struct("<QQQI")
_COUNT: Final = struct.Struct("<HQ")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
_FOOTER: Final = struct.Struct("<QQI")
FOOTER_SIZE: Final = HEAD.size + _FOOTER.size
"""Octets of the whole last record."""


class BadOctets(ValueError):
    """Octets that are no record of this format."""


class Cursor:
    """Reads values one after the other, never beyond the end."""

    __slots__ = ("_data", "at", "end")

    def __init__(self, data: bytes | memoryview, at: int = 0, end: int | None = None) -> None:
        self._data = data
        self.at = at
        self.end = len(data) if end is None else end

    def octets(self, count: int) -> bytes:
        """The next `count` octets."""
        if count > self.end - self.at:
            raise BadOctets(f"{count} octets are said to follow, {self.end - self.at} do")
        found = bytes(self._data[self.at : self.at + count])
        self.at += count
        return found

    def unpack(self, form: struct.Struct) -> tuple[int, ...]:
        """The next values of a fixed form."""
        return form.unpack(self.octets(form.size))

    def u16(self) -> int:
        """The next two octets as a number."""
        return self.unpack(_U16)[0]

    def u32(self) -> int:
        """The next four octets as a number."""
        return self.unpack(_U32)[0]

    def u64(self) -> int:
        """The next eight octets as a number."""
        return self.unpack(_U64)[0]

    def text(self) -> str:
        """The next text; what is not UTF-8 is bad."""
        try:
            return self.octets(self.u32()).decode("utf-8")
        except UnicodeDecodeError as error:
            raise BadOctets(f"no UTF-8 text: {error.reason}") from None

    def texts(self) -> dict[str, str]:
        """The next map of text to text."""
        inner = Cursor(self.octets(self.u32()))
        found: dict[str, str] = {}
        while inner.at < inner.end:
            key = inner.text()
            found[key] = inner.text()
        return found

    def counts(self) -> dict[int, int]:
        """The next map of 16-bit to 64-bit numbers."""
        inner = Cursor(self.octets(self.u32()))
        found: dict[int, int] = {}
        while inner.at < inner.end:
            key, value = inner.unpack(_COUNT)
            found[key] = value
        return found


def record(opcode: int, *parts: bytes) -> bytes:
    """A whole record."""
    content = b"".join(parts)
    return HEAD.pack(opcode, len(content)) + content


def text(value: str) -> bytes:
    """A text with its length."""
    octets = value.encode("utf-8", "backslashreplace")
    return _U32.pack(len(octets)) + octets


def texts(values: Mapping[str, str]) -> bytes:
    """A map of text to text with its length."""
    content = b"".join(text(key) + text(value) for key, value in values.items())
    return _U32.pack(len(content)) + content


def counts(values: Mapping[int, int]) -> bytes:
    """A map of 16-bit to 64-bit numbers with its length."""
    return _U32.pack(len(values) * _COUNT.size) + b"".join(_COUNT.pack(*item) for item in values.items())


def message_index(channel: int, times_and_offsets: Iterable[int], count: int) -> bytes:
    """Where in the chunk before it the messages of a channel lie: time, offset, time, offset, ..."""
    return record(
        MESSAGE_INDEX, _U16.pack(channel), _U32.pack(16 * count), struct.pack(f"<{2 * count}Q", *times_and_offsets)
    )


class Schema(NamedTuple):
    """How the messages of a channel are to be read."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def take(cls, content: bytes | memoryview) -> Schema:
        """From the content of a record. BadOctets if it is none."""
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.text(), cursor.text(), cursor.octets(cursor.u32()))

    def put(self) -> bytes:
        """The record."""
        return record(
            SCHEMA, _U16.pack(self.id), text(self.name), text(self.encoding), _U32.pack(len(self.data)), self.data
        )


class Channel(NamedTuple):
    """A stream of messages of one schema: a port."""

    id: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]

    @classmethod
    def take(cls, content: bytes | memoryview) -> Channel:
        """From the content of a record. BadOctets if it is none."""
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.u16(), cursor.text(), cursor.text(), cursor.texts())

    def put(self) -> bytes:
        """The record."""
        head = _U16.pack(self.id) + _U16.pack(self.schema)
        return record(CHANNEL, head, text(self.topic), text(self.encoding), texts(self.metadata))


class ChunkHead(NamedTuple):
    """What stands in front of the records of a chunk."""

    start: int
    end: int
    uncompressed: int
    crc: int
    compression: str
    stored: int
    """Octets of the records as they lie in the file."""
    size: int
    """Octets of this head, the record's own nine not among them."""

    @classmethod
    def take(cls, content: bytes | memoryview) -> ChunkHead:
        """From the first octets of the content of a record. BadOctets if it is none."""
        cursor = Cursor(content)
        start, end, uncompressed, crc = cursor.unpack(_CHUNK)
        length = cursor.u32()
        if length > 32:
            raise BadOctets(f"the name of a compression has {length} octets")
        compression = cursor.octets(length).decode("latin-1")
        return cls(start, end, uncompressed, crc, compression, cursor.u64(), cursor.at)

    def put(self) -> bytes:
        """The record up to where its records begin."""
        name = text(self.compression)
        content = _CHUNK.pack(self.start, self.end, self.uncompressed, self.crc) + name + _U64.pack(self.stored)
        return HEAD.pack(CHUNK, len(content) + self.stored) + content


class ChunkPlace(NamedTuple):
    """Where a chunk lies: what the index at the end of a file says of it."""

    start: int
    end: int
    offset: int
    length: int
    """Octets of the whole record."""
    indexes: dict[int, int]
    index_length: int
    compression: str
    stored: int
    uncompressed: int

    @classmethod
    def take(cls, content: bytes | memoryview) -> ChunkPlace:
        """From the content of a record. BadOctets if it is none."""
        c = Cursor(content)
        return cls(c.u64(), c.u64(), c.u64(), c.u64(), c.counts(), c.u64(), c.text(), c.u64(), c.u64())

    def put(self) -> bytes:
        """The record."""
        place = struct.pack("<4Q", self.start, self.end, self.offset, self.length)
        sizes = _PAIR.pack(self.stored, self.uncompressed)
        indexes = counts(self.indexes) + _U64.pack(self.index_length)
        return record(CHUNK_INDEX, place, indexes, text(self.compression), sizes)


class Attachment(NamedTuple):
    """A file within the file, with a sum of its own."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes

    @classmethod
    def take(cls, content: bytes) -> Attachment:
        """From the content of a record. BadOctets if it is none, or its sum is not right."""
        c = Cursor(content)
        found = cls(c.u64(), c.u64(), c.text(), c.text(), c.octets(c.u64()))
        at = c.at
        crc = c.u32()
        if crc and crc != zlib.crc32(content[:at]):
            raise BadOctets(f"the checksum of the attachment {found.name[:60]!r} is not right")
        return found

    def put(self) -> bytes:
        """The record."""
        head = _PAIR.pack(self.log_time, self.create_time) + text(self.name) + text(self.media_type)
        content = head + _U64.pack(len(self.data)) + self.data
        return record(ATTACHMENT, content, _U32.pack(zlib.crc32(content)))

    def place(self, offset: int, length: int) -> bytes:
        """The record of the index for this attachment, whose own record lies there."""
        numbers = struct.pack("<5Q", offset, length, self.log_time, self.create_time, len(self.data))
        return record(ATTACHMENT_INDEX, numbers, text(self.name), text(self.media_type))


class Statistics(NamedTuple):
    """What the writer of the file counted."""

    messages: int
    schemas: int
    channels: int
    attachments: int
    metadata: int
    chunks: int
    start: int
    end: int
    counts: dict[int, int]

    @classmethod
    def take(cls, content: bytes | memoryview) -> Statistics:
        """From the content of a record. BadOctets if it is none."""
        cursor = Cursor(content)
        messages, schemas, channels, attachments, metadata, chunks, start, end = cursor.unpack(_STATISTICS)
        return cls(messages, schemas, channels, attachments, metadata, chunks, start, end, cursor.counts())

    def put(self) -> bytes:
        """The record."""
        return record(STATISTICS, _STATISTICS.pack(*self[:8]), counts(self.counts))


class Footer(NamedTuple):
    """The last record: where the summary begins, and the sum of it."""

    summary: int
    offsets: int
    crc: int

    @classmethod
    def take(cls, octets: bytes) -> Footer:
        """From the whole record. BadOctets if it is none."""
        if len(octets) != FOOTER_SIZE or HEAD.unpack_from(octets) != (FOOTER, _FOOTER.size):
            raise BadOctets("no footer")
        return cls(*_FOOTER.unpack_from(octets, HEAD.size))

    def put(self) -> bytes:
        """The record."""
        return record(FOOTER, _FOOTER.pack(*self))
