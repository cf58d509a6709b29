"""A codec: aiorts' own, packed, for lines that are slower than processors. `aiorts.testing.check_codec` tries it."""

from __future__ import annotations

import zlib
from typing import Any

from aiorts.errors import WireError
from aiorts.wire import DATA, MsgpackCodec

__all__ = ("DeflateCodec",)


class DeflateCodec:
    """Records as deflated msgpack."""

    def __init__(self) -> None:
        self._inner = MsgpackCodec()

    def encode(self, record: Any) -> bytes:
        """The record as one frame."""
        return zlib.compress(self._inner.encode(record), 1)

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        """The record of one frame. WireError if it is none; a small frame that unpacks to a huge one is refused."""
        unpacking = zlib.decompressobj()
        try:
            frame = unpacking.decompress(data, DATA.frame)
        except zlib.error as error:
            raise WireError(f"no deflated frame: {error}") from error
        if not unpacking.eof or unpacking.unused_data:
            raise WireError("the frame is not whole, too large, or has something behind it")
        return self._inner.decode(frame, expected)
