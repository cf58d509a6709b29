"""The frames of a link: a head of 8 bytes (kind, flags, count, number of the link), and the contents of its kind.

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
"""Gives a frame to a channel, with buffers that travel next to it; False: the channel did not take the frame."""

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
"""Flag of data: the age of each sample, in nanoseconds, stands before the samples."""
WAIT: Final = 1
"""Flag of want: where there is no sample, the next one is wanted. Flag of none: the next one will be sent."""
BATCH: Final = 512
"""The most samples of one frame."""
BATCH_BYTES: Final = 32_768
"""The most bytes of the samples of one frame with more than one."""
FATES: Final = ("rejected", "undecodable")
"""The fates of samples that are not in the reader's buffer."""
LOSSES: Final = ("overwritten", "superseded", "inactive", "expired", "unconverted", "disconnected")
"""Reasons for which the reader's buffer loses samples."""
REFUSED: Final = "refused"
"""The fate that replaces an unknown fate in an acknowledgement: the other end could name a new fate each time."""

_WIDEST: Final = 0xFFFF
_HEAD: Final = struct.Struct("<BBHI")
_NUMBERED: Final = struct.Struct("<BBHIQQ")
SOLE: Final = _NUMBERED.size
"""The place of the sample in a frame that has just one."""
numbered: Final = _NUMBERED.pack
"""Makes a frame, or its head, of kind, flags, count, number of the link, and two numbers."""
numbers_of: Final[Callable[[Buffer], tuple[int, int, int, int, int, int]]] = _NUMBERED.unpack_from
"""Reads these six numbers of a frame that is long enough."""
_FATE: Final = struct.Struct("<QB")


class Turn(enum.Enum):
    """The turn of a message to another kernel among the samples that wait."""

    CONTROL = enum.auto()
    """Before all samples that wait."""
    SAMPLE = enum.auto()
    """After the samples that wait."""
    LAST = enum.auto()
    """After the samples that wait, even where so much waits that no sample is taken any more."""


_TURNS: Final[Mapping[int, Turn]] = {
    **dict.fromkeys((HELLO, ACK, WANT, LOST), Turn.CONTROL),
    **dict.fromkeys((BYE, NONE), Turn.LAST),
}
"""Bye and none refer to the samples before them, and are sent once. Unknown kinds have the turn of samples."""


class BadFrame(ValueError):
    """Bytes that are no frame of this link."""


def check_window(window: int) -> None:
    """Raise ValueError unless one acknowledgement can report on so many samples."""
    if not 1 <= window <= _WIDEST:
        raise ValueError(f"window = {window}: expected 1 to {_WIDEST:,} samples")


def turn_of(frame: Buffer) -> Turn:
    """The turn of a frame."""
    return _TURNS.get(frame[0], Turn.SAMPLE)


def hello(link: int, epoch: int, received: int) -> bytes:
    """The frame that names this end, and the number up to which it has received."""
    return numbered(HELLO, 0, 0, link, epoch, received)


def data(
    link: int, first: int, oldest: int, samples: Sequence[bytes], *, confirm: bool, ages: Sequence[int] = ()
) -> bytes:
    """The frame of samples from number `first` on, with any known ages; the writer keeps samples from `oldest` on.

    One sample is the rest of its frame; only several samples need a length each.
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
    """The frame saying: all up to `done` are in the reader's buffer except `fates`; all up to `received` have come."""
    head = numbered(ACK, 0, len(fates), link, done, received)
    if not fates:
        return head
    frame = [head]
    for number, fate in fates.items():
        text = fate.encode()[:255].decode(errors="ignore").encode()
        frame += (_FATE.pack(number, len(text)), text)
    return b"".join(frame)


def lost(link: int, epoch: int, losses: Mapping[str, int]) -> bytes:
    """The frame that says how many samples of its buffer this reader's end has lost in all, by reason."""
    frame = [numbered(LOST, 0, len(losses), link, epoch, 0)]
    for reason, count in losses.items():
        frame += (_FATE.pack(count, len(reason)), reason.encode())
    return b"".join(frame)


def bye(link: int) -> bytes:
    """The frame that says that this end was disconnected."""
    return _HEAD.pack(BYE, 0, 0, link)


def want(link: int, number: int, *, wait: bool) -> bytes:
    """The frame that asks for the sample with this number."""
    return numbered(WANT, wait, 0, link, number, 0)


def none(link: int, number: int, *, wait: bool) -> bytes:
    """The frame that says that no sample has this number yet."""
    return numbered(NONE, wait, 0, link, number, 0)


def head_of(frame: Buffer, link: int) -> tuple[int, int, int, int, int]:
    """Kind, flags and count of a frame, and two numbers. BadFrame: the frame is too short, or of another link.

    The numbers are epoch and received (hello), first and oldest (data), done and received (acknowledgement), the
    number and zero (want and none), epoch and zero (lost), zeros (bye).
    """
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
    """The bytes of each sample of a data frame with `ages` ages before the samples; not copied."""
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
    """The fates in an acknowledgement, by number, of the samples that are not in the reader's buffer."""
    return dict(_pairs_of(frame, count))


def losses_of(frame: Buffer, count: int) -> dict[str, int]:
    """The number of samples that the reader's end has lost, by reason; unknown reasons count together."""
    if count > 2 * len(LOSSES):
        raise BadFrame("of too many reasons")
    found: dict[str, int] = {}
    for lost, reason in _pairs_of(frame, count):
        known = reason if reason in LOSSES else REFUSED
        found[known] = found.get(known, 0) + lost
    return found


def _pairs_of(frame: Buffer, count: int) -> Iterator[tuple[int, str]]:
    """The pairs of a number and a word after the head of a frame."""
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
