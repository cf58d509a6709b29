"""Packs and parses the records of an MCAP file (version 0): little-endian, every length checked before it is used.

The published format: https://mcap.dev/spec. Bytes that do not fit raise BadBytes, without a place, which callers know.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

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
"""The start of every record: its kind, and the number of bytes that follow."""
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""HEAD and the fields before a message's data: channel, sequence, log time, publish time."""
_U16: Final = struct.Struct("<H")
_U32: Final = struct.Struct("<I")
_U64: Final = struct.Struct("<Q")
_PAIR: Final = struct.Struct("<QQ")
_CHUNK: Final = struct.Struct("<QQQI")
_COUNT: Final = struct.Struct("<HQ")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
_FOOTER: Final = struct.Struct("<QQI")
FOOTER_SIZE: Final = HEAD.size + _FOOTER.size
"""Bytes of the whole last record."""


class BadBytes(ValueError):
    """Bytes that are no record of this format."""


class Cursor:
    """Reads values one after the other, never beyond the end."""

    __slots__ = ("_data", "at", "end")

    def __init__(self, data: bytes | memoryview, at: int = 0, end: int | None = None) -> None:
        self._data = data
        self.at = at
        self.end = len(data) if end is None else end

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        if count > self.end - self.at:
            raise BadBytes(f"expected {count} more bytes, got {self.end - self.at}")
        found = bytes(self._data[self.at : self.at + count])
        self.at += count
        return found

    def unpack(self, layout: struct.Struct) -> tuple[int, ...]:
        """The next values of a fixed layout."""
        return layout.unpack(self.take(layout.size))

    def u16(self) -> int:
        """The next 16-bit number."""
        return self.unpack(_U16)[0]

    def u32(self) -> int:
        """The next 32-bit number."""
        return self.unpack(_U32)[0]

    def u64(self) -> int:
        """The next 64-bit number."""
        return self.unpack(_U64)[0]

    def text(self) -> str:
        """The next text; BadBytes when it is not UTF-8."""
        try:
            return self.take(self.u32()).decode("utf-8")
        except UnicodeDecodeError as error:
            raise BadBytes(f"no UTF-8 text: {error.reason}") from None

    def texts(self) -> dict[str, str]:
        """The next map of text to text."""
        inner = Cursor(self.take(self.u32()))
        found: dict[str, str] = {}
        while inner.at < inner.end:
            key = inner.text()
            found[key] = inner.text()
        return found

    def counts(self) -> dict[int, int]:
        """The next map of 16-bit to 64-bit numbers."""
        inner = Cursor(self.take(self.u32()))
        found: dict[int, int] = {}
        while inner.at < inner.end:
            key, value = inner.unpack(_COUNT)
            found[key] = value
        return found


def record(opcode: int, *parts: bytes) -> bytes:
    """Pack a whole record."""
    content = b"".join(parts)
    return HEAD.pack(opcode, len(content)) + content


def text(value: str) -> bytes:
    """Pack a text with its length."""
    data = value.encode("utf-8", "backslashreplace")
    return _U32.pack(len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    """Pack a map of text to text with its length."""
    content = b"".join(text(key) + text(value) for key, value in values.items())
    return _U32.pack(len(content)) + content


def counts(values: Mapping[int, int]) -> bytes:
    """Pack a map of 16-bit to 64-bit numbers with its length."""
    return _U32.pack(len(values) * _COUNT.size) + b"".join(_COUNT.pack(*item) for item in values.items())


def message_index(channel: int, times_and_offsets: Iterable[int], count: int) -> bytes:
    """Pack the places of a channel's messages in the chunk before it: time, offset, time, offset, ..."""
    return record(
        MESSAGE_INDEX, _U16.pack(channel), _U32.pack(16 * count), struct.pack(f"<{2 * count}Q", *times_and_offsets)
    )


class Schema(NamedTuple):
    """Describes the messages of a channel."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def take(cls, content: bytes | memoryview) -> Schema:
        """Parse the content of a record. BadBytes if it is none."""
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.text(), cursor.text(), cursor.take(cursor.u32()))

    def put(self) -> bytes:
        """Pack the record."""
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
        """Parse the content of a record. BadBytes if it is none."""
        cursor = Cursor(content)
        return cls(cursor.u16(), cursor.u16(), cursor.text(), cursor.text(), cursor.texts())

    def put(self) -> bytes:
        """Pack the record."""
        head = _U16.pack(self.id) + _U16.pack(self.schema)
        return record(CHANNEL, head, text(self.topic), text(self.encoding), texts(self.metadata))


class ChunkHead(NamedTuple):
    """The fields before the records of a chunk."""

    start: int
    end: int
    uncompressed: int
    crc: int
    compression: str
    stored: int
    """Bytes of the records as they are in the file."""
    size: int
    """Bytes of this head, without the record's own nine."""

    @classmethod
    def take(cls, content: bytes | memoryview) -> ChunkHead:
        """Parse the first bytes of the content of a record. BadBytes if they are none."""
        cursor = Cursor(content)
        start, end, uncompressed, crc = cursor.unpack(_CHUNK)
        length = cursor.u32()
        if length > 32:
            raise BadBytes(f"the name of a compression has {length} bytes")
        compression = cursor.take(length).decode("latin-1")
        return cls(start, end, uncompressed, crc, compression, cursor.u64(), cursor.at)

    def put(self) -> bytes:
        """Pack the record up to the place where its records begin."""
        name = text(self.compression)
        content = _CHUNK.pack(self.start, self.end, self.uncompressed, self.crc) + name + _U64.pack(self.stored)
        return HEAD.pack(CHUNK, len(content) + self.stored) + content


class ChunkPlace(NamedTuple):
    """An entry of the index: where a chunk is."""

    start: int
    end: int
    offset: int
    length: int
    """Bytes of the whole record."""
    indexes: dict[int, int]
    index_length: int
    compression: str
    stored: int
    uncompressed: int

    @classmethod
    def take(cls, content: bytes | memoryview) -> ChunkPlace:
        """Parse the content of a record. BadBytes if it is none."""
        c = Cursor(content)
        return cls(c.u64(), c.u64(), c.u64(), c.u64(), c.counts(), c.u64(), c.text(), c.u64(), c.u64())

    def put(self) -> bytes:
        """Pack the record."""
        place = struct.pack("<4Q", self.start, self.end, self.offset, self.length)
        sizes = _PAIR.pack(self.stored, self.uncompressed)
        indexes = counts(self.indexes) + _U64.pack(self.index_length)
        return record(CHUNK_INDEX, place, indexes, text(self.compression), sizes)


class Attachment(NamedTuple):
    """A file within the file, with a checksum of its own."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes

    @classmethod
    def take(cls, content: bytes) -> Attachment:
        """Parse the content of a record. BadBytes if it is none, or its checksum is wrong."""
        c = Cursor(content)
        found = cls(c.u64(), c.u64(), c.text(), c.text(), c.take(c.u64()))
        at = c.at
        crc = c.u32()
        if crc and crc != zlib.crc32(content[:at]):
            raise BadBytes(f"the checksum of the attachment {found.name[:60]!r} is wrong")
        return found

    def put(self) -> bytes:
        """Pack the record."""
        head = _PAIR.pack(self.log_time, self.create_time) + text(self.name) + text(self.media_type)
        content = head + _U64.pack(len(self.data)) + self.data
        return record(ATTACHMENT, content, _U32.pack(zlib.crc32(content)))

    def place(self, offset: int, length: int) -> bytes:
        """Pack the index entry of this attachment, whose own record is at `offset`."""
        numbers = struct.pack("<5Q", offset, length, self.log_time, self.create_time, len(self.data))
        return record(ATTACHMENT_INDEX, numbers, text(self.name), text(self.media_type))


class Statistics(NamedTuple):
    """The counts that the writer of the file made."""

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
        """Parse the content of a record. BadBytes if it is none."""
        cursor = Cursor(content)
        messages, schemas, channels, attachments, metadata, chunks, start, end = cursor.unpack(_STATISTICS)
        return cls(messages, schemas, channels, attachments, metadata, chunks, start, end, cursor.counts())

    def put(self) -> bytes:
        """Pack the record."""
        return record(STATISTICS, _STATISTICS.pack(*self[:8]), counts(self.counts))


class Footer(NamedTuple):
    """The last record: where the summary begins, and its checksum."""

    summary: int
    offsets: int
    crc: int

    @classmethod
    def take(cls, data: bytes) -> Footer:
        """Parse the whole record. BadBytes if it is none."""
        if len(data) != FOOTER_SIZE or HEAD.unpack_from(data) != (FOOTER, _FOOTER.size):
            raise BadBytes("no footer")
        return cls(*_FOOTER.unpack_from(data, HEAD.size))

    def put(self) -> bytes:
        """Pack the record."""
        return record(FOOTER, _FOOTER.pack(*self))
