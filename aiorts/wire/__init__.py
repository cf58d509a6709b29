"""Records to bytes and back; nothing here opens a socket or a file."""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.types.arrays import sealed_bytes
    from aiorts.wire.arrays import ELEMENTS
    from aiorts.wire.codec import FORMAT, Codec, MsgpackCodec, PartsCodec, with_parts
    from aiorts.wire.codecs import find_codec
    from aiorts.wire.limits import CONTROL, DATA, LINK, Limits
    from aiorts.wire.lines import LineReader, LineWriter, json_text, line_of, split_sample
    from aiorts.wire.scan import count_values
    from aiorts.wire.schemas import json_message, schema_text, units_in, without_units
    from aiorts.wire.too_large import excess
    from aiorts.wire.untyped import layout_text, untyped_decoder

__all__ = (
    "CONTROL",
    "DATA",
    "ELEMENTS",
    "FORMAT",
    "LINK",
    "Codec",
    "Limits",
    "LineReader",
    "LineWriter",
    "MsgpackCodec",
    "PartsCodec",
    "count_values",
    "excess",
    "find_codec",
    "json_message",
    "json_text",
    "layout_text",
    "line_of",
    "schema_text",
    "units_in",
    "without_units",
    "sealed_bytes",
    "split_sample",
    "untyped_decoder",
    "with_parts",
)

_late()
