"""Codecs that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

from typing import Any

from aiorts.errors import WireError
from aiorts.types import TimedDouble, TimedNDArray, TimedOctetSeq
from aiorts.wire import MsgpackCodec


class LosesTheSignOfZero(MsgpackCodec):
    """Adds 0.0, which makes 0.0 of -0.0."""

    def encode(self, record: Any) -> bytes:
        if isinstance(record, TimedDouble):
            record = TimedDouble(record.tm, record.data + 0.0)
        return super().encode(record)


class ReadsPastTheEnd(MsgpackCodec):
    """Ignores what follows a frame."""

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        for end in range(len(data), 0, -1):
            try:
                return super().decode(data[:end], expected)
            except WireError:
                continue
        raise WireError("no frame")


class ForgetsTheElementType(MsgpackCodec):
    """Makes float64 of every array of any shape."""

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        record = super().decode(data, expected)
        return TimedNDArray(record.tm, record.data.astype("f8")) if isinstance(record, TimedNDArray) else record


class ForgetsTheByteOrder(MsgpackCodec):
    """Takes the bytes of an array as they lie in memory."""

    def encode(self, record: Any) -> bytes:
        if isinstance(record, TimedNDArray) and record.data.ndim == 3:
            record = TimedNDArray(record.tm, record.data.byteswap())
        return super().encode(record)


class ConfusesEmptiness(MsgpackCodec):
    """Has no empty byte sequences."""

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        record = super().decode(data, expected)
        return TimedOctetSeq(record.tm, b"\0") if isinstance(record, TimedOctetSeq) and not len(record.data) else record


class LetsErrorsThrough(MsgpackCodec):
    """Says IndexError for a frame that ends too early."""

    def decode(self, data: bytes, expected: type | None = None) -> Any:
        if len(data) < 3:
            return data[2]
        return super().decode(data, expected)
