"""What a message of a channel looks like: 24 bytes, little-endian, and then blocks, each after its length.

    version u8, kind u8, count u16, link epoch u32, first number u64, sent ns i64, then `count` times: length u32, bytes

The numbers count bytes: the first number of a message is that of the bytes which its sender has sent before it on this
channel. So its receiver can say how far it has come, and what a lost message took up is free again.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

VERSION: Final = 1
FRAME: Final = 1
"""A frame: its head, and the buffers beside it."""
PIECE: Final = 2
"""A part of a frame that is longer than PIECES: where it begins, and its bytes; first the length of the whole."""
TAKEN: Final = 3
"""How far the receiver has come; the first number is that of the bytes which it has taken."""
LOOK: Final = 4
"""Asks for TAKEN; the first number is that of the bytes which were sent until now."""
END: Final = 5
"""Of a session with a kernel: nothing comes any more."""
HAVE: Final = 6
"""Of a session: asks for all that was sent from the first number on once more."""
PIECES: Final = 48 * 1024
"""Bytes of one message: less than a batch of the engine (64 KiB), which is written in one go."""
LARGEST: Final = 64 << 20
"""Bytes of a frame that anybody takes."""

_HEAD: Final = struct.Struct("<BBHIQq")
_LENGTH: Final = struct.Struct("<I")
_PLACE: Final = struct.Struct("<QQ")


class Message(NamedTuple):
    """A message that has come."""

    kind: int
    epoch: int
    first: int
    sent_ns: int
    blocks: tuple[memoryview, ...]


def message(kind: int, epoch: int, first: int, sent_ns: int, blocks: Sequence[bytes | memoryview] = ()) -> bytes:
    """A message of these blocks."""
    head = _HEAD.pack(VERSION, kind, len(blocks), epoch, first, sent_ns)
    return b"".join((head, *_with_lengths(blocks)))


def read(data: bytes) -> Message:
    """The message in these bytes. ValueError: there is none."""
    if len(data) < _HEAD.size:
        raise ValueError(f"a message of {len(data)} bytes")
    version, kind, count, epoch, first, sent_ns = _HEAD.unpack_from(data)
    if version != VERSION or not FRAME <= kind <= HAVE:
        raise ValueError(f"a message of version {version} and kind {kind}")
    return Message(kind, epoch, first, sent_ns, tuple(_blocks(memoryview(data)[_HEAD.size :], count)))


def pieces(blocks: Sequence[bytes | memoryview]) -> Iterator[tuple[bytes, memoryview]]:
    """The blocks of the messages that carry a long frame, in order."""
    whole = memoryview(b"".join((_LENGTH.pack(len(blocks)), *_with_lengths(blocks))))
    for place in range(0, len(whole), PIECES):
        yield _PLACE.pack(len(whole), place), whole[place : place + PIECES]


class Whole:
    """Puts long frames together; one whose pieces are not all there when the next begins is left out."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._total = 0

    def add(self, blocks: Sequence[memoryview]) -> tuple[memoryview, ...] | None:
        """The blocks of the frame that is whole with this piece; None: there are more. ValueError: it is no piece."""
        if len(blocks) != 2 or len(blocks[0]) != _PLACE.size:
            raise ValueError("a piece without its place")
        total, place = _PLACE.unpack(blocks[0])
        if total > LARGEST:
            raise ValueError(f"a frame of {total} bytes")
        if place == 0:
            self._buffer, self._total = bytearray(), total
        if place != len(self._buffer) or total != self._total:
            self._buffer, self._total = bytearray(), 0
            return None
        self._buffer += blocks[1]
        if len(self._buffer) > total:
            raise ValueError("pieces that are longer than their frame")
        if len(self._buffer) < total:
            return None
        whole = memoryview(self._buffer).toreadonly()
        self._buffer, self._total = bytearray(), 0
        return tuple(_blocks(whole[_LENGTH.size :], *_LENGTH.unpack_from(whole)))


def _with_lengths(blocks: Sequence[bytes | memoryview]) -> Iterator[bytes | memoryview]:
    for block in blocks:
        yield _LENGTH.pack(len(block))
        yield block


def _blocks(data: memoryview, count: int) -> Iterator[memoryview]:
    place = 0
    for _ in range(count):
        if len(data) < place + _LENGTH.size:
            raise ValueError("a message that is too short")
        (length,) = _LENGTH.unpack_from(data, place)
        place += _LENGTH.size
        if len(data) < place + length:
            raise ValueError("a block that is longer than its message")
        yield data[place : place + length]
        place += length
    if place != len(data):
        raise ValueError("a message that is too long")
