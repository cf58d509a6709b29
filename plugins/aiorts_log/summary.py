"""What stands at the end of a recording, so that it can be opened without reading all of it: octets and back. Pure."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

from aiorts_log.form import (
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
    BadOctets,
    Channel,
    ChunkPlace,
    Cursor,
    Footer,
    Schema,
    Statistics,
    record,
)

__all__ = ("Summary",)

_KNOWN = {SCHEMA, CHANNEL, CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET, FOOTER}


@dataclass(slots=True)
class Summary:
    """What is in a file, and where.

    Attributes:
        attachments: offset and length of each, and the attachment itself as far as it is needed for the index.
        counted: what the file itself says; None when it does not.
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
        """Take a definition. BadOctets for a second one of the same number that differs."""
        if schema is not None and self.schemas.setdefault(schema.id, schema) != schema:
            raise BadOctets(f"schema {schema.id} is defined twice, and differently")
        if channel is not None and self.channels.setdefault(channel.id, channel) != channel:
            raise BadOctets(f"channel {channel.id} is defined twice, and differently")

    def statistics(self) -> Statistics:
        """What is to be said of the file."""
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
        """Everything from the end of the data, at `offset`, to the end of the file."""
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
        for opcode, octets in groups:
            if octets:
                parts.append(octets)
                offsets.append(record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at, len(octets))))
                at += len(octets)
        body = b"".join((*parts, *offsets))
        footer = Footer(start, at, 0).put()
        crc = zlib.crc32(footer[:-4], zlib.crc32(body))
        return [end, body, footer[:-4], struct.pack("<I", crc), MAGIC]

    @classmethod
    def take(cls, octets: bytes, footer: Footer) -> Summary:
        """From the octets between the end of the data and the footer.

        Raises:
            BadOctets: the sum is not right, or what stands there are no records.
        """
        whole = Footer(footer.summary, footer.offsets, 0).put()[:-4]
        if footer.crc and zlib.crc32(whole, zlib.crc32(octets)) != footer.crc:
            raise BadOctets("the checksum of the summary is not right")
        found = cls()
        at = 0
        while at < len(octets):
            if len(octets) - at < HEAD.size:
                raise BadOctets("no record in the summary")
            opcode, length = HEAD.unpack_from(octets, at)
            at += HEAD.size
            if length > len(octets) - at:
                raise BadOctets(f"a record of the summary says it has {length} octets, {len(octets) - at} follow")
            found._take(opcode, octets[at : at + length])
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
        """Hold the index against the size of the data section, before anything is read by it.

        Raises:
            BadOctets: a chunk or attachment lies outside, or over another one.
        """
        self.chunks.sort(key=lambda place: place.offset)
        after = len(MAGIC)
        for place in self.chunks:
            if place.offset < after or place.length < HEAD.size or place.length + place.index_length > size:
                raise BadOctets(f"the index says there is a chunk at {place.offset}, where none can be")
            after = place.offset + place.length + place.index_length
        if after > size or any(at + length > size for at, length, _ in self.attachments):
            raise BadOctets("the index says that something lies behind the end of the data")
