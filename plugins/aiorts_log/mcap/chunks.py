"""Builds one chunk of a recording record by record, and takes it apart after its checksum was verified.

A chunk is the unit of trust: it is written in one piece, and its content is used only when its checksum is right.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from aiorts_log.mcap.format import (
    CHANNEL,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    BadBytes,
    Channel,
    ChunkHead,
    ChunkPlace,
    Schema,
    message_index,
)

_SEPARATE: Final = 32_768
"""Bytes from which a message is a part of its own: copying it together with others would cost more than it saves."""
_FEW: Final = 64
_MANY: Final = 2**22
"""Bytes of a chunk from which each of its messages is made only when it is used."""
_SHORT: Final = 1_024
"""Bytes below which a message is appended to its head at once."""
_HEAD: Final = MESSAGE_HEAD.pack


class Message(NamedTuple):
    """A message as it lies in a chunk."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Messages:
    """The messages of a large chunk, kept as places: each message is made when it is used.

    A list of the small messages of a 64 MiB chunk would take ten times as much memory.
    """

    __slots__ = ("_data", "_places")

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._places: array[int] = array("Q")

    def note(self, at: int) -> None:
        """Add the message whose record begins at `at`."""
        self._places.append(at)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Message:
        at = self._places[number]
        _, length, channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(self._data, at)
        data = self._data[at + 31 : at + HEAD.size + length]
        return Message(channel, sequence, log_time, publish_time, data)

    def __iter__(self) -> Iterator[Message]:
        return map(self.__getitem__, range(len(self._places)))

    def sort(self, key: object = None) -> None:
        """Sort by log time, the only order there is (`key` is ignored); messages of equal time stay in their order."""
        import numpy as np

        times = self._all(15, "<u8")
        if (times[1:] < times[:-1]).any():
            ordered = np.frombuffer(self._places, np.uint64)[np.argsort(times, kind="stable")]
            self._places = array("Q", ordered.tobytes())

    def channels(self) -> set[int]:
        """The channels of all messages."""
        return set(self._all(HEAD.size, "<u2").tolist())

    def _all(self, offset: int, kind: str) -> Any:
        """A number in the head of each message, read at this offset."""
        import numpy as np

        width = np.dtype(kind).itemsize
        places = np.frombuffer(self._places, np.uint64).astype(np.int64)
        data = np.frombuffer(self._data, np.uint8)
        parts = np.empty((len(places), width), np.uint8)
        for i in range(width):
            parts[:, i] = data[places + (offset + i)]
        return parts.view(kind).ravel()

    @property
    def weight(self) -> int:
        """Bytes of memory that the messages take."""
        return len(self._data) + 8 * len(self._places)


class Content(NamedTuple):
    """The content of a chunk."""

    messages: list[Message] | Messages
    schemas: list[Schema]
    channels: list[Channel]
    skipped: int
    """Records of kinds that this version does not know."""

    @property
    def held(self) -> int:
        """The number of messages, definitions and entries of metadata, for a budget."""
        return len(self.messages) + _weight(self.schemas, self.channels)


class Tally(NamedTuple):
    """Counts of the content of a chunk, without the messages.

    Attributes:
        counts: by channel: messages, the sequence number of the first, and by how much later numbers jump ahead.
        start: the first log time; end: the last.
    """

    counts: dict[int, list[int]]
    schemas: list[Schema]
    channels: list[Channel]
    skipped: int
    start: int
    end: int

    @property
    def held(self) -> int:
        """The number of messages, definitions and entries of metadata, for a budget."""
        return sum(count for count, _, _ in self.counts.values()) + _weight(self.schemas, self.channels)


class ChunkBuilder:
    """Collects the records of the next chunk."""

    __slots__ = ("_parts", "_where", "size")

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._where: dict[int, list[int]] = {}
        self.size = 0

    @property
    def is_empty(self) -> bool:
        """Whether the chunk has no message."""
        return not self._where

    @property
    def start(self) -> int:
        """The first log time; 0 without messages."""
        return min((where[0] for where in self._where.values()), default=0)

    @property
    def end(self) -> int:
        """The last log time; 0 without messages."""
        return max((where[-2] for where in self._where.values()), default=0)

    def define(self, definition: Schema | Channel) -> None:
        """Add a definition."""
        data = definition.put()
        self._parts.append(data)
        self.size += len(data)

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes, more: bytes = b"") -> int:
        """Add a message, whose data are `data` and `more`; log times never go back. Returns the bytes collected."""
        # 22 bytes of channel, sequence and the two times, 31 with the record's own head of 9.
        length, at = len(data) + len(more), self.size
        head = _HEAD(MESSAGE, 22 + length, channel, sequence & 0xFFFF_FFFF, log_time, publish_time)
        if length < _SHORT:
            self._parts.append(head + data)
        else:
            self._parts += (head, data, more)
        try:
            self._where[channel] += (log_time, at)
        except KeyError:
            self._where[channel] = [log_time, at]
        self.size = at = at + 31 + length
        return at

    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: len(where) // 2 for channel, where in self._where.items()}

    def take(self, offset: int) -> tuple[list[bytes], ChunkPlace]:
        """The bytes of the chunk and of the indexes behind it, in parts, for the place `offset`; begins a new chunk."""
        parts = self._parts
        if len(parts) > _FEW:
            parts = _joined(parts)
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        start, end = self.start, self.end
        head = ChunkHead(start, end, self.size, crc, "", self.size, 0).put()
        length = len(head) + self.size
        indexes, places, at = [], {}, offset + length
        for channel, where in self._where.items():
            indexes.append(message_index(channel, where, len(where) // 2))
            places[channel] = at
            at += len(indexes[-1])
        place = ChunkPlace(start, end, offset, length, places, at - offset - length, "", self.size, self.size)
        taken = [head, *parts, *indexes]
        self.__init__()  # type: ignore[misc]
        return taken, place


def _joined(parts: list[bytes]) -> list[bytes]:
    """Join parts into a few, without copying the large ones."""
    joined: list[bytes] = []
    small: list[bytes] = []
    for part in parts:
        if len(part) < _SEPARATE:
            small.append(part)
        else:
            joined += (b"".join(small), part)
            small = []
    return [*joined, b"".join(small)]


def unpack(head: ChunkHead, data: bytes, at: int) -> tuple[bytes, int]:
    """The unpacked bytes of a chunk and where its records begin, after their size and checksum were verified.

    Args:
        data: bytes that have the stored records from `at` to the end.

    Raises:
        BadBytes: the bytes are not what the head promises.
    """
    if len(data) - at != head.stored:
        raise BadBytes(f"a chunk should store {head.stored} bytes, got {len(data) - at}")
    if head.compression:
        from aiorts_log.mcap.compression import decompress

        data, at = decompress(head.compression, memoryview(data)[at:], head.uncompressed), 0
    elif head.stored != head.uncompressed:
        raise BadBytes(f"a chunk of {head.stored} bytes should have {head.uncompressed}")
    if head.crc and zlib.crc32(memoryview(data)[at:]) != head.crc:
        raise BadBytes("the checksum of a chunk is wrong")
    return data, at


def signed(number: int) -> int:
    """A difference of sequence numbers, which have 32 bits and wrap around."""
    number &= 0xFFFF_FFFF
    return number - 2**32 if number >= 2**31 else number


def contents(data: bytes, at: int = 0, start: int = 0, end: int = 2**64 - 1, defined: int = 2**64) -> Content:
    """Parse the verified records of a chunk, or of a run of records outside one.

    Args:
        data: bytes in which the records begin at `at`.
        start, end: the log times that the head and the index give for the chunk; a message outside them is an error.
        defined: the most definitions and entries of metadata: as objects they take much memory.

    Raises:
        BadBytes: the bytes are no sequence of records, or a time is outside.
    """
    messages: list[Message] = []
    many = Messages(data) if len(data) > _MANY else None
    found = Content(messages if many is None else many, [], [], 0)
    skipped = 0
    take, size, stop = MESSAGE_HEAD.unpack_from, HEAD.size, len(data)
    new, cls = tuple.__new__, Message
    while at < stop:
        if data[at] == MESSAGE and stop - at >= 31:
            _, length, channel, sequence, log_time, publish_time = take(data, at)
            after = at + size + length
            if after > stop or length < 22:
                raise BadBytes(f"a message should have {length} bytes, got {stop - at - size}")
            if not start <= log_time <= end:
                raise BadBytes("a message lies outside the times of its chunk")
            if many is not None:
                many.note(at)
            else:
                messages.append(new(cls, (channel, sequence, log_time, publish_time, data[at + 31 : after])))
        else:
            after, weight = _other(data, at, found.schemas, found.channels)
            skipped += not weight
            if (defined := defined - weight) < 0:
                raise BadBytes("a chunk defines more than there can be")
        at = after
    return found._replace(skipped=skipped)


def tally(data: bytes, at: int = 0, start: int = 0, end: int = 2**64 - 1, defined: int = 2**64) -> Tally:
    """Count the records; arguments, checks and errors as of `contents`."""
    counts: dict[int, list[int]] = {}
    schemas: list[Schema] = []
    channels: list[Channel] = []
    take, size, stop = MESSAGE_HEAD.unpack_from, HEAD.size, len(data)
    skipped, first, last = 0, 2**64, -1
    begun: dict[int, int] = {}
    follows: dict[int, int] = {}
    """By channel, of the present run of numbers without a hole: its first number (`begun`), its next (`follows`)."""
    follow = follows.get
    while at < stop:
        try:
            opcode, length, channel, sequence, log_time, _ = take(data, at)
        except struct.error:  # shorter than any message
            opcode = length = channel = sequence = log_time = 0
        if opcode == MESSAGE and length >= 22:
            at += size + length
            if at > stop:
                raise BadBytes(f"a message should have {length} bytes, got {stop - at + length}")
            if log_time < first:
                first = log_time
            if log_time > last:
                last = log_time
            if follow(channel) != sequence:
                if channel in counts:
                    counts[channel][0] += follows[channel] - begun[channel]
                    counts[channel][2] += signed(sequence - follows[channel])
                else:
                    counts[channel] = [0, sequence, 0]
                begun[channel] = sequence
            follows[channel] = sequence + 1
        else:
            at, weight = _other(data, at, schemas, channels)
            skipped += not weight
            if (defined := defined - weight) < 0:
                raise BadBytes("a chunk defines more than there can be")
    if counts and not start <= first <= last <= end:
        raise BadBytes("a message lies outside the times of its chunk")
    for channel, found in counts.items():
        found[0] += follows[channel] - begun[channel]
    return Tally(counts, schemas, channels, skipped, first, last)


def _weight(schemas: list[Schema], channels: list[Channel]) -> int:
    """The number of definitions and of their entries."""
    return len(schemas) + sum(1 + len(channel.metadata) for channel in channels)


def _other(data: bytes, at: int, schemas: list[Schema], channels: list[Channel]) -> tuple[int, int]:
    """Take a record that is no message; return its end, and the number of its definitions and entries."""
    size = HEAD.size
    if len(data) - at < size:
        raise BadBytes(f"{len(data) - at} bytes are no record")
    opcode, length = HEAD.unpack_from(data, at)
    after = at + size + length
    if after > len(data) or opcode in (0, MESSAGE):
        raise BadBytes(f"a record {opcode} should have {length} bytes, got {len(data) - at - size}")
    if opcode == SCHEMA:
        schemas.append(Schema.take(data[at + size : after]))
        return after, 1
    if opcode == CHANNEL:
        channels.append(Channel.take(data[at + size : after]))
        return after, 1 + len(channels[-1].metadata)
    return after, 0
