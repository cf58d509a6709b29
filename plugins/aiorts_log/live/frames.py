"""Records samples that are encoded already: types that this process does not have are recorded like all others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, cast

import msgpack  # type: ignore[import-untyped]

from aiorts.errors import WireError
from aiorts.wire import FORMAT
from aiorts_log.mcap.encodings import SCHEMA_ENCODING, Encoding
from aiorts_log.mcap.format import Schema
from aiorts_log.recorder.port_state import PortState
from aiorts_log.recorder.weight import SMALL
from aiorts_log.recorder.writer import RecordingWriter

_HEAD: Final = 8_192
"""The most bytes of a frame up to the end of its type's name."""


class Frame:
    """A sample as its frame. The frames of each type have a class of their own, made by `frame_kind`."""

    __slots__ = ("data", "tm")
    schema: ClassVar[Schema]
    begin: ClassVar[bytes]
    """The bytes with which frames of this type begin."""

    def __init__(self, tm: int, data: bytes) -> None:
        self.tm = tm
        self.data = data


def frame_kind(name: str, schema: str, base: type[Frame] = Frame) -> type[Frame]:
    """Make the class of the frames of a type; for a type derived from a port's, `base` is the port's class."""
    made = Schema(0, name, SCHEMA_ENCODING, schema.encode())
    return type("Frame", (base,), {"__slots__": (), "schema": made, "begin": _begin(name)})


def _begin(name: str) -> bytes:
    return cast("bytes", msgpack.packb([FORMAT, name, None]))[:-1]


def type_in(frame: bytes) -> str:
    """The name of the type of a frame.

    Raises:
        WireError: it is no frame.
    """
    unpacker = msgpack.Unpacker(max_buffer_size=_HEAD)
    unpacker.feed(frame[:_HEAD])
    try:
        unpacker.read_array_header()
        unpacker.skip()
        return str(unpacker.unpack())
    except (ValueError, msgpack.UnpackException) as error:
        raise WireError(f"no frame: {error}") from None


class FrameWriter(RecordingWriter):
    """A recording of frames: the types of its ports are classes of frames."""

    @staticmethod
    def encoder(encoding: Encoding, cls: type) -> Callable[[Any], bytes]:
        """A function that gives the bytes of a frame, which are recorded as they are."""
        return _data

    @staticmethod
    def splitter(encoding: Encoding, cls: type) -> None:
        """None: no part of a frame is copied."""

    def _state(self, name: str, cls: type, metadata: Mapping[str, str]) -> PortState:
        return PortState(name, cls, metadata, _weigh, stamped=True, mutable=False)

    def _schema(self, port: PortState, cls: type[Frame]) -> Schema:
        return cls.schema


def _data(frame: Frame) -> bytes:
    return frame.data


def _weigh(frame: Frame) -> int:
    return SMALL + len(frame.data)
