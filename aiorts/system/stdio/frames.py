"""Connects ports with streams of binary frames: as `pipes.py`, with a codec instead of JSON lines.

A frame is: one byte, the length of the port's name; four bytes, the length of the record, most significant first; the
name in UTF-8; the record encoded by the codec. A bad record is reported and counted, and the others are
processed; after a bad head the next frame cannot be found, and the input ends.
"""

from __future__ import annotations

import asyncio
import struct
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from aiorts.errors import AiortsError, RecordError, WireError
from aiorts.kernel.component import Component
from aiorts.kernel.loop.line_stream import SURE, has_room, put, slow
from aiorts.kernel.ports import InPort
from aiorts.system.stdio.pipes import Incoming, Notify, _next_chunk

if TYPE_CHECKING:
    from aiorts.wire.codec import Codec

_HEAD: Final = struct.Struct(">BI")
_LONGEST: Final = 64 << 20
"""The most bytes of a record."""


def framed(port: str, record: bytes) -> bytes:
    """Make the frame of an encoded record of the port `port`. RecordError if it is too large."""
    name = port.encode()
    if len(name) > 255 or len(record) > _LONGEST:
        raise RecordError(f"{port[:40]}: a record of {len(record)} bytes; at most {_LONGEST} are allowed in a frame")
    return b"".join((_HEAD.pack(len(name), len(record)), name, record))


class FrameInput(Incoming):
    """A source that reads frames from standard input; for an event context.

    Args: see `Incoming`. With a single port every frame is for it, whatever port the frame names, which is the writer's
        out-port.
        codec: decodes the records.
    """

    def __init__(
        self, name: str, ports: Mapping[str, type], codec: Codec, notify: Notify, *args: Any, **options: Any
    ) -> None:
        super().__init__(name, ports, notify, *args, **options)
        self.frames = 0
        """The number of frames read, bad ones among them."""
        self._codec = codec

    async def _read(self, descriptor: int | None) -> None:
        try:
            async for port, record in _frames(descriptor):
                if self._count is not None and self.frames - self.bad >= self._count:
                    return
                self.frames += 1
                await self._take(port, record)
        except WireError as error:  # a bad head, or half a frame: the next frame cannot be found
            self.frames += 1
            self._complain(self.frames, str(error))

    async def _take(self, name: bytes, record: bytes) -> None:
        try:
            port = next(iter(self._types)) if len(self._types) == 1 else name.decode()
            if port not in self._types:
                raise RecordError(f"no in-port {port[:60]!r}; there are {', '.join(self._types)}")
            sample = self._codec.decode(record, self._types[port])
        except (AiortsError, UnicodeDecodeError) as error:
            self._complain(self.frames, str(error))
        else:
            await self._feed.write(port, self.frames, sample)


class FrameOutput(Component):
    """Writes the samples it gets to standard output, one frame each; for an event context.

    Args:
        ports: type of each out-port to write; this component gets an in-port of the same name for it.
        codec: encodes the records.
        stream: the stream that gets the frames; standard output by default.
        count: number of samples after which it stops and calls `done`; None never stops.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        codec: Codec,
        *,
        stream: BinaryIO | None = None,
        count: int | None = None,
        done: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(name)
        self.written = 0
        self._codec = codec
        self._stream = stream
        self._count = count
        self._done = done
        for port, cls in ports.items():
            self.add_port(port, InPort(cls))

    async def on_execute(self) -> None:
        ports = [port for port in self.ports.values() if isinstance(port, InPort)]
        frames = [framed(port.name, self._codec.encode(sample)) for port in ports for sample in port.drain()]
        if self._count is not None:
            frames = frames[: self._count - self.written]
        await self._write(b"".join(frames))
        self.written += len(frames)
        if self.written == self._count and frames and self._done is not None:
            self._done()

    async def _write(self, data: bytes) -> None:
        stream = getattr(sys.stdout, "buffer", None) if self._stream is None else self._stream
        if stream is None or not data:
            return  # started without standard output
        if _takes(stream, len(data)):
            put(stream, data)
        else:
            await asyncio.to_thread(put, stream, data)  # a slow reader makes this component wait, and not the loop


def _takes(stream: BinaryIO, size: int) -> bool:
    """Whether the stream takes that much without blocking."""
    descriptor = slow(stream)
    return descriptor is None or (size <= SURE and has_room(descriptor))


async def _frames(descriptor: int | None) -> AsyncIterator[tuple[bytes, bytes]]:
    """Port and record of each frame, as they arrive. WireError when the next frame cannot be found."""
    rest = bytearray()
    while descriptor is not None and (chunk := await _next_chunk(descriptor)):
        rest += chunk
        start = 0
        while len(rest) - start >= _HEAD.size:
            name, size = _HEAD.unpack_from(rest, start)
            if size > _LONGEST:
                raise WireError(f"a frame of {size} bytes; at most {_LONGEST} are allowed; does the input have frames?")
            middle = start + _HEAD.size + name
            if len(rest) < middle + size:
                break
            yield bytes(rest[start + _HEAD.size : middle]), bytes(rest[middle : middle + size])
            start = middle + size
        del rest[:start]
    if rest:
        raise WireError(f"the input ends inside a frame, after {len(rest)} bytes of it")
