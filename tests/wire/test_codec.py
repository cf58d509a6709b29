"""Every record goes to bytes and comes back bit for bit; arrays are not copied again on the way in."""

from __future__ import annotations

import math
import struct
import timeit
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import aiorts.types.ros  # noqa: F401 - records like others
from aiorts.errors import RecordError, WireError
from aiorts.types import (
    PointCloud,
    RecordArray,
    Time,
    TimedBooleanSeq,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedFloatSeq,
    TimedLong,
    TimedLongLongSeq,
    TimedMap,
    TimedNDArray,
    TimedOctetSeq,
    all_types,
    fields_of,
    record,
    to_plain,
)
from aiorts.types.kinds import SCALARS as KINDS
from aiorts.types.kinds import EnumKind
from aiorts.wire import MsgpackCodec
from campaign import cases
from each import each

CODEC = MsgpackCodec()
BUILT_IN = {
    name.removeprefix("aiorts.types."): cls
    for name, cls in all_types().items()
    if cls.__module__.startswith("aiorts.types.") and hasattr(cls, "__dataclass_fields__")
}
ELEMENTS = ["b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8", "c8", "c16"]

SCALARS: dict[str, st.SearchStrategy[Any]] = {
    "f64": st.floats(),
    "f32": st.floats(width=32),
    "bool": st.booleans(),
    "str": st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
    "char": st.characters(max_codepoint=255),
    "wchar": st.characters(exclude_categories=["Cs"]),
    "stamp": st.integers(0, 2**32 * 10**9 - 1),
    **{f"i{bits}": st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"u{bits}": st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 64)},
}
ENTRIES = st.one_of(
    SCALARS["bool"], SCALARS["i64"], SCALARS["f64"], SCALARS["str"], st.binary(max_size=5),
    hnp.arrays(np.dtype("f4"), hnp.array_shapes(max_dims=3, min_side=0, max_side=3)),
)  # fmt: skip


TIMES = st.builds(Time, SCALARS["u32"], st.integers(0, 10**9 - 1))


def values_of(kind: Any) -> st.SearchStrategy[Any]:
    """Values of one field, whatever its kind."""
    spelling = kind.spelling
    if spelling in SCALARS:
        return SCALARS[spelling]
    if isinstance(kind, EnumKind):
        return st.sampled_from(list(kind.enumeration))
    if spelling == "map":
        return st.dictionaries(SCALARS["str"], ENTRIES, max_size=3)
    if spelling == "ndarray":
        shapes = hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=3)
        return st.sampled_from(ELEMENTS).flatmap(lambda code: hnp.arrays(np.dtype(code), shapes))
    if spelling.startswith("seq[") and kind.element and hasattr(kind, "columns"):
        return hnp.arrays(np.dtype("f8"), st.tuples(st.integers(0, 3), st.just(len(kind.columns))))
    if spelling.startswith("seq["):
        item = kind.item if hasattr(kind, "item") else KINDS[kind.element]
        return st.lists(values_of(item), max_size=3)
    return records_of(kind.cls)


def records_of(cls: type) -> st.SearchStrategy[Any]:
    if cls is Time:
        return TIMES
    values = [values_of(field.kind) for field in fields_of(cls)]
    if cls.__module__.startswith("aiorts.types.ros"):  # covariances have a fixed length
        for number, field in enumerate(fields_of(cls)):
            if field.name.endswith("covariance"):
                length = len(getattr(cls(), field.name))
                values[number] = st.lists(SCALARS["f64"], min_size=length, max_size=length)
    return st.builds(lambda *values: cls(*values), *values)


def bits(value: Any) -> Any:
    """A value as something that compares by its bits."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, RecordArray):
        value = value.array
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if hasattr(value, "keys"):
        return {key: bits(entry) for key, entry in value.items()}
    if hasattr(value, "__dataclass_fields__"):
        return type(value), tuple(bits(getattr(value, field.name)) for field in fields_of(type(value)))
    return type(value), value


@pytest.mark.slow(kept_by="test_record_of_zeros_comes_back")
@pytest.mark.fault("B04")
@pytest.mark.campaign
@settings(max_examples=cases(25_000))
@given(st.sampled_from(sorted(BUILT_IN)).flatmap(lambda name: records_of(BUILT_IN[name])))
def test_every_record_comes_back_bit_for_bit(record: Any) -> None:
    assert bits(CODEC.decode(CODEC.encode(record))) == bits(record)


@each(sorted(BUILT_IN))
def test_record_of_zeros_comes_back(name: str) -> None:
    zero = BUILT_IN[name]()
    back = CODEC.decode(CODEC.encode(zero), BUILT_IN[name])
    assert back == zero
    assert to_plain(back) == to_plain(zero)


@pytest.mark.parametrize("value", [True, False, 0, -(2**63), 2**63 - 1, 1.5, math.inf, "", "é", b"", b"\0\xff"])
def test_plain_value_comes_back(value: Any) -> None:
    assert bits(CODEC.decode(CODEC.encode(value), type(value))) == bits(value)


@pytest.mark.fault("B04")
@pytest.mark.parametrize("pattern", [0x7FF8000000000001, 0xFFF8DEADBEEF0000, 0x7FF0000000000001, 0x8000000000000000, 1])
def test_nan_payloads_and_special_floats_keep_their_bits(pattern: int) -> None:
    raw = struct.pack("<Q", pattern)
    (value,) = struct.unpack("<d", raw)
    assert struct.pack("<d", CODEC.decode(CODEC.encode(TimedDouble(0, value))).data) == raw
    doubles = np.frombuffer(raw, dtype="<f8")
    assert CODEC.decode(CODEC.encode(TimedDoubleSeq(0, doubles))).data.tobytes() == raw
    singles = np.frombuffer(raw, dtype="<f4")
    assert CODEC.decode(CODEC.encode(TimedFloatSeq(0, singles))).data.tobytes() == raw
    assert math.isnan(CODEC.decode(CODEC.encode(TimedFloat(0, math.nan))).data)


@pytest.mark.slow(kept_by="test_record_of_zeros_comes_back")
@pytest.mark.row(63)
@given(st.sampled_from(ELEMENTS), st.sampled_from("<>"), st.data())
def test_nd_array_of_any_type_order_and_stride_comes_back(code: str, order: str, data: st.DataObject) -> None:
    shape = data.draw(hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
    source = data.draw(hnp.arrays(np.dtype(order + code), shape))
    strided = source.T[::-1] if source.ndim else source
    back = CODEC.decode(CODEC.encode(TimedNDArray(1, strided)))
    assert back.data.shape == strided.shape
    assert back.data.dtype == np.dtype(code)
    assert back.data.tobytes() == strided.astype(code).tobytes()


@pytest.mark.row(63)
def test_64_bit_integers_and_maps_come_back() -> None:
    limits = np.array([-(2**63), 2**63 - 1])
    assert CODEC.decode(CODEC.encode(TimedLongLongSeq(0, limits))).data.tolist() == [-(2**63), 2**63 - 1]
    entries = {"a": 1, "b": 1.0, "c": "x", "d": b"y", "e": np.zeros((2, 2), dtype="u1"), "f": True, "g": 2**64 - 1}
    back = CODEC.decode(CODEC.encode(TimedMap(3, entries)))
    assert back == TimedMap(3, entries)
    assert [type(value) for value in back.data.values()] == [type(value) for value in entries.values()]


def test_decoded_array_lies_in_the_bytes_that_the_parser_gave() -> None:
    back = CODEC.decode(CODEC.encode(TimedDoubleSeq(0, np.arange(10.0))))
    base = back.data
    while isinstance(base, np.ndarray):
        base = base.base
    assert type(base) is bytes
    assert np.shares_memory(back.data, np.frombuffer(base, dtype="u1"))
    assert back.data.flags.aligned
    assert not back.data.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        back.data.setflags(write=True)


def test_point_cloud_of_100_000_points_round_trips_in_50_ms() -> None:
    cloud = PointCloud(1, np.random.default_rng(1).random((100_000, 6)))
    assert CODEC.decode(CODEC.encode(cloud)) == cloud
    assert min(timeit.repeat(lambda: CODEC.decode(CODEC.encode(cloud)), number=1, repeat=10)) < 0.050


def frame(*content: Any) -> bytes:
    packed: bytes = msgpack.packb(content)
    return packed


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no msgpack frame"),
        (b"\xc1", "no msgpack frame"),
        (frame(1, "TimedDouble"), "expected a list of version, type name and fields"),
        (frame(2, "TimedDouble", {}), "a frame of version 2; this side reads version 1"),
        (frame(1, "Nothing", {}), "unknown type 'Nothing'"),
        (frame(1, "os.path", {}), "unknown type 'os.path'"),
        (frame(1, "GripperStatus", 1), "unknown type 'GripperStatus'"),
        (frame(1, "TimedDouble", {"tm": 1}), "TimedDouble: missing data; expected the fields tm, data"),
        (frame(1, "TimedDouble", {"tm": 1, "date": 1.0}), "TimedDouble: missing data; unknown 'date'"),
        (
            frame(1, "TimedDouble", {"tm": 1, "data": 1.0, "x": 0}),
            "TimedDouble: unknown 'x'; expected the fields tm, data",
        ),
        (frame(1, "TimedDouble", [1, 1.0]), "TimedDouble: expected a map with tm, data, got a list of 2"),
        (frame(1, "TimedDouble", {"tm": 1, "data": "x"}), "TimedDouble.data: expected a number, got 'x'"),
        (frame(1, "TimedDouble", {"tm": -1, "data": 1.0}), "TimedDouble.tm: expected nanoseconds"),
        (
            frame(1, "TimedLong", {"tm": 1, "data": 2**40}),
            "TimedLong.data: expected an integer -2147483648..2147483647",
        ),
        (
            frame(1, "TimedDoubleSeq", {"tm": 1, "data": [1.0]}),
            "TimedDoubleSeq.data: expected an array as binary, got a list of 1",
        ),
        (frame(1, "TimedPose2D", {"tm": 1, "data": {"heading": 1.0}}), "TimedPose2D.data: missing position"),
        (frame(1, "TimedStringSeq", {"tm": 1, "data": "ab"}), "TimedStringSeq.data: expected a list, got 'ab'"),
        (frame(1, "GripperState", {"tm": 1, "status": 9}), "GripperState.status: expected GRIPPER_STATE_OPEN"),
        (
            frame(1, "TimedMap", {"tm": 1, "data": {"a": None}}),
            "TimedMap.data['a']: expected a scalar or an array, got None",
        ),
        (frame(1, "int", 2**63), "int: expected an integer"),
        (b"\x93\x01\xabTimedDouble\x83\xa2tm\x01\xa4data\x01\xa4data\x02", "a map has the same key twice"),
    ],
)
def test_wrong_frame_is_refused_naming_what_is_wrong(data: bytes, message: str) -> None:
    with pytest.raises(WireError) as caught:
        CODEC.decode(data)
    assert message in str(caught.value)


def test_the_first_frame_of_a_type_is_written_as_all_that_follow() -> None:
    @record
    class FirstOfAll:
        tm: int = 0
        data: float = 0.0

    first, second = (CODEC.encode(FirstOfAll(1, 2.0)) for _ in range(2))
    assert first == second == CODEC.encoder(FirstOfAll)(FirstOfAll(1, 2.0))


def test_expected_type_is_checked() -> None:
    data = CODEC.encode(TimedDouble(1, 2.0))
    assert CODEC.decode(data, TimedDouble) == TimedDouble(1, 2.0)
    with pytest.raises(WireError, match="expected a TimedLong, got a TimedDouble"):
        CODEC.decode(data, TimedLong)
    assert CODEC.decode(memoryview(data)) == TimedDouble(1, 2.0)  # type: ignore[arg-type]


def test_what_cannot_travel_is_refused_at_encode() -> None:
    with pytest.raises(TypeError, match="cannot be the type of a port"):
        CODEC.encode([1.0])
    with pytest.raises(RecordError, match="int: expected an integer"):
        CODEC.encode(2**64)


def test_array_of_another_element_type_is_the_senders_mistake() -> None:
    other = CODEC.encode(TimedFloatSeq(0, [1.0])).replace(b"TimedFloatSeq", b"TimedOctetSeq")
    with pytest.raises(WireError, match=r"TimedOctetSeq\.data: expected seq\[u8\], got float32 of shape \(1,\)"):
        CODEC.decode(other)
    truth = CODEC.encode(TimedBooleanSeq(0, [True]))
    with pytest.raises(WireError, match=r"TimedBooleanSeq\.data: expected truth values"):
        CODEC.decode(truth[:-1] + b"\x02")
    assert CODEC.decode(CODEC.encode(TimedOctetSeq(0, b"ab"))).data.tobytes() == b"ab"
