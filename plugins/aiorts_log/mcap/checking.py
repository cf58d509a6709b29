"""Finds faults of a recording whose chunks are all whole: in its indexes, and in the checksum of all its data.

No sample is read by means of these; other programs use them.
"""

from __future__ import annotations

import sys
import zlib
from array import array
from collections.abc import Iterator
from typing import Final

from aiorts_log.mcap.format import HEAD, MESSAGE, MESSAGE_HEAD, Cursor
from aiorts_log.mcap.source import Piece, Source
from aiorts_log.mcap.survey import Gap, Survey

_BLOCK: Final = 2**20


def faults(source: Source, found: Survey) -> Iterator[Gap]:
    """The faults of a file in which no damage was found."""
    last = found.pieces[-1] if found.pieces and not found.ended else None  # its indexes may be torn
    for piece in found.pieces:
        if piece.chunk:
            yield from _of_chunk(source, piece, piece is not last)
    if (
        found.ended
        and (stated := Cursor(source.read(found.stop + HEAD.size, 4)).u32())
        and stated != _checksum(source, found)
    ):
        yield Gap(0, found.stop, "the checksum of all of it is wrong")


def _of_chunk(source: Source, piece: Piece, is_complete: bool) -> Iterator[Gap]:
    """Compare the indexes behind a chunk, if it has any, with its content."""
    indexes = source.place(piece).indexes
    if not indexes:
        return
    there = _places(*source.records(piece))
    for channel, at in indexes.items():
        length = source.head(at)[1]
        entries = source.read(at + HEAD.size + 6, length - HEAD.size - 6)
        if not _same(entries, there.pop(channel, array("Q"))):
            yield Gap(at, length, f"the index of channel {channel} is not that of the chunk in front of it")
    if there and is_complete:
        yield Gap(piece.offset, piece.length, f"channel {min(there)} has no index behind its chunk")


def _places(data: bytes, at: int) -> dict[int, array[int]]:
    """Log time and place of each message among the records of a chunk, by channel."""
    found: dict[int, array[int]] = {}
    begin, stop = at, len(data)
    while at < stop:
        opcode, length = HEAD.unpack_from(data, at)
        if opcode == MESSAGE:
            _, _, channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, at)
            found.setdefault(channel, array("Q")).extend((log_time, at - begin))
        at += HEAD.size + length
    return found


def _same(entries: bytes, there: array[int]) -> bool:
    """Whether these are the same pairs of time and place, in any order."""
    if len(entries) != 8 * len(there):
        return False
    stated = array("Q", entries)
    if sys.byteorder == "big":
        stated.byteswap()
    return stated == there or sorted(zip(stated[::2], stated[1::2], strict=True)) == sorted(
        zip(there[::2], there[1::2], strict=True)
    )


def _checksum(source: Source, found: Survey) -> int:
    """The checksum of everything before the end of the data."""
    crc = 0
    for at in range(0, found.stop, _BLOCK):
        crc = zlib.crc32(source.read(at, min(_BLOCK, found.stop - at)), crc)
    return crc
