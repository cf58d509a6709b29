"""Records to bytes and back; nothing here opens a socket or a file."""

from __future__ import annotations

from aiorts.wire.codec import FORMAT, Codec, MsgpackCodec
from aiorts.wire.limits import CONTROL, DATA, Limits

__all__ = ("CONTROL", "DATA", "FORMAT", "Codec", "Limits", "MsgpackCodec")
