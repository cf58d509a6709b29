"""The messages between the two ends of a ring, and the places of the parts of a frame. Pure: bytes and numbers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

from aiorts.errors import LinkError
from aiorts.rings.extents import STEP

OFFER, READY, RING, MAPPED, CANNOT, FREED = range(1, 7)
"""The first byte of a message: a ring is there; send its descriptor; here is the descriptor; the ring is used from
now on; the ring cannot be used; these extents are free again."""
OFFERED: Final = bytes((OFFER,))
REFUSAL: Final = bytes((CANNOT,))
_FREED: Final = struct.Struct("<BI")
PLACES: Final = 255
"""The most parts of one frame."""

Place: TypeAlias = tuple[int, int]
"""(start, length) of a part in the ring; length 0: the part travels with the frame, outside the ring."""


class Put(NamedTuple):
    """The places of the parts of a frame."""

    places: list[Place]
    """The place of each part; empty where all are sent with the frame."""
    beside: list[memoryview]
    """The parts that are sent with the frame."""


def places_bytes(places: Sequence[Place]) -> bytes:
    """The head of a frame: the place of each of its parts."""
    numbers = [number for start, length in places for number in (start // STEP, length)]
    return struct.pack(f"<B{len(numbers)}I", len(places), *numbers)


def places_of(body: memoryview) -> tuple[list[Place], memoryview]:
    """The place of each part of a frame, and the frame itself. LinkError: the body is no such frame."""
    count = body[0] if body else 0
    end = 1 + 8 * count
    if not count or len(body) < end:
        raise LinkError("a frame that does not say where its parts are")
    numbers = struct.unpack_from(f"<{2 * count}I", body, 1)
    return [(start * STEP, length) for start, length in zip(numbers[::2], numbers[1::2], strict=True)], body[end:]


def freed_bytes(freed: Sequence[tuple[int, int]]) -> bytes:
    """A message: these extents are free again, each a ring's number and its start."""
    return bytes((FREED,)) + b"".join(_FREED.pack(number, start // STEP) for number, start in freed)


def freed_of(body: bytes) -> list[tuple[int, int]]:
    """The extents in a message of `freed_bytes`. LinkError: the body is no such message."""
    if (len(body) - 1) % _FREED.size:
        raise LinkError("extents that are given back in part")
    return [(number, start * STEP) for number, start in _FREED.iter_unpack(body[1:])]
