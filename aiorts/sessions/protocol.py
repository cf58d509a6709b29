"""The frames between a client and a kernel: four bytes of length, then one msgpack map.

A client begins with hello: `{"hello": {"oldest": 1, "newest": 1, "who": "aiorts ls", "right": "view"}}`, where `right`
is the highest right that it wants ("view", "operate", "code"; without the key, all that the kernel allows). The kernel
answers with the protocol that both speak, its address, its epoch, and the right that it gives: the wanted one, or the
highest that it allows. A call is `{"id": 1, "op": "profile", "epoch": "...", "args": {...}}`; its answer is one
`{"id": 1, "ok": value}` or `{"id": 1, "error": {"code": ..., "text": ...}}`. An operation that streams goes on after
its "ok" with `{"id": 1, "item": value, "missed": 0}` until `{"id": 1, "end": value}`, or until the client sends
`{"id": 1, "cancel": true}`. Its call may have `"credit": 256`, the number of items that the kernel sends until the
client grants more with `{"id": 1, "credit": 128}`; further items are missed. A kernel that takes such grants has
`"credits": true` in its hello. Each call has one last answer, a cancelled call too: an "error", an "end", or the "ok"
of an operation that does not stream. While the kernel's event loop is held up, the kernel sends `{"busy": seconds}`,
also before its hello. A client that ends its session in order sends `{"bye": true}` before it closes. Unknown keys are
ignored, and so are answers to calls that have ended.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final, Literal, cast

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import AiortsError, ControlError, LimitError, WireError, error_of_code
from aiorts.model.plain import plain
from aiorts.wire.limits import KIB, MIB, Limits
from aiorts.wire.scan import count_values

OLDEST: Final = 1
"""The oldest protocol that this release speaks."""
NEWEST: Final = 1
REQUESTS: Final = Limits(frame=512 * KIB, string=65_536, values=8_192, length=8_192)
"""Limits of the frames of clients: the worst frame takes less than 10 ms to decode."""
ANSWERS: Final = 512 * MIB
"""Bytes of the longest frame that a client takes from a kernel."""
WAITING: Final = 256
"""Calls of one client that may wait or run at a time, and items of a stream that wait to be sent."""
STALL_SECONDS: Final = 30.0
"""Seconds after which a client is cut off if it does not read, or does not complete a frame."""
RightName = Literal["", "view", "operate", "code"]
"""The highest right that a client wants, as in hello; "": all that the kernel allows."""
_LENGTH: Final = 4
_BYTES: Final = "surrogateescape"
"""The error handler for texts that are no valid UTF-8, as Python uses it for paths."""


class Made:
    """Base of values that the thread of the socket makes into plain data when it sends them, not the loop."""

    __slots__ = ()

    def message(self) -> Any:
        """The plain data. It raises nothing."""
        raise NotImplementedError


def agreed(oldest: object, newest: object, who: str) -> int:
    """The newest protocol that both ends speak.

    Raises:
        ControlError: no protocol is common; the text has those of each end.
    """
    if type(oldest) is not int or type(newest) is not int:
        raise ControlError(f"{who}: hello without the protocols it speaks; it is no client of aiorts")
    if oldest > NEWEST or newest < OLDEST:
        theirs = f"{oldest}" if oldest == newest else f"{oldest} to {newest}"
        ours = f"{OLDEST}" if OLDEST == NEWEST else f"{OLDEST} to {NEWEST}"
        raise ControlError(f"{who} speaks protocol {theirs}, this speaks {ours}; use the same release of aiorts")
    return min(newest, NEWEST)


def framed(message: Mapping[str, Any]) -> bytes:
    """A message as its frame."""
    body = packed(message)
    return len(body).to_bytes(_LENGTH, "big") + body


def packed(message: Mapping[str, Any]) -> bytes:
    """A message as msgpack; values of other types are made plain first.

    A path that is not UTF-8 is sent as its bytes on disk, and is the same path at the other end.
    """
    try:
        return cast("bytes", msgpack.packb(message, default=_plain, unicode_errors=_BYTES))
    except (OverflowError, ValueError):  # a value that msgpack cannot express
        return cast("bytes", msgpack.packb(_shortened(plain(message), 0), unicode_errors=_BYTES))


def frames(buffer: bytearray, longest: int) -> Iterator[bytes]:
    """Take whole frames from the beginning of a buffer; the beginning of the next frame stays in it.

    Raises:
        LimitError: a frame's length exceeds `longest`.
    """
    while has_frame(buffer, longest):
        length = int.from_bytes(buffer[:_LENGTH], "big")
        frame = bytes(memoryview(buffer)[_LENGTH : _LENGTH + length])
        del buffer[: _LENGTH + length]
        yield frame


def has_frame(buffer: bytearray, longest: int) -> bool:
    """Whether a whole frame is at the beginning of a buffer; LimitError when its length exceeds `longest`."""
    length = int.from_bytes(buffer[:_LENGTH], "big")
    if length > longest and len(buffer) >= _LENGTH:
        raise LimitError(f"a frame of {length} bytes; at most {longest} are allowed")
    return len(buffer) >= _LENGTH + length


def request_in(frame: bytes) -> dict[Any, Any]:
    """The message of a client in a frame. Raises: WireError: the message is no map, is not whole, or exceeds the limits
    of `REQUESTS`.
    """
    count_values(frame, REQUESTS)
    return answer_in(frame)


def answer_in(frame: bytes) -> dict[Any, Any]:
    """The message of a kernel in a frame; WireError when the message is no map."""
    try:
        value = msgpack.unpackb(frame, strict_map_key=False, raw=False, unicode_errors=_BYTES)
    except (ValueError, TypeError) as error:  # TypeError: a list or map as a key
        raise WireError(f"a frame that is no msgpack: {error}") from None
    if type(value) is not dict:
        raise WireError(f"a frame that is no map but {type(value).__name__}")
    return value


def error_in(found: object, address: str) -> AiortsError:
    """The error that a kernel reports, as the class that has its code."""
    if not isinstance(found, dict):
        return ControlError(f"{address}: {found!s:.200}")
    code, text = str(found.get("code", "")), str(found.get("text", ""))
    if (known := error_of_code(code, text)) is not None:
        return known
    error = ControlError(text)
    error.code = code or ControlError.code  # type: ignore[misc] # a code of a newer kernel
    return error


def _plain(value: object) -> Any:
    if isinstance(value, Made):
        return value.message()
    return bytes(value) if isinstance(value, memoryview | bytearray) else plain(value)


_DEEPEST: Final = 100
_HALF: Final = re.compile("[\ud800-\udc7f\udd00-\udfff]")


def _shortened(value: Any, depth: int) -> Any:
    """The value with text for all that msgpack cannot carry: integers over 64 bits, deep nests, lone surrogates."""
    if depth > _DEEPEST:
        return _sayable(str(value)[:200])
    if isinstance(value, dict):
        return {_shortened(key, depth + 1): _shortened(one, depth + 1) for key, one in value.items()}
    if isinstance(value, list):
        return [_shortened(one, depth + 1) for one in value]
    if type(value) is str:
        return _sayable(value)
    return str(value) if type(value) is int and not -(2**63) <= value < 2**64 else value


def _sayable(text: str) -> str:
    """The text without lone surrogates, which UTF-8 cannot encode; surrogates that stand for bytes stay."""
    return _HALF.sub("\ufffd", text)


BYE: Final = framed({"bye": True})
"""The last frame of a client that ends its session in order."""
