"""One chunk of a recording: built record by record, and taken apart again after its sum was checked. Pure.

A chunk is the unit of trust: it is written in one piece, and nothing in it is believed before its checksum was right.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from aiorts_log.form import (
    CHANNEL,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    BadOctets,
    Channel,
    ChunkHead,
    ChunkPlace,
    Schema,
    message_index,
)

__all__ = ("ChunkBuilder", "Content", "Message", "Messages", "Tally", "contents", "signed", "tally", "unpack")

_SEPARATE: Final = 32_768
"""Octets from which a message is a part of its own: copying it together with others would cost more than it saves."""
_FEW: Final = 64
_MANY: Final = 2**22
"""Octets of a chunk from which its messages are not all made at once."""
_SHORT: Final = 1_024
"""Octets below which a message is put behind its head at once."""
_HEAD: Final = MESSAGE_HEAD.pack


class Message(NamedTuple):
    """A message as it lies in a chunk."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class Messages:
    """The messages of a large chunk: where they lie, each made when it is asked for.

    As a list, those of 64 MiB would take ten times as much when they are small.
    """

    __slots__ = ("_octets", "_places")

    def __init__(self, octets: bytes) -> None:
        self._octets = octets
        self._places: array[int] = array("Q")

    def note(self, at: int) -> None:
        """There is one whose record begins there."""
        self._places.append(at)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> Message:
        at = self._places[number]
        _, length, channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(self._octets, at)
        data = self._octets[at + 31 : at + HEAD.size + length]
        return Message(channel, sequence, log_time, publish_time, data)

    def __iter__(self) -> Iterator[Message]:
        return map(self.__getitem__, range(len(self._places)))

    def sort(self, key: object = None) -> None:
        """Put them in the order of their log time, which is the only one; those of one time stay as they are."""
        import numpy as np

        times = self._all(15, "<u8")
        if (times[1:] < times[:-1]).any():
            ordered = np.frombuffer(self._places, np.uint64)[np.argsort(times, kind="stable")]
            self._places = array("Q", ordered.tobytes())

    def channels(self) -> set[int]:
        """Of all of them."""
        return set(self._all(HEAD.size, "<u2").tolist())

    def _all(self, offset: int, kind: str) -> Any:
        """A number of the head of each."""
        import numpy as np

        width = np.dtype(kind).itemsize
        places = np.frombuffer(self._places, np.uint64).astype(np.int64)
        octets = np.frombuffer(self._octets, np.uint8)
        parts = np.empty((len(places), width), np.uint8)
        for i in range(width):
            parts[:, i] = octets[places + (offset + i)]
        return parts.view(kind).ravel()

    @property
    def weight(self) -> int:
        """Octets of memory that they take."""
        return len(self._octets) + 8 * len(self._places)


class Content(NamedTuple):
    """What a chunk holds."""

    messages: list[Message] | Messages
    schemas: list[Schema]
    channels: list[Channel]
    skipped: int
    """Records of kinds that this version does not know."""


class Tally(NamedTuple):
    """How much a chunk holds: its messages are counted, not kept.

    Attributes:
        counts: by channel: messages, the sequence number of the first, and by how much those behind it are ahead.
        start: the first log time; end: the last.
    """

    counts: dict[int, list[int]]
    schemas: list[Schema]
    channels: list[Channel]
    skipped: int
    start: int
    end: int


class ChunkBuilder:
    """Collects what the next chunk will hold."""

    __slots__ = ("_parts", "_where", "octets")

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._where: dict[int, list[int]] = {}
        self.octets = 0

    @property
    def is_empty(self) -> bool:
        """Whether there is no message in it."""
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
        """Put in how messages are to be read."""
        octets = definition.put()
        self._parts.append(octets)
        self.octets += len(octets)

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes, more: bytes = b"") -> int:
        """Put in a message, whose data are both parts; log times never go back. Returns how many octets there are."""
        length, at = len(data) + len(more), self.octets
        head = _HEAD(MESSAGE, 22 + length, channel, sequence & 0xFFFF_FFFF, log_time, publish_time)
        if length < _SHORT:
            self._parts.append(head + data)
        else:
            self._parts += (head, data, more)
        try:
            self._where[channel] += (log_time, at)
        except KeyError:
            self._where[channel] = [log_time, at]
        self.octets = at = at + 31 + length
        return at

    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: len(where) // 2 for channel, where in self._where.items()}

    def take(self, offset: int) -> tuple[list[bytes], ChunkPlace]:
        """The octets of the chunk and of the indexes behind it, in parts, if it lies at `offset`; begins a new one."""
        parts = self._parts
        if len(parts) > _FEW:
            parts = _joined(parts)
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        start, end = self.start, self.end
        head = ChunkHead(start, end, self.octets, crc, "", self.octets, 0).put()
        length = len(head) + self.octets
        indexes, places, at = [], {}, offset + length
        for channel, where in self._where.items():
            indexes.append(message_index(channel, where, len(where) // 2))
            places[channel] = at
            at += len(indexes[-1])
        place = ChunkPlace(start, end, offset, length, places, at - offset - length, "", self.octets, self.octets)
        taken = [head, *parts, *indexes]
        self.__init__()  # type: ignore[misc]
        return taken, place


def _joined(parts: list[bytes]) -> list[bytes]:
    """The same octets in few parts, without copying the large ones."""
    joined: list[bytes] = []
    small: list[bytes] = []
    for part in parts:
        if len(part) < _SEPARATE:
            small.append(part)
        else:
            joined += (b"".join(small), part)
            small = []
    return [*joined, b"".join(small)]


def unpack(head: ChunkHead, octets: bytes, at: int) -> tuple[bytes, int]:
    """Where the records of a chunk begin, and in which octets; of the size and with the sum that its head says.

    Args:
        octets: in which the stored records begin at `at` and end with the octets.

    Raises:
        BadOctets: they are not what the head says.
    """
    if len(octets) - at != head.stored:
        raise BadOctets(f"a chunk says it stores {head.stored} octets, {len(octets) - at} are there")
    if head.compression:
        from aiorts_log.compression import decompress

        octets, at = decompress(head.compression, memoryview(octets)[at:], head.uncompressed), 0
    elif head.stored != head.uncompressed:
        raise BadOctets(f"a chunk of {head.stored} octets says it has {head.uncompressed}")
    if head.crc and zlib.crc32(memoryview(octets)[at:]) != head.crc:
        raise BadOctets("the checksum of a chunk is not right")
    return octets, at


def signed(number: int) -> int:
    """A difference of sequence numbers, which have 32 bits and begin again."""
    number &= 0xFFFF_FFFF
    return number - 2**32 if number >= 2**31 else number


def contents(octets: bytes, at: int = 0, start: int = 0, end: int = 2**64 - 1) -> Content:
    """What stands in the checked records of a chunk (or in a run of records outside one).

    Args:
        octets: in which the records begin at `at`.
        start: no message may be earlier.
        end: nor later: what the head and the index say of a chunk has to be so.

    Raises:
        BadOctets: they are no records one behind the other, or a time is not within.
    """
    messages: list[Message] = []
    many = Messages(octets) if len(octets) > _MANY else None
    found = Content(messages if many is None else many, [], [], 0)
    skipped = 0
    take, size, stop = MESSAGE_HEAD.unpack_from, HEAD.size, len(octets)
    new, cls = tuple.__new__, Message
    while at < stop:
        if octets[at] == MESSAGE and stop - at >= 31:
            _, length, channel, sequence, log_time, publish_time = take(octets, at)
            after = at + size + length
            if after > stop or length < 22:
                raise BadOctets(f"a message says it has {length} octets, {stop - at - size} follow")
            if not start <= log_time <= end:
                raise BadOctets("a message is outside the time that its chunk says")
            if many is not None:
                many.note(at)
            else:
                messages.append(new(cls, (channel, sequence, log_time, publish_time, octets[at + 31 : after])))
        else:
            after, more = _other(octets, at, found.schemas, found.channels)
            skipped += more
        at = after
    return found._replace(skipped=skipped)


def tally(octets: bytes, at: int = 0, start: int = 0, end: int = 2**64 - 1) -> Tally:
    """How much stands there; arguments, checks and errors as of `contents`."""
    counts: dict[int, list[int]] = {}
    schemas: list[Schema] = []
    channels: list[Channel] = []
    take, size, stop = MESSAGE_HEAD.unpack_from, HEAD.size, len(octets)
    skipped, first, last = 0, 2**64, -1
    begun: dict[int, int] = {}
    follows: dict[int, int] = {}
    """By channel: where the present run of numbers without a hole begins, and the next number of it."""
    follow = follows.get
    while at < stop:
        try:
            opcode, length, channel, sequence, log_time, _ = take(octets, at)
        except struct.error:  # what is there is shorter than any message
            opcode = length = channel = sequence = log_time = 0
        if opcode == MESSAGE and length >= 22:
            at += size + length
            if at > stop:
                raise BadOctets(f"a message says it has {length} octets, {stop - at + length} follow")
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
            at, more = _other(octets, at, schemas, channels)
            skipped += more
    if counts and not start <= first <= last <= end:
        raise BadOctets("a message is outside the time that its chunk says")
    for channel, found in counts.items():
        found[0] += follows[channel] - begun[channel]
    return Tally(counts, schemas, channels, skipped, first, last)


def _other(octets: bytes, at: int, schemas: list[Schema], channels: list[Channel]) -> tuple[int, int]:
    """Take a record that is no message; returns where the next begins, and 1 if it is of a kind not known here."""
    size = HEAD.size
    if len(octets) - at < size:
        raise BadOctets(f"{len(octets) - at} octets are no record")
    opcode, length = HEAD.unpack_from(octets, at)
    after = at + size + length
    if after > len(octets) or opcode in (0, MESSAGE):
        raise BadOctets(f"a record {opcode} says it has {length} octets, {len(octets) - at - size} follow")
    if opcode == SCHEMA:
        schemas.append(Schema.take(octets[at + size : after]))
    elif opcode == CHANNEL:
        channels.append(Channel.take(octets[at + size : after]))
    else:
        return after, 1
    return after, 0
