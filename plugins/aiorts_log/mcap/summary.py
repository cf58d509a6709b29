"""Packs and parses the summary at the end of a recording, by which it is opened without reading all of it."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

from aiorts_log.mcap.format import (
    ATTACHMENT_INDEX,
    CHANNEL,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEAD,
    MAGIC,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    Attachment,
    BadBytes,
    Channel,
    ChunkPlace,
    Cursor,
    Footer,
    Schema,
    Statistics,
    record,
)

_KNOWN = {SCHEMA, CHANNEL, CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET, FOOTER}


@dataclass(slots=True)
class Summary:
    """The content of a file, and its places.

    Attributes:
        attachments: offset and length of each, and the attachment itself where the index needs it.
        counted: the file's own statistics; None when it has none.
        skipped: records of kinds that this version does not know.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    attachments: list[tuple[int, int, Attachment | None]] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    counted: Statistics | None = None
    skipped: int = 0

    def define(self, schema: Schema | None = None, channel: Channel | None = None) -> None:
        """Add a definition. BadBytes for a different definition with the same number."""
        if schema is not None and self.schemas.setdefault(schema.id, schema) != schema:
            raise BadBytes(f"schema {schema.id} is defined twice, and differently")
        if channel is not None and self.channels.setdefault(channel.id, channel) != channel:
            raise BadBytes(f"channel {channel.id} is defined twice, and differently")

    def statistics(self) -> Statistics:
        """The statistics record of the file."""
        filled = [place for place in self.chunks if place.indexes]
        return Statistics(
            sum(self.counts.values()),
            len(self.schemas),
            len(self.channels),
            len(self.attachments),
            0,
            len(self.chunks),
            min((place.start for place in filled), default=0),
            max((place.end for place in filled), default=0),
            dict(self.counts),
        )

    def put(self, offset: int) -> list[bytes]:
        """Pack everything from the end of the data, at `offset`, to the end of the file."""
        end = record(DATA_END, struct.pack("<I", 0))
        groups = (
            (SCHEMA, b"".join(schema.put() for schema in self.schemas.values())),
            (CHANNEL, b"".join(channel.put() for channel in self.channels.values())),
            (STATISTICS, self.statistics().put()),
            (CHUNK_INDEX, b"".join(place.put() for place in self.chunks)),
            (ATTACHMENT_INDEX, b"".join(one.place(at, size) for at, size, one in self.attachments if one is not None)),
        )
        at = start = offset + len(end)
        parts, offsets = [], []
        for opcode, data in groups:
            if data:
                parts.append(data)
                offsets.append(record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at, len(data))))
                at += len(data)
        body = b"".join((*parts, *offsets))
        footer = Footer(start, at, 0).put()
        crc = zlib.crc32(footer[:-4], zlib.crc32(body))
        return [end, body, footer[:-4], struct.pack("<I", crc), MAGIC]

    @classmethod
    def take(cls, data: bytes, footer: Footer) -> Summary:
        """Parse the bytes between the end of the data and the footer.

        Raises:
            BadBytes: the checksum is wrong, or the bytes are no records.
        """
        whole = Footer(footer.summary, footer.offsets, 0).put()[:-4]
        if footer.crc and zlib.crc32(whole, zlib.crc32(data)) != footer.crc:
            raise BadBytes("the checksum of the summary is wrong")
        found = cls()
        at = 0
        while at < len(data):
            if len(data) - at < HEAD.size:
                raise BadBytes("no record in the summary")
            opcode, length = HEAD.unpack_from(data, at)
            at += HEAD.size
            if length > len(data) - at:
                raise BadBytes(f"a record of the summary should have {length} bytes, got {len(data) - at}")
            found._take(opcode, data[at : at + length])
            at += length
        return found

    def _take(self, opcode: int, content: bytes) -> None:
        if opcode == SCHEMA:
            self.define(Schema.take(content))
        elif opcode == CHANNEL:
            self.define(channel=Channel.take(content))
        elif opcode == CHUNK_INDEX:
            self.chunks.append(ChunkPlace.take(content))
        elif opcode == ATTACHMENT_INDEX:
            cursor = Cursor(content)
            self.attachments.append((cursor.u64(), cursor.u64(), None))
        elif opcode == STATISTICS:
            self.counted = Statistics.take(content)
            self.counts = dict(self.counted.counts)
        elif opcode not in _KNOWN:
            self.skipped += 1

    def check(self, size: int) -> None:
        """Compare the index with the size of the data, before anything is read by it.

        Raises:
            BadBytes: a chunk or attachment lies outside, or over another one.
        """
        self.chunks.sort(key=lambda place: place.offset)
        after = len(MAGIC)
        for place in self.chunks:
            if place.offset < after or place.length < HEAD.size or place.length + place.index_length > size:
                raise BadBytes(f"the index has a chunk at {place.offset}, where none can be")
            after = place.offset + place.length + place.index_length
        if after > size or any(at + length > size for at, length, _ in self.attachments):
            raise BadBytes("the index has a place behind the end of the data")
