"""The messages of kernels about links, besides the offer: short lists of plain values, bounded."""

from __future__ import annotations

from typing import Any, Final

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import LinkError, WireError
from aiorts.late import dataclass
from aiorts.wire import LINK, count_values

LARGEST: Final = 1_048_576
"""The most bytes of a message from another program."""
_LONGEST: Final = 2_000


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to an offer, or to a request for one."""

    number: int = 0
    """The number that the frames of the link carry; 0: there is none."""
    epoch: int = 0
    """The epoch of the reader's end."""
    absent: str = ""
    """The reason why the link is not possible yet: what has to come."""
    refused: str = ""
    """The reason why the link is not possible."""
    protocol: tuple[int, int] = (0, 0)
    """The versions that the answering kernel speaks."""

    def to_bytes(self) -> bytes:
        """The answer as one frame."""
        texts = [self.absent[:_LONGEST], self.refused[:_LONGEST]]
        return packed([self.number, self.epoch, *texts, list(self.protocol)])

    @classmethod
    def from_bytes(cls, body: bytes) -> Answer:
        """The answer in a frame. LinkError: the frame is no answer."""
        number, epoch, absent, refused, protocol = fields(body, (int, int, str, str, list), longer=True)
        if not 0 <= number < 2**32 or not 0 <= epoch < 2**64:
            raise LinkError(f"an answer with the number {number} and the epoch {epoch}")
        low, high = checked(protocol, (int, int), longer=True)
        return cls(number, epoch, absent, refused, (low, high))


@dataclass(frozen=True, slots=True)
class LinkRequest:
    """A request to a kernel to connect one of its out-ports with an in-port of the kernel that asks."""

    writer: str
    reader: str
    options: dict[str, Any]
    protocol: tuple[int, int]
    """The versions that the asking kernel speaks."""

    def to_bytes(self) -> bytes:
        """The request as one frame."""
        return packed([list(self.protocol), self.writer, self.reader, self.options])

    @classmethod
    def from_bytes(cls, body: bytes) -> LinkRequest:
        """The request in a frame. LinkError: the frame is no request."""
        protocol, writer, reader, options = fields(body, (list, str, str, dict), longer=True)
        if not all(isinstance(key, str) for key in options):
            raise LinkError("a request whose options are not named by texts")
        low, high = checked(protocol, (int, int), longer=True)
        return cls(writer, reader, options, (low, high))


def versions_of(body: bytes) -> tuple[int, int]:
    """The versions that the sender of an offer or request speaks; its other fields may be of a later version.
    LinkError: the message names none."""
    (protocol,) = fields(body, (list,), longer=True)
    low, high = checked(protocol, (int, int), longer=True)
    return low, high


def packed(values: list[Any]) -> bytes:
    """These plain values as one frame."""
    frame: bytes = msgpack.Packer().pack(values)
    return frame


def fields(body: bytes, kinds: tuple[type, ...], *, longer: bool = False, largest: int = LARGEST) -> list[Any]:
    """The values of a frame, as `checked` returns them. LinkError: a kind differs, or the body is no frame."""
    if len(body) > largest:
        raise LinkError(f"a message of {len(body)} bytes; at most {largest} are allowed")
    try:
        count_values(body, LINK)
        values = msgpack.unpackb(body, strict_map_key=False, max_ext_len=0)
    except (WireError, ValueError, TypeError, msgpack.UnpackException) as error:
        raise LinkError(f"no message of this protocol: {type(error).__name__}") from None
    return checked(values, kinds, longer=longer)


def checked(values: Any, kinds: tuple[type, ...], *, longer: bool = False) -> list[Any]:
    """These values, a list of exactly these kinds; with `longer` those of a later version may follow and are left out.
    LinkError: they are something else."""
    if type(values) is not list or len(values) < len(kinds) or (len(values) > len(kinds) and not longer):
        raise LinkError("no message of this protocol: another number of fields")
    if any(type(value) is not kind for value, kind in zip(values, kinds, strict=False)):
        raise LinkError("no message of this protocol: fields of other kinds")
    return values[: len(kinds)]
