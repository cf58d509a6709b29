"""The frames of a link: a head of 8 bytes (kind, flags, count, number of the link), and what belongs to its kind.

All numbers are little-endian. A frame with another link's number, of an unknown kind or of another length than its head
says is no frame: `BadFrame`.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Final, TypeAlias

Buffer: TypeAlias = bytes | bytearray | memoryview
Send: TypeAlias = Callable[[bytes, Sequence[memoryview]], bool]
"""Gives a frame to a channel, with buffers that travel beside it; False: it was not taken."""

HELLO: Final = 1
DATA: Final = 2
ACK: Final = 3
BYE: Final = 4
WANT: Final = 5
NONE: Final = 6
LOST: Final = 7
CONFIRM: Final = 1
"""Flag of data: acknowledge at once."""
AGED: Final = 2
"""Flag of data: before the samples stands how old each is, in nanoseconds."""
WAIT: Final = 1
"""Flag of want: where there is no sample, the next one. Of none: that one will be sent."""
BATCH: Final = 512
"""Samples of one frame at the most."""
BATCH_BYTES: Final = 32_768
"""Bytes of the samples of one frame at the most, if it is more than one sample."""
FATES: Final = ("rejected", "undecodable")
"""Why samples are not in the reader's buffer."""
LOSSES: Final = ("overwritten", "superseded", "inactive", "expired", "unconverted", "disconnected")
"""Reasons for which the reader's buffer loses samples."""
REFUSED: Final = "refused"
"""The reason that stands for any other one of an acknowledgement: the other end could name a new one each time."""

_WIDEST: Final = 0xFFFF
_HEAD: Final = struct.Struct("<BBHI")
_NUMBERED: Final = struct.Struct("<BBHIQQ")
SOLE: Final = _NUMBERED.size
"""The place of the sample in a frame that has one alone."""
numbered: Final = _NUMBERED.pack
"""Makes a frame, or its head, of kind, flags, count, number of the link, and two numbers."""
numbers_of: Final[Callable[[Buffer], tuple[int, int, int, int, int, int]]] = _NUMBERED.unpack_from
"""These six of a frame that is as long as that at least."""
_FATE: Final = struct.Struct("<QB")


class Turn(enum.Enum):
    """When a message to another kernel is sent."""

    CONTROL = enum.auto()
    """Before all samples that wait."""
    SAMPLE = enum.auto()
    """After the samples that wait."""
    LAST = enum.auto()
    """After the samples that wait, though so much waits that no sample is taken any more."""


_TURNS: Final[Mapping[int, Turn]] = {
    **dict.fromkeys((HELLO, ACK, WANT, LOST), Turn.CONTROL),
    **dict.fromkeys((BYE, NONE), Turn.LAST),
}
"""Bye and none speak of the samples before them, and are said once. What is not known has the bound of samples."""


class BadFrame(ValueError):
    """Bytes that are no frame of this link."""


def check_window(window: int) -> None:
    """ValueError: an acknowledgement cannot say what became of so many samples."""
    if not 1 <= window <= _WIDEST:
        raise ValueError(f"window = {window}: expected 1 to {_WIDEST:,} samples")


def turn_of(frame: Buffer) -> Turn:
    """When a frame is sent."""
    return _TURNS.get(frame[0], Turn.SAMPLE)


def hello(link: int, epoch: int, received: int) -> bytes:
    """Says which end this is, and up to which number it has received."""
    return numbered(HELLO, 0, 0, link, epoch, received)


def data(
    link: int, first: int, oldest: int, samples: Sequence[bytes], *, confirm: bool, ages: Sequence[int] = ()
) -> bytes:
    """Samples from number `first` on, with the ages that are known; the writer keeps those from `oldest` on.

    One sample is the rest of its frame: a length for each is needed of several alone.
    """
    if ages:
        frame = data(link, first, oldest, samples, confirm=confirm)
        head = numbered(DATA, confirm | AGED, len(samples), link, first, oldest)
        return b"".join((head, struct.pack(f"<{len(ages)}Q", *ages), frame[SOLE:]))
    if len(samples) == 1:
        return numbered(DATA, confirm, 1, link, first, oldest) + samples[0]
    lengths = struct.pack(f"<{len(samples)}I", *map(len, samples))
    return b"".join((numbered(DATA, confirm, len(samples), link, first, oldest), lengths, *samples))


def acknowledgement(link: int, done: int, received: int, fates: Mapping[int, str]) -> bytes:
    """All up to `done` are in the reader's buffer but those of `fates`; all up to `received` have come."""
    head = numbered(ACK, 0, len(fates), link, done, received)
    if not fates:
        return head
    frame = [head]
    for number, fate in fates.items():
        text = fate.encode()[:255].decode(errors="ignore").encode()
        frame += (_FATE.pack(number, len(text)), text)
    return b"".join(frame)


def lost(link: int, epoch: int, losses: Mapping[str, int]) -> bytes:
    """Says what this reader's end has lost of what was in its buffer: how many samples by reason, in all."""
    frame = [numbered(LOST, 0, len(losses), link, epoch, 0)]
    for reason, count in losses.items():
        frame += (_FATE.pack(count, len(reason)), reason.encode())
    return b"".join(frame)


def bye(link: int) -> bytes:
    """Says that this end was disconnected."""
    return _HEAD.pack(BYE, 0, 0, link)


def want(link: int, number: int, *, wait: bool) -> bytes:
    """Asks for the sample that will have this number."""
    return numbered(WANT, wait, 0, link, number, 0)


def none(link: int, number: int, *, wait: bool) -> bytes:
    """There is no sample that could have this number."""
    return numbered(NONE, wait, 0, link, number, 0)


def head_of(frame: Buffer, link: int) -> tuple[int, int, int, int, int]:
    """Kind, flags and count of a frame, and two numbers: of hello the epoch and received, of data first and oldest, of
    an acknowledgement done and received, of want and none the number and zero, of lost the epoch and zero, of bye
    zeros.
    BadFrame: it is too short, or of another link."""
    if len(frame) >= SOLE:
        kind, flags, count, number, one, two = numbers_of(frame)
    elif len(frame) == _HEAD.size and frame[0] == BYE:
        (kind, flags, count, number), one, two = _HEAD.unpack(frame), 0, 0
    else:
        raise BadFrame("too short")
    if number != link:
        raise BadFrame("of another link")
    return kind, flags, count, one, two


def ages_of(frame: Buffer, count: int) -> tuple[int, ...]:
    """The age of each sample of a data frame with AGED."""
    if not 0 < count <= BATCH or len(frame) < SOLE + 8 * count:
        raise BadFrame("too short for ages")
    return struct.unpack_from(f"<{count}Q", frame, SOLE)


def samples_of(frame: Buffer, count: int, ages: int = 0) -> list[memoryview]:
    """The bytes of each sample of a data frame with so many ages, not copied."""
    view = memoryview(frame)
    if ages:
        view = view[8 * ages :]
    if count == 1:
        return [view[SOLE:]]
    start = SOLE + 4 * count
    if not 0 < count <= BATCH or len(view) < start:
        raise BadFrame("no such number of samples")
    if len(view) - start > BATCH_BYTES:
        raise BadFrame("of more bytes than several samples have together")
    places = list(accumulate(struct.unpack_from(f"<{count}I", view, SOLE), initial=start))
    if places[-1] != len(view):
        raise BadFrame("of another length")
    return [view[start:end] for start, end in pairwise(places)]


def fates_of(frame: Buffer, count: int) -> dict[int, str]:
    """What became of the samples of an acknowledgement that are not in the reader's buffer, by number."""
    return dict(_pairs_of(frame, count))


def losses_of(frame: Buffer, count: int) -> dict[str, int]:
    """How many samples the reader's end has lost, by reason; those that are not known together."""
    if count > 2 * len(LOSSES):
        raise BadFrame("of too many reasons")
    found: dict[str, int] = {}
    for lost, reason in _pairs_of(frame, count):
        known = reason if reason in LOSSES else REFUSED
        found[known] = found.get(known, 0) + lost
    return found


def _pairs_of(frame: Buffer, count: int) -> Iterator[tuple[int, str]]:
    """The pairs of a number and a word behind the head of a frame."""
    place = SOLE
    for _ in range(count):
        if len(frame) < place + _FATE.size:
            raise BadFrame("too short")
        number, length = _FATE.unpack_from(frame, place)
        place += _FATE.size
        try:
            word = str(frame[place : place + length], "utf-8")
        except UnicodeDecodeError:
            raise BadFrame("no text") from None
        yield number, word
        place += length
    if place != len(frame):
        raise BadFrame("of another length")
