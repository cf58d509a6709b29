"""Merges the messages of many chunks by log time, with as few chunks in memory as possible."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Any, Final

from aiorts_log.errors import RecordingError
from aiorts_log.mcap.source import Piece

_TIME: Final = itemgetter(2)
_EACH: Final = 250
"""Bytes of memory that a message takes besides its data."""


def merged(
    pieces: Sequence[Piece], load: Callable[[Piece], Any], most: int, in_order: bool
) -> Iterator[tuple[int, int, int, int, bytes]]:
    """Messages by log time, those of equal time in the order of the file.

    Args:
        load: gives the messages of a piece in their order in the file.
        most: bytes of memory that messages of pieces may take at once.
        in_order: when false, messages come in the order of the file.

    Raises:
        RecordingError: more pieces overlap than may be held.
    """
    if not in_order:
        for piece in sorted(pieces, key=lambda one: one.offset):
            yield from load(piece)
        return
    waiting = sorted(pieces, key=lambda one: (one.start, one.offset))
    held: list[tuple[int, int, int, Any, int]] = []
    """(time of the next message, offset of its piece, its number, the messages, bytes that they hold)"""
    total = 0
    for number, piece in enumerate(waiting):
        while held and held[0][0] < piece.start:
            yield held[0][3][held[0][2]]
            total -= _advance(held)
        messages = load(piece)
        if not messages:
            continue
        messages.sort(key=_TIME)  # stable, and fast when they are in order
        if not held and (number + 1 == len(waiting) or waiting[number + 1].start > messages[-1][2]):
            yield from messages
            continue
        size = _weight(messages)
        total += size
        if total > most and held:
            raise RecordingError(
                f"chunks of {total} bytes overlap in time; at most {most} are held; read it in the order of the file"
            )
        heapq.heappush(held, (messages[0][2], piece.offset, 0, messages, size))
    while held:
        yield held[0][3][held[0][2]]
        _advance(held)


def _weight(messages: Any) -> int:
    weight = getattr(messages, "weight", None)
    return int(weight) if weight is not None else sum(len(one[4]) for one in messages) + _EACH * len(messages)


def _advance(held: list[tuple[int, int, int, Any, int]]) -> int:
    """Go on to the next message of the first piece; return the bytes that a piece with no more messages held."""
    _, offset, number, messages, size = held[0]
    number += 1
    if number == len(messages):
        heapq.heappop(held)
        return size
    heapq.heapreplace(held, (messages[number][2], offset, number, messages, size))
    return 0
