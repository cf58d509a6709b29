"""The layout of a channel's message: 24 bytes, little-endian, and then blocks, each after its length.

    version u8, kind u8, count u16, link epoch u32, first number u64, sent ns i64, then `count` times: length u32, bytes

The numbers count what messages cost (`cost`): the first number of a message is the cost of all that its sender has
sent before it on this channel. So its receiver can say how far it has come, and the room of a lost message is free
again.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

VERSION: Final = 1
FRAME: Final = 1
"""A frame: its head, and the buffers that travel with it."""
PIECE: Final = 2
"""A part of a frame that is longer than PIECES: the length of the whole, its place there, and its bytes."""
TAKEN: Final = 3
"""The receiver's report how far it has come; the first number is the cost of the messages that it has taken."""
LOOK: Final = 4
"""Asks for TAKEN; the first number is the cost of what was sent until now."""
END: Final = 5
"""The end of one direction of a session with a kernel."""
HAVE: Final = 6
"""Asks, in a session, to send again all bytes from the first number on."""
BATCH: Final = 65_536
"""Bytes that the engine writes in one go; a message that does not fit into what is left of a batch begins another."""
PIECES: Final = 64_000
"""The most bytes of a frame that one batch has room for, with heads and key."""
LONG: Final = 260_000
"""Bytes of a piece that fills four batches: the cost of a message besides its bytes is paid a quarter as often."""
LARGEST: Final = 64 << 20
"""The most bytes of a frame that a receiver takes."""

_MOST: Final = 2**63
"""The bound of first numbers, which no sender ever reaches."""
_HEAD: Final = struct.Struct("<BBHIQq")
_HEAD_OF_ONE: Final = struct.Struct("<BBHIQqI")
"""A head, and the length of the only block."""
_ONE: Final = _HEAD_OF_ONE.size
_COPIED: Final = 512
"""The most bytes of a message that is copied: for so few a view takes longer than a copy."""
_LENGTH: Final = struct.Struct("<I")
_PLACE: Final = struct.Struct("<QQ")
_FILLED: Final = 65_400
"""The least bytes of a long message that go into one batch."""
_SHORT: Final = 64_500
"""The most bytes of a message that goes into one batch."""


Block: TypeAlias = bytes | memoryview | list[memoryview]
"""A block of a message; the parts of a list follow each other."""


class Message(NamedTuple):
    """A message that has come."""

    kind: int
    epoch: int
    first: int
    sent_ns: int
    blocks: tuple[memoryview, ...]


def message(kind: int, epoch: int, first: int, sent_ns: int, blocks: Sequence[Block] = ()) -> bytes:
    """The bytes of a message with these blocks."""
    if len(blocks) == 1 and not isinstance(block := blocks[0], list):
        return _HEAD_OF_ONE.pack(VERSION, kind, 1, epoch, first, sent_ns, len(block)) + block
    head = _HEAD.pack(VERSION, kind, len(blocks), epoch, first, sent_ns)
    return b"".join((head, *_with_lengths(blocks)))


def alone(epoch: int, first: int, sent_ns: int, frame: bytes) -> bytes:
    """The bytes of a message with one frame, as most have; see `message`."""
    return _HEAD_OF_ONE.pack(VERSION, FRAME, 1, epoch, first, sent_ns, len(frame)) + frame


def cost(size: int) -> int:
    """The most bytes of the engine's batches that a message of so many bytes takes up in its queue.

    Two successive batches of short messages hold more than fits into one: else they would be one batch. A longer
    message ends the batch before it, however little that holds, and shares its own batches with no other message.
    """
    return 2 * size if size <= _SHORT else (1 - -size // _FILLED) * BATCH


def size_of(blocks: Sequence[Block]) -> int:
    """Bytes of a message of these blocks, but for its head."""
    if len(blocks) == 1 and not isinstance(block := blocks[0], list):
        return len(block) + _LENGTH.size
    return sum(map(_length, blocks)) + _LENGTH.size * len(blocks)


def read(data: bytes) -> Message:
    """The message in these bytes. ValueError: there is none."""
    size = len(data)
    length = size  # of no block: a block is shorter than its message
    if size >= _ONE:
        version, kind, count, epoch, first, sent_ns, length = _HEAD_OF_ONE.unpack_from(data)
    elif size >= _HEAD.size:
        version, kind, count, epoch, first, sent_ns = _HEAD.unpack_from(data)
    else:
        raise ValueError(f"a message of {size} bytes")
    if version != VERSION or not FRAME <= kind <= HAVE or first >= _MOST:
        raise ValueError(f"a message of version {version} and kind {kind}")
    view = memoryview(data)
    if count == 1 and length == size - _ONE:
        return Message(kind, epoch, first, sent_ns, (view[_ONE:],))
    return Message(kind, epoch, first, sent_ns, tuple(_blocks(view[_HEAD.size :], count)))


def frame_of(data: bytes, epoch: int) -> tuple[int, bytes] | None:
    """First number and frame of a short message that has just one frame, of this epoch; None: it is another message."""
    size = len(data)
    if not _ONE <= size <= _COPIED:
        return None
    version, kind, count, of, first, _, length = _HEAD_OF_ONE.unpack_from(data)
    if version != VERSION or kind != FRAME or count != 1 or of != epoch or length != size - _ONE or first >= _MOST:
        return None
    return first, data[_ONE:]


def pieces(blocks: Sequence[Block]) -> Iterator[tuple[bytes, list[memoryview]]]:
    """The blocks of the messages that carry a long frame, in order; nothing is copied."""
    total = _LENGTH.size + size_of(blocks)
    parts = (_LENGTH.pack(len(blocks)), *_with_lengths(blocks))
    whole = deque(memoryview(part) for part in parts)
    place = 0
    while place < total:
        size = LONG if total - place >= LONG else min(PIECES, total - place)
        yield _PLACE.pack(total, place), _cut(whole, size)
        place += size


def _cut(whole: deque[memoryview], size: int) -> list[memoryview]:
    """Take `size` bytes off the front of `whole`, and return them."""
    found = []
    while size:
        view = whole.popleft()
        if len(view) > size:
            whole.appendleft(view[size:])
            view = view[:size]
        found.append(view)
        size -= len(view)
    return found


class Whole:
    """Puts long frames together; a frame whose pieces are not all there when the next begins is dropped."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._total = 0

    def add(self, blocks: Sequence[memoryview]) -> tuple[memoryview, ...] | None:
        """The blocks of the frame that this piece completes; None: it completes none. ValueError: it is no piece."""
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


def _length(block: Block) -> int:
    return sum(map(len, block)) if isinstance(block, list) else len(block)


def _with_lengths(blocks: Sequence[Block]) -> Iterator[bytes | memoryview]:
    for block in blocks:
        yield _LENGTH.pack(_length(block))
        if isinstance(block, list):
            yield from block
        else:
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
