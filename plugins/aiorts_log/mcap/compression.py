"""Unpacks chunks that other programs compressed, to the size they declare and no more; libraries are loaded late.

aiorts does not compress its recordings: samples of the open chunk have to be on their way to the disk after 0.2 s.
"""

from __future__ import annotations

import importlib
from typing import Any

from aiorts.errors import MissingExtra
from aiorts_log.mcap.format import BadBytes


def decompress(name: str, data: bytes | memoryview, size: int) -> bytes:
    """Unpack `data` into exactly `size` bytes.

    Raises:
        BadBytes: there are more or fewer bytes, they are not of this compression, or the compression is unknown.
        MissingExtra: the library for it is not installed.
    """
    if name == "lz4":
        return _lz4(data, size)
    if name == "zstd":
        return _zstd(data, size)
    raise BadBytes(f"a chunk is compressed by {name[:20]!r}; this version knows lz4 and zstd")


def _library(module: str, package: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtra("a recording with compressed chunks", package, "log") from None


def _lz4(data: bytes | memoryview, size: int) -> bytes:
    unpacker = _library("lz4.frame", "lz4").LZ4FrameDecompressor()
    try:
        found: bytes = unpacker.decompress(bytes(data), max_length=size + 1)
        ended = bool(unpacker.eof)
    except (RuntimeError, ValueError, EOFError) as error:
        raise BadBytes(f"no lz4: {str(error)[:80]}") from None
    return _exact(found, size, ended)


def _zstd(data: bytes | memoryview, size: int) -> bytes:
    library = _library("zstandard", "zstandard")
    try:
        # Unpacked as a stream, since decompress() allocates the size that the frame claims before it reads the data.
        with library.ZstdDecompressor(max_window_size=2**27).stream_reader(bytes(data)) as reader:
            parts, left = [], size + 1
            while left and (part := reader.read(min(left, 2**20))):
                parts.append(part)
                left -= len(part)
    except library.ZstdError as error:
        raise BadBytes(f"no zstd: {str(error)[:80]}") from None
    return _exact(b"".join(parts), size, True)


def _exact(found: bytes, size: int, ended: bool) -> bytes:
    if len(found) != size or not ended:
        raise BadBytes(f"a compressed chunk should have {size} bytes, it has {'more' if len(found) > size else 'less'}")
    return found
