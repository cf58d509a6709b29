"""The messages of many chunks in the order of their log time, with as few chunks in memory as that takes. Pure."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Any, Final

from aiorts_log.errors import RecordingError
from aiorts_log.source import Piece

__all__ = ("merged",)

_TIME: Final = itemgetter(2)
_EACH: Final = 250
"""Octets of memory that a message takes besides its data."""


def merged(
    pieces: Sequence[Piece], load: Callable[[Piece], Any], most: int, in_order: bool
) -> Iterator[tuple[int, int, int, int, bytes]]:
    """Messages by log time, those of one time as they lie in the file.

    Args:
        load: the messages of a piece as they lie in it.
        most: octets of memory that messages of pieces may take at once, unpacked as they are.
        in_order: without, they come as they lie in the file.

    Raises:
        RecordingError: the pieces overlap too much to be held.
    """
    if not in_order:
        for piece in sorted(pieces, key=lambda one: one.offset):
            yield from load(piece)
        return
    waiting = sorted(pieces, key=lambda one: (one.start, one.offset))
    held: list[tuple[int, int, int, Any, int]] = []
    """(time of the next message, offset of its piece, its number, the messages, octets that they hold)"""
    total = 0
    for number, piece in enumerate(waiting):
        while held and held[0][0] < piece.start:
            yield held[0][3][held[0][2]]
            total -= _advance(held)
        messages = load(piece)
        if not messages:
            continue
        messages.sort(key=_TIME)  # in no time when they are in order, and stable
        if not held and (number + 1 == len(waiting) or waiting[number + 1].start > messages[-1][2]):
            yield from messages
            continue
        octets = _weight(messages)
        total += octets
        if total > most and held:
            raise RecordingError(
                f"chunks of {total} octets overlap in time; at most {most} are held; read it in the order of the file"
            )
        heapq.heappush(held, (messages[0][2], piece.offset, 0, messages, octets))
    while held:
        yield held[0][3][held[0][2]]
        _advance(held)


def _weight(messages: Any) -> int:
    weight = getattr(messages, "weight", None)
    return int(weight) if weight is not None else sum(len(one[4]) for one in messages) + _EACH * len(messages)


def _advance(held: list[tuple[int, int, int, Any, int]]) -> int:
    """Go on to the next message of the first piece; the octets of a piece that is done."""
    _, offset, number, messages, octets = held[0]
    number += 1
    if number == len(messages):
        heapq.heappop(held)
        return octets
    heapq.heapreplace(held, (messages[number][2], offset, number, messages, octets))
    return 0
