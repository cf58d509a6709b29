"""Bombs and lies are refused quickly and without the memory they ask for."""

from __future__ import annotations

# ruff: noqa: E501 - tables read better with one case on a line
import random
import resource
import struct
import time
import tracemalloc
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import LimitError, WireError
from aiorts.types import ActArrayState, Actuator, TimedDouble, TimedNDArray, TimedOctetSeq, TimedString, TimedStringSeq
from aiorts.wire import CONTROL, DATA, LINK, Limits, MsgpackCodec
from aiorts.wire.scan import count_values
from campaign import cases

MIB = 1 << 20
CODEC = MsgpackCodec()
SMALL = MsgpackCodec(CONTROL)


def _frame(fields: bytes, name: bytes = b"TimedMap") -> bytes:
    return b"\x93\x01" + bytes([0xA0 + len(name)]) + name + fields


BOMBS = {
    "nested array16": b"\xdc\xff\xff" * 1000,
    "nested array16, 73 kB": b"\xdc\xff\xff" * 24_400,
    "nested array16 that fit": b"\xdc\x03\xe8" * 330,
    "array32 of 2**31": b"\xdd\x80\x00\x00\x00",
    "map32 of 2**32 - 1": b"\xdf\xff\xff\xff\xff",
    "10 MB of empty maps": b"\xdd" + struct.pack(">I", 10 * MIB) + b"\x80" * (10 * MIB),
    "10 MB of nested empty maps": b"\xdc\x27\x10" + (b"\xdc\x03\xe8" + b"\x80" * 1000) * 10_000,
    "10 MB of small lists": b"\xdc\xff\xfe" + b"\x94\x01\x01\x01\x01" * (2 * MIB),
    "depth 100,000": b"\x91" * 100_000 + b"\x01",
    "depth 1,000": b"\x91" * 1_000 + b"\x01",
    "depth 1,000 of maps": b"\x81\xa1a" * 1_000 + b"\x01",
    "str32 of 4 GiB": b"\xdb\xff\xff\xff\xff",
    "bin32 of 4 GiB": b"\xc6\xff\xff\xff\xff",
    "str32 of 2 MiB": b"\xdb" + struct.pack(">I", 2 * MIB) + b"a" * (2 * MIB),
    "duplicate keys": b"\x82\xa2tm\x01\xa2tm\x02",
    "duplicate keys inside": b"\x82\xa2tm\x01\xa4data\x82\xa1a\x01\xa1a\x02",
    "list as key": b"\x81\x91\x01\x01",
    "integer as key": b"\x81\x01\x01",
    "bad utf-8": b"\x82\xa2tm\x01\xa4data\x81\xa1a\xa2\xff\xfe",
    "lone surrogate in utf-8": b"\x82\xa2tm\x01\xa4data\x81\xa1a\xa3\xed\xa0\x80",
    "extension type": b"\x82\xa2tm\x01\xa4data\x81\xa1a\xd4\x05\x00",
    "extension type without bytes": b"\x82\xa2tm\x01\xa4data\x81\xa1a\xc7\x00\x05",
    "extension type of 4 GiB": b"\xc9\xff\xff\xff\xff\x05",
    "time stamp extension": b"\x82\xa2tm\xd6\xff\x00\x00\x00\x00\xa4data\x80",
    "trailing bytes": b"\x82\xa2tm\x01\xa4data\x80\x00",
    "many trailing bytes": b"\x82\xa2tm\x01\xa4data\x80" + b"\x00" * 5000,
    "a value that is none": b"\x82\xa2tm\x01\xa4data\xc1",
    "cut off": b"\x82\xa2tm\x01\xa4da",
}


def _refused_in(codec: MsgpackCodec, data: bytes) -> float:
    """Seconds of the processor: what else the machine does is not the codec's."""
    started = time.thread_time()
    with pytest.raises(WireError):
        codec.decode(data)
    return time.thread_time() - started


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E13")
@pytest.mark.parametrize("wrapped", [True, False], ids=["as fields", "as frame"])
@pytest.mark.parametrize("bomb", BOMBS)
def test_bomb_is_refused_within_10_ms_and_20_mib(bomb: str, wrapped: bool) -> None:
    data = _frame(BOMBS[bomb]) if wrapped else BOMBS[bomb]
    for codec in (CODEC, SMALL, MsgpackCodec(LINK)):
        assert min(_refused_in(codec, data) for _ in range(3)) < 0.010
        resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        tracemalloc.start()
        try:
            _refused_in(codec, data)
            assert tracemalloc.get_traced_memory()[1] < 20 * MIB
        finally:
            tracemalloc.stop()
        assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident) * 1024 < 20 * MIB


@pytest.mark.slow
@pytest.mark.fault("E13")
def test_values_of_a_frame_are_counted_and_an_array_is_one() -> None:
    assert count_values(msgpack.packb([1, "a", {"b": [None, 1.5]}]), DATA) == 8
    one = TimedNDArray(0, np.zeros((1000, 100)))
    assert count_values(CODEC.encode(one), DATA) == 8
    fits, too_many = 65_536 - 8, 65_536 - 7
    assert len(CODEC.decode(CODEC.encode(TimedStringSeq(0, ["a"] * fits))).data) == fits
    with pytest.raises(LimitError, match="TimedStringSeq: the frame claims 65537 values or more; at most 65536"):
        CODEC.encode(TimedStringSeq(0, ["a"] * too_many))


_LONG = st.lists(st.sampled_from([0, -1, 127, None, True, "", [], {}, 128, "a", 1.5, [1, 2], b"x"]), max_size=60)


@settings(max_examples=cases(2_000))
@given(_LONG, st.lists(_LONG, max_size=4))
def test_values_of_long_lists_are_counted_whatever_they_are(first: list[Any], others: list[list[Any]]) -> None:
    def values(value: Any) -> int:
        return 1 + (sum(map(values, value)) if isinstance(value, list) else 0)

    whole = [first, *others, {f"k{number}": None for number in range(len(first))}]
    frame = msgpack.packb(whole)
    expected = sum(map(values, whole)) + 1 + 2 * len(first)
    assert count_values(frame, DATA) == count_values(memoryview(frame), DATA) == expected
    for size in range(len(frame)):
        with pytest.raises(WireError):
            count_values(frame[:size], DATA)
    with pytest.raises(WireError, match="1 bytes after"):
        count_values(frame + b"\x01", DATA)


def test_sender_and_receiver_keep_the_same_limits() -> None:
    tight = MsgpackCodec(Limits(frame=500, string=40, values=30, length=8))
    for record, problem in (
        (TimedOctetSeq(0, bytes(500)), "a frame of 5.. bytes; at most 500"),
        (TimedString(0, "a" * 41), "a length of 41; at most 40"),
        (TimedStringSeq(0, ["a"] * 9), "a length of 9; at most 8"),
        (ActArrayState(0, [Actuator()] * 3), "the frame claims .* values or more; at most 30"),
    ):
        with pytest.raises(LimitError, match=problem):
            tight.encode(record)
        with pytest.raises(WireError):
            tight.decode(CODEC.encode(record))
    for record in (TimedString(0, "a" * 40), TimedStringSeq(0, ["a"] * 8), TimedDouble(1, 2.0)):
        assert tight.decode(tight.encode(record)) == record


def test_lists_and_maps_lie_in_each_other_64_deep_and_no_deeper() -> None:
    for opened in (b"\x91", b"\x81\xa1a"):
        assert count_values(opened * 64 + b"\x01", DATA) > 64
        with pytest.raises(LimitError, match="deeper than 64"):
            count_values(opened * 65 + b"\x01", DATA)


def test_limits_are_those_promised() -> None:
    assert (DATA.frame, DATA.string, DATA.values) == (64 * MIB, MIB, 65_536)
    assert (CONTROL.frame, CONTROL.length) == (64 * 1024, 64)
    text = TimedString(0, "x" * MIB)
    assert CODEC.decode(CODEC.encode(text)) == text
    with pytest.raises(LimitError):
        CODEC.encode(TimedString(0, "x" * (MIB + 1)))
    with pytest.raises(LimitError):
        SMALL.encode(TimedOctetSeq(0, bytes(64 * 1024)))
    with pytest.raises(ValueError, match=r"Limits\.values: expected an integer"):
        Limits(values=0)


@pytest.mark.slow(kept_by="test_sender_and_receiver_keep_the_same_limits")
@given(
    st.recursive(
        st.none() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(max_size=300),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_scan_accepts_what_msgpack_writes_and_nothing_shorter(content: Any) -> None:
    packed = msgpack.packb(content)
    assert count_values(packed, DATA) >= 1
    for data in (packed[:-1], packed + b"\0"):
        with pytest.raises(WireError):
            count_values(data, DATA)


def _array(code: int, dimensions: int, shape: tuple[int, ...], size: int, spare: bytes = bytes(6)) -> bytes:
    head = struct.pack("<BB", code, dimensions) + spare + b"".join(struct.pack("<Q", n % 2**64) for n in shape)
    packed: bytes = msgpack.packb([1, "TimedNDArray", {"tm": 0, "data": head + bytes(size)}])
    return packed


@pytest.mark.fault("E14")
@pytest.mark.parametrize(
    ("code", "dimensions", "shape", "size"),
    [
        (12, 1, (3,), 16), (12, 1, (2,), 24), (12, 1, (-1,), 8), (12, 1, (2**40,), 8), (12, 2, (2**32, 2**32), 0), (12, 2, (2**63, 2), 0),
        (12, 2, (0, 2**63), 0), (12, 2, (2**61, 0), 0), (0, 1, (1,), 8), (15, 1, (1,), 8), (255, 1, (1,), 8), (ord("O"), 1, (1,), 8),
        (12, 9, (1,) * 9, 8), (12, 255, (), 8), (12, 2, (1,), 0), (12, 0, (), 0), (12, 0, (), 7), (14, 1, (1,), 8),
    ],
)  # fmt: skip
def test_array_head_that_lies_is_refused_before_anything_is_allocated(
    code: int, dimensions: int, shape: tuple[int, ...], size: int
) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(WireError, match=r"TimedNDArray\.data: expected"):
            CODEC.decode(_array(code, dimensions, shape, size))
        assert tracemalloc.get_traced_memory()[1] < MIB
    finally:
        tracemalloc.stop()


@pytest.mark.fault("E14")
def test_array_head_that_is_true_is_accepted() -> None:
    assert CODEC.decode(_array(12, 1, (2,), 16)).data.tolist() == [0.0, 0.0]
    assert CODEC.decode(_array(12, 3, (0, 5, 2), 0)).data.shape == (0, 5, 2)
    with pytest.raises(WireError):
        CODEC.decode(_array(12, 1, (2,), 16, spare=b"\0\0\0\0\0\1"))
    with pytest.raises(WireError, match="expected the head of an array"):
        CODEC.decode(msgpack.packb([1, "TimedNDArray", {"tm": 0, "data": b"\x0c"}]))


@pytest.mark.slow(kept_by="test_array_head_that_lies_is_refused_before_anything_is_allocated")
@pytest.mark.fault("E14")
@pytest.mark.campaign
def test_damaged_frame_gives_a_record_or_a_wire_error_and_nothing_else() -> None:
    rng = random.Random(14)
    originals = [
        CODEC.encode(TimedNDArray(1, np.arange(6.0).reshape(2, 3))),
        CODEC.encode(TimedNDArray(1, np.zeros((2, 1, 2), dtype="u2"))),
        CODEC.encode(ActArrayState(1, [Actuator(1.0), Actuator(2.0)])),
        CODEC.encode(TimedStringSeq(1, ["a", "é"])),
    ]
    kept = 0
    for _ in range(cases(1_000_000)):
        data = bytearray(rng.choice(originals))
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
        try:
            CODEC.decode(bytes(data))
            kept += 1
        except WireError:
            continue
    assert kept  # damage inside the elements cannot be seen, so the test does reach the far end of decode
