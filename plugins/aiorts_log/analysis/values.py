"""The values of a sample, for a comparison: plain data with numpy arrays, whether its type is known or not."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from enum import Enum
from typing import Any, Final

from aiorts.errors import AiortsError
from aiorts.types import convert, to_plain
from aiorts.wire import ELEMENTS
from aiorts_log.errors import DamagedError
from aiorts_log.mcap.encodings import array_parts, plain_of
from aiorts_log.mcap.reader import RecordedSample

_ARRAY: Final = {"dtype", "shape", "data"}


def values_of(sample: RecordedSample) -> Any:
    """The values of a sample. DamagedError when its bytes are no sample of its type."""
    port = sample.port
    if not port.unknown:
        try:
            return _values(port.decode(sample.data))
        except AiortsError as error:
            raise DamagedError(f"port {port.name!r}, sample {sample.sequence}: {error}") from None
    if port.encoding == "msgpack":
        return plain_of(sample.data, port.encoding, port.schema, _packed)
    return _unwrapped(port.plain(sample.data))


def _values(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: _values(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {name: _values(one) for name, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_values(one) for one in value]
    if isinstance(value, Enum):
        return value.name
    if hasattr(value, "utcoffset"):
        return convert(value, "i64")
    return value if value is None or hasattr(value, "dtype") else to_plain(value)


def _packed(data: bytes, about: Any) -> Any:
    """The array in a frame; an array of records becomes a list of their fields."""
    element, shape, head = array_parts(data)
    array = _array(element, shape, data[head:])
    columns = about.get("columns") if isinstance(about, dict) else None
    if isinstance(columns, list) and len(shape) == 2 and len(columns) == shape[1]:
        return [dict(zip(columns, (to_plain(one) for one in row), strict=True)) for row in array.tolist()]
    return array


def _unwrapped(plain: Any) -> Any:
    """Plain data, in which descriptions of arrays are replaced by the arrays."""
    if isinstance(plain, dict):
        if plain.keys() == _ARRAY:
            try:
                return _array(plain["dtype"], plain["shape"], base64.b64decode(plain["data"], validate=True))
            except (TypeError, ValueError):
                return plain  # it only looks like an array
        return {name: _unwrapped(one) for name, one in plain.items()}
    return [_unwrapped(one) for one in plain] if isinstance(plain, list) else plain


def _array(element: Any, shape: Any, data: bytes) -> Any:
    """An array of numpy. TypeError or ValueError when element, shape and bytes disagree."""
    import numpy as np  # late: most commands need none

    if element not in ELEMENTS or math.prod(shape) < 0:
        raise ValueError("no array")
    code = "?" if element == "bool" else f"<{element[0]}{int(element[1:]) // 8}"
    return (np.frombuffer(data, dtype=code) if data else np.empty(0, dtype=code)).reshape(shape)
