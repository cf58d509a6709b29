"""Records to bytes and back; nothing here opens a socket or a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.wire.arrays import ELEMENTS
    from aiorts.wire.codec import FORMAT, Codec, MsgpackCodec
    from aiorts.wire.codecs import find_codec
    from aiorts.wire.limits import CONTROL, DATA, Limits
    from aiorts.wire.lines import LineReader, LineWriter, json_text, line_of, split_sample
    from aiorts.wire.schemas import json_message, schema_text

__all__ = (
    "CONTROL",
    "DATA",
    "ELEMENTS",
    "FORMAT",
    "Codec",
    "Limits",
    "LineReader",
    "LineWriter",
    "MsgpackCodec",
    "find_codec",
    "json_message",
    "json_text",
    "line_of",
    "schema_text",
    "split_sample",
)

_late(
    globals(),
    {
        "aiorts.wire.arrays": "ELEMENTS",
        "aiorts.wire.codec": "FORMAT Codec MsgpackCodec",
        "aiorts.wire.codecs": "find_codec",
        "aiorts.wire.limits": "CONTROL DATA Limits",
        "aiorts.wire.lines": "LineReader LineWriter json_text line_of split_sample",
        "aiorts.wire.schemas": "json_message schema_text",
    },
)
