"""Components that make any component a filter of binary frames: as `pipes.py`, with a codec in place of JSON lines.

A frame on a stream is: one octet, the length of the port's name; four octets, the length of the record, most
significant first; the name in UTF-8; the record as its codec has it. A record that is bad is reported and counted, the
others go on; after a head that is no head nothing can be found any more, and the input ends there.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import stat
import struct
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, BinaryIO, Final

from aiorts.errors import AiortsError, RecordError, WireError
from aiorts.kernel.component import Component
from aiorts.kernel.ports import InPort
from aiorts.system.pipes import Incoming, Tell, _next_chunk
from aiorts.system.stream import put
from aiorts.wire.codec import Codec

__all__ = ("FrameInput", "FrameOutput", "framed")

_HEAD: Final = struct.Struct(">BI")
_LONGEST: Final = 64 << 20
"""Octets of a record."""
_SURE: Final = 4096
"""Octets that a pipe which is ready takes without blocking (PIPE_BUF on Linux)."""


def framed(port: str, record: bytes) -> bytes:
    """The frame of an encoded record of the port `port`. RecordError if it is too large."""
    name = port.encode()
    if len(name) > 255 or len(record) > _LONGEST:
        raise RecordError(f"{port[:40]}: a record of {len(record)} octets; at most {_LONGEST} are allowed in a frame")
    return b"".join((_HEAD.pack(len(name), len(record)), name, record))


class FrameInput(Incoming):
    """A source of what the frames of standard input say; for an event context.

    Args: see `Incoming`. With a single port every frame is for it, whatever port the frame names: the out-port of who
        wrote it.
        codec: what decodes the records.
    """

    def __init__(
        self, name: str, ports: Mapping[str, type], codec: Codec, tell: Tell, *args: Any, **options: Any
    ) -> None:
        super().__init__(name, ports, tell, *args, **options)
        self.frames = 0
        """Frames read, bad ones among them."""
        self._codec = codec

    async def _read(self, descriptor: int | None) -> None:
        try:
            async for port, record in _frames(descriptor):
                if self._count is not None and self.frames - self.bad >= self._count:
                    return
                self.frames += 1
                await self._take(port, record)
        except WireError as error:  # no head, or half a frame: what follows cannot be told apart
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
    """Writes what arrives to standard output, one frame for each sample; for an event context.

    Args:
        ports: type of each out-port that is to be shown; this component gets an in-port of the same name for it.
        codec: what encodes the records.
        stream: where frames go; standard output by default.
        count: after so many samples no more are written and `done` is called; None is without end.
    """

    def __init__(
        self,
        name: str,
        ports: Mapping[str, type],
        codec: Codec,
        *,
        stream: BinaryIO | None = None,
        count: int | None = None,
        done: Callable[[], None] | None = None,
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
            await asyncio.to_thread(put, stream, data)  # a slow reader makes us wait, and not the loop


def _takes(stream: BinaryIO, size: int) -> bool:
    """Whether the stream takes that much without making us wait."""
    try:
        descriptor = stream.fileno()
        if stat.S_ISREG(os.fstat(descriptor).st_mode) or not hasattr(select, "poll"):
            return True
    except (OSError, ValueError, AttributeError):
        return True  # in memory, or closed: writing says which
    if size > _SURE:
        return False
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    with contextlib.suppress(OSError):
        return bool(poll.poll(0))
    return True


async def _frames(descriptor: int | None) -> AsyncIterator[tuple[bytes, bytes]]:
    """Port and record of each frame, as they come. WireError where the input cannot be told apart any more."""
    rest = bytearray()
    while descriptor is not None and (chunk := await _next_chunk(descriptor)):
        rest += chunk
        start = 0
        while len(rest) - start >= _HEAD.size:
            name, size = _HEAD.unpack_from(rest, start)
            if size > _LONGEST:
                raise WireError(
                    f"a frame of {size} octets; at most {_LONGEST} are allowed; is the input frames at all?"
                )
            middle = start + _HEAD.size + name
            if len(rest) < middle + size:
                break
            yield bytes(rest[start + _HEAD.size : middle]), bytes(rest[middle : middle + size])
            start = middle + size
        del rest[:start]
    if rest:
        raise WireError(f"the input ends inside a frame, after {len(rest)} octets of it")
