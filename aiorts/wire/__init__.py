"""Records to bytes and back; nothing here opens a socket or a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.wire.codec import FORMAT, Codec, MsgpackCodec
    from aiorts.wire.codecs import find_codec
    from aiorts.wire.limits import CONTROL, DATA, Limits
    from aiorts.wire.lines import LineReader, LineWriter, json_text, line_of, split_sample

__all__ = (
    "CONTROL",
    "DATA",
    "FORMAT",
    "Codec",
    "Limits",
    "LineReader",
    "LineWriter",
    "MsgpackCodec",
    "find_codec",
    "json_text",
    "line_of",
    "split_sample",
)

_late(
    globals(),
    {
        "aiorts.wire.codec": "FORMAT Codec MsgpackCodec",
        "aiorts.wire.codecs": "find_codec",
        "aiorts.wire.limits": "CONTROL DATA Limits",
        "aiorts.wire.lines": "LineReader LineWriter json_text line_of split_sample",
    },
)
