"""What a field refuses, what it converts, and that nobody can change a sample once it is built."""

from __future__ import annotations

import array as stdlib_array
import math
import struct
from dataclasses import FrozenInstanceError, dataclass, field
from decimal import Decimal
from enum import Enum
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from aiorts.errors import RecordError, RecordTypeError
from aiorts.types import (
    CameraImage,
    GripperState,
    GripperStatus,
    Point2D,
    Point3D,
    PointCloud,
    PointCloudPoint,
    Pose2D,
    RGBColour,
    TimedBoolean,
    TimedBooleanSeq,
    TimedChar,
    TimedCharSeq,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedFloatSeq,
    TimedLong,
    TimedLongLong,
    TimedLongSeq,
    TimedMap,
    TimedNDArray,
    TimedOctet,
    TimedOctetSeq,
    TimedPose2D,
    TimedShort,
    TimedString,
    TimedULongLong,
    TimedUShort,
    TimedWChar,
    check_shape,
    f32,
    is_mutable,
    snapshot,
    u8,
)
from campaign import cases

NAN = float("nan")


@pytest.mark.row(65)
@pytest.mark.fault("B02")
@pytest.mark.parametrize(
    ("cls", "value", "message"),
    [
        (TimedLong, 30000000000, "TimedLong.data: expected an integer -2147483648..2147483647, got 30000000000"),
        (TimedShort, -32769, "TimedShort.data: expected an integer -32768..32767, got -32769"),
        (TimedUShort, -1, "TimedUShort.data: expected an integer 0..65535, got -1"),
        (TimedOctet, 256, "TimedOctet.data: expected an integer 0..255, got 256"),
        (TimedLongLong, 2**63, f"TimedLongLong.data: expected an integer {-(2**63)}..{2**63 - 1}, got {2**63}"),
        (TimedULongLong, 2**64, f"TimedULongLong.data: expected an integer 0..{2**64 - 1}, got {2**64}"),
        (TimedLong, 1.0, "TimedLong.data: expected an integer -2147483648..2147483647, got 1.0"),
        (TimedLong, NAN, "TimedLong.data: expected an integer -2147483648..2147483647, got nan"),
        (TimedLong, np.array(1), "TimedLong.data: expected an integer"),
        (TimedLong, True, "TimedLong.data: expected an integer -2147483648..2147483647, got True (bool)"),
        (TimedLong, np.True_, "TimedLong.data: expected an integer"),
        (TimedLong, "1", "TimedLong.data: expected an integer -2147483648..2147483647, got '1'"),
        (TimedDouble, "1", "TimedDouble.data: expected a number, got '1'"),
        (TimedDouble, None, "TimedDouble.data: expected a number, got None"),
        (TimedDouble, 1j, "TimedDouble.data: expected a number, got 1j (complex)"),
        (TimedDouble, np.zeros(1), "TimedDouble.data: expected a number, got an array of float64 with shape (1,)"),
        (TimedDouble, Decimal(1), "TimedDouble.data: expected a number, got 1 (Decimal)"),
        (TimedDouble, 2**53 + 1, "TimedDouble.data: expected a number that a float holds exactly"),
        (TimedDouble, 10**400, "TimedDouble.data: expected a number that a float holds exactly"),
        (
            TimedFloat,
            1e300,
            "TimedFloat.data: expected a number that fits a 32-bit float (up to 3.4028235e38), got 1e+300",
        ),
        (TimedBoolean, 1, "TimedBoolean.data: expected True or False, got 1"),
        (TimedString, b"a", "TimedString.data: expected text, got b'a'"),
        (TimedString, "a\ud800", "TimedString.data[1]: expected text without lone surrogates, got '\\ud800'"),
        (TimedChar, "ab", "TimedChar.data: expected one 8-bit character, got 'ab'"),
        (TimedChar, "", "TimedChar.data: expected one 8-bit character, got ''"),
        (TimedChar, "€", "TimedChar.data: expected one 8-bit character, got '€'"),
        (TimedWChar, "ab", "TimedWChar.data: expected one character, got 'ab'"),
        (GripperState, 9, "GripperState.status: expected GRIPPER_STATE_OPEN | GRIPPER_STATE_CLOSED"),
        (GripperState, True, "GripperState.status: expected GRIPPER_STATE_OPEN"),
        (TimedPose2D, Point2D(), "TimedPose2D.data: expected a Pose2D, got an instance of Point2D"),
        (TimedPose2D, (1, 2, 3), "TimedPose2D.data: expected a Pose2D, got a tuple of 3"),
        (TimedMap, [1], "TimedMap.data: expected a mapping of text to scalars or arrays, got a list of 1"),
        (TimedMap, {1: 2}, "TimedMap.data key: expected text, got 1"),
        (TimedMap, {"a": None}, "TimedMap.data['a']"),
    ],
)
def test_scalar_that_does_not_fit_is_refused_naming_field_expected_and_got(cls: Any, value: Any, message: str) -> None:
    with pytest.raises(RecordError) as caught:
        cls(0, value)
    assert str(caught.value).startswith(message)
    assert isinstance(caught.value, ValueError)
    if isinstance(value, str | bytes) and cls in (TimedLong, TimedDouble):
        assert isinstance(caught.value, TypeError)


def test_numbers_of_other_libraries_are_taken_when_nothing_changes() -> None:
    assert TimedLong(0, np.int64(7)).data == 7
    assert type(TimedLong(0, np.int64(7)).data) is int
    assert TimedDouble(0, 3).data == 3.0
    assert type(TimedDouble(0, np.float32(0.1)).data) is float
    assert TimedDouble(0, np.float32(0.1)).data == float(np.float32(0.1))
    assert TimedDouble(0, 2**53).data == 2.0**53
    assert TimedBoolean(0, np.True_).data is True
    assert GripperState(0, 2).status is GripperStatus.GRIPPER_STATE_MOVING  # type: ignore[arg-type]
    assert TimedChar(0, "é").data == "é"


@pytest.mark.slow(kept_by="test_negative_zero_and_infinities_are_kept")
@pytest.mark.fault("B04")
@given(st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True))
def test_float_fields_keep_every_value_bit_for_bit(value: float) -> None:
    assert struct.pack("<d", TimedDouble(0, value).data) == struct.pack("<d", value)
    assert TimedDoubleSeq(0, [value]).data.tobytes() == struct.pack("<d", value)


@pytest.mark.slow(kept_by="test_numbers_of_other_libraries_are_taken_when_nothing_changes")
@given(st.floats(width=32, allow_nan=False))
def test_float32_field_holds_the_nearest_float32(value: float) -> None:
    assert TimedFloat(0, value).data == value
    assert TimedFloat(0, 0.1).data == float(np.float32(0.1))


@pytest.mark.fault("B03")
@pytest.mark.parametrize(
    ("cls", "value", "message"),
    [
        (
            TimedDoubleSeq,
            np.zeros((2, 2)),
            r"TimedDoubleSeq\.data: expected a sequence of f64, shape \(n,\), got shape \(2, 2\)",
        ),
        (TimedDoubleSeq, np.array(1.0), r"TimedDoubleSeq\.data: .*got shape \(\)"),
        (TimedDoubleSeq, [[1.0], [1.0, 2.0]], r"TimedDoubleSeq\.data\[0\]: expected a number, got a list of 1"),
        (TimedDoubleSeq, 1.0, r"TimedDoubleSeq\.data: expected a sequence of f64, got 1\.0"),
        (TimedDoubleSeq, ["1"], r"TimedDoubleSeq\.data\[0\]: expected a number, got '1'"),
        (TimedDoubleSeq, [1.0, None], r"TimedDoubleSeq\.data\[1\]: expected a number, got None"),
        (TimedDoubleSeq, {1.0}, r"TimedDoubleSeq\.data: expected a sequence of f64, got a set of 1"),
        (TimedDoubleSeq, np.array([1j]), r"TimedDoubleSeq\.data: expected elements of f64, got an array of complex128"),
        (TimedDoubleSeq, np.array(["1"]), r"TimedDoubleSeq\.data: expected elements of f64"),
        (
            TimedDoubleSeq,
            np.array([1.0], dtype=object),
            r"TimedDoubleSeq\.data: expected elements of f64, got an array of object",
        ),
        (TimedDoubleSeq, np.array([1, 2**53 + 1]), r"TimedDoubleSeq\.data\[1\]: expected .*got 9007199254740993"),
        (TimedLongSeq, np.array([1.0]), r"TimedLongSeq\.data: expected elements of i32, got an array of float64"),
        (
            TimedLongSeq,
            np.array([1, 2**40]),
            r"TimedLongSeq\.data\[1\]: expected an integer -2147483648\.\.2147483647, got 1099511627776",
        ),
        (TimedLongSeq, [1, 2**70], r"TimedLongSeq\.data\[1\]: expected an integer"),
        (TimedLongSeq, [1, True], r"TimedLongSeq\.data\[1\]: expected an integer"),
        (TimedLongSeq, np.array([True]), r"TimedLongSeq\.data: expected elements of i32, got an array of bool"),
        (TimedFloatSeq, np.array([1.0, 1e300]), r"TimedFloatSeq\.data\[1\]: expected .*got 1e\+300"),
        (TimedBooleanSeq, np.array([1]), r"TimedBooleanSeq\.data: expected elements of bool"),
        (TimedBooleanSeq, [True, 1], r"TimedBooleanSeq\.data\[1\]: expected True or False"),
        (TimedOctetSeq, np.array([-1]), r"TimedOctetSeq\.data\[0\]: expected an integer 0\.\.255, got -1"),
        (
            TimedDoubleSeq,
            np.ma.masked_array([1.0, 2.0], [True, False]),
            r"TimedDoubleSeq\.data: expected an array without masked",
        ),
        (
            PointCloud,
            np.zeros((2, 3)),
            r"PointCloud\.points: expected shape \(n, 6\), columns point\.x.*; got \(2, 3\)",
        ),
        (
            PointCloud,
            [PointCloudPoint(), Point3D()],
            r"PointCloud\.points\[1\]: expected a PointCloudPoint, got an instance of Point3D",
        ),
        (TimedNDArray, [[1], [1, 2]], r"TimedNDArray\.data: expected rows of equal length"),
        (TimedNDArray, np.zeros((1,) * 9), r"TimedNDArray\.data: expected at most 8 dimensions, got 9"),
        (TimedNDArray, np.array([None]), r"TimedNDArray\.data: expected an array of .*got dtype object"),
        (TimedNDArray, [1, "a"], r"TimedNDArray\.data: expected elements of one type"),
        (TimedNDArray, np.zeros(1, dtype=[("a", "f8")]), r"TimedNDArray\.data: expected an array of"),
        (TimedNDArray, np.array(["2020"], dtype="M8[s]"), r"TimedNDArray\.data: expected an array of"),
    ],
)
def test_array_of_wrong_shape_dtype_or_content_is_refused(cls: Any, value: Any, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        cls(0, value)


NUMBERS = {
    "b1": TimedBooleanSeq,
    "i2": TimedShort,
    "f8": TimedDoubleSeq,
    "f4": TimedFloatSeq,
    "i4": TimedLongSeq,
    "u1": TimedOctetSeq,
}


@pytest.mark.slow(kept_by="test_array_of_wrong_shape_dtype_or_content_is_refused")
@pytest.mark.fault("B03")
@settings(max_examples=cases(1_000) * 5)
@given(st.data(), st.sampled_from(["b1", "f8", "f4", "i4", "u1"]), st.sampled_from("<>"), st.integers(1, 3))
def test_any_layout_of_an_array_arrives_with_the_same_values(
    data: st.DataObject, code: str, order: str, step: int
) -> None:
    source = data.draw(hnp.arrays(np.dtype(order + code), st.integers(0, 30)))[::-step]
    kept = NUMBERS[code](0, source).data  # type: ignore[operator]
    assert kept.dtype == np.dtype(code)
    assert kept.dtype.isnative
    assert kept.flags.c_contiguous
    assert not kept.flags.writeable
    assert kept.astype(source.dtype).tobytes() == source.tobytes()


@pytest.mark.fault("B03")
def test_empty_sequence_is_a_value_and_shapes_are_checked_on_demand() -> None:
    for empty in ([], (), np.array([]), b"", bytearray()):
        assert len(TimedOctetSeq(0, np.array([], dtype="u1") if isinstance(empty, np.ndarray) else empty).data) == 0
    assert TimedDoubleSeq(0, np.array([])).data.shape == (0,)
    check_shape(TimedDoubleSeq(0, [1, 2, 3]), (3,))
    check_shape(TimedDoubleSeq(0, [1, 2, 3]), (-1,))
    check_shape(PointCloud(0, np.zeros((5, 6))), (5,))
    check_shape(TimedNDArray(0, np.zeros((2, 3))), (2, -1))
    with pytest.raises(RecordError, match=r"TimedDoubleSeq\.data: expected shape \(4,\), got \(3,\)"):
        check_shape(TimedDoubleSeq(0, [1, 2, 3]), (4,))
    with pytest.raises(RecordError, match=r"TimedNDArray\.data: expected shape \(any, 2\), got \(2, 3\)"):
        check_shape(TimedNDArray(0, np.zeros((2, 3))), (-1, 2))
    with pytest.raises(RecordTypeError, match="found none"):
        check_shape(TimedDouble(0, 1.0), (1,))


@pytest.mark.fault("A20")
def test_array_that_owns_its_memory_is_taken_over_and_frozen() -> None:
    own = np.arange(5.0)
    sample = TimedDoubleSeq(0, own)
    assert sample.data is own
    with pytest.raises(ValueError, match="read-only"):
        own[0] = 9.0


@pytest.mark.fault("A20")
@pytest.mark.parametrize(
    "view",
    [
        lambda buffer: buffer[:],
        lambda buffer: buffer[::2],
        lambda buffer: buffer.reshape(2, 4)[0],
        lambda buffer: memoryview(buffer),
        lambda buffer: memoryview(buffer.tobytes()).cast("d"),
        lambda buffer: stdlib_array.array("d", buffer),
        lambda buffer: buffer.tolist(),
        lambda buffer: buffer.view(np.ma.MaskedArray),
        lambda buffer: np.frombuffer(bytearray(buffer.tobytes())),
    ],
)
def test_view_of_a_reused_buffer_is_copied_once_and_later_writes_are_not_seen(view: Any) -> None:
    buffer = np.arange(8.0)
    given_value = view(buffer)
    sample = TimedDoubleSeq(0, given_value)
    before = sample.data.copy()
    buffer[:] = -1.0
    if isinstance(given_value, stdlib_array.array | list):
        given_value[0] = -1.0
    assert np.array_equal(sample.data, before)
    assert not np.shares_memory(sample.data, buffer)
    assert not sample.data.flags.writeable


def test_view_of_immutable_bytes_counts_as_owned() -> None:
    octets = bytes(range(16))
    sample = TimedOctetSeq(0, octets)
    assert sample.data.base is octets
    floats = np.frombuffer(octets, dtype="<f8")
    assert TimedDoubleSeq(0, floats).data is floats
    assert CameraImage(pixels=octets).pixels.tobytes() == octets


def test_point_cloud_is_one_array_with_record_views() -> None:
    array = np.arange(12.0).reshape(2, 6)
    owned = array.copy()
    cloud = PointCloud(0, owned)
    assert cloud.points.array is owned
    second = PointCloudPoint(Point3D(6.0, 7.0, 8.0), RGBColour(9.0, 10.0, 11.0))
    assert cloud.points[1] == cloud.points[-1] == second
    assert list(cloud.points)[1] == second
    assert cloud == PointCloud(0, list(cloud.points)) == PointCloud(0, cloud.points)
    assert cloud.points[1:] == (second,)
    assert cloud.points.columns == ("point.x", "point.y", "point.z", "colour.r", "colour.g", "colour.b")
    assert not cloud.points.array.flags.writeable
    with pytest.raises(IndexError):
        cloud.points[2]
    with pytest.raises(AttributeError):
        cloud.points.array = array


def test_map_is_copied_and_read_only() -> None:
    source: dict[str, Any] = {"speed": 1.5, "count": 2**64 - 1, "on": True, "name": "x", "raw": b"\0", "list": [1, 2.5]}
    sample = TimedMap(0, source)
    source["speed"] = 9.0
    assert sample.data["speed"] == 1.5
    assert sample.data["list"].tolist() == [1.0, 2.5]
    with pytest.raises(TypeError):
        sample.data["speed"] = 2.0  # type: ignore[index]
    with pytest.raises(RecordError, match=r"TimedMap\.data\['n'\]"):
        TimedMap(0, {"n": 2**64})


def test_char_sequence_takes_text() -> None:
    assert TimedCharSeq(0, "abc").data == ("a", "b", "c")
    with pytest.raises(RecordError, match=r"TimedCharSeq\.data\[1\]: expected one 8-bit character, got '€'"):
        TimedCharSeq(0, "a€")


@dataclass
class Scan:
    """A user's mutable dataclass."""

    tm: int
    ranges: list[float] = field(default_factory=list)
    pose: Pose2D = field(default_factory=Pose2D)
    names: list[str] = field(default_factory=list)
    grid: np.ndarray[Any, Any] = field(default_factory=lambda: np.zeros((2, 2)))
    extra: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FrozenScan:
    tm: int
    ranges: tuple[float, ...] = ()


@dataclass(frozen=True)
class LooselyFrozen:
    grid: np.ndarray[Any, Any]


class Hue(Enum):
    RED = 1


@dataclass(frozen=True)
class Exact:
    flag: bool = False
    octets: bytes = b""
    hue: Hue = Hue.RED
    pose: Pose2D = field(default_factory=Pose2D)
    pair: tuple[int, str] = (0, "")
    text: str = ""
    single: f32 = 0.0


@dataclass(frozen=True, slots=True)
class Ranged:
    octet: u8 = 0
    single: f32 = 0.0
    whole: int = 0


@dataclass(frozen=True)
class Loose:
    values: list[float]


@dataclass(frozen=True)
class Outer:
    inner: Loose
    more: tuple[Loose, ...] = ()


@pytest.mark.fault("A20")
def test_snapshot_of_a_mutable_dataclass_is_deep_immutable_and_shared() -> None:
    scan = Scan(5, [1.0, 2.0], Pose2D(), ["a"], np.ones((2, 2)), {"k": 1.0})
    kept = snapshot(scan)
    scan.tm, scan.ranges[0] = 6, -1.0
    scan.names.append("b")
    scan.extra["k"] = 2.0
    assert isinstance(kept, Scan)
    assert (kept.tm, kept.ranges, kept.names, dict(kept.extra)) == (5, (1.0, 2.0), ("a",), {"k": 1.0})
    assert not kept.grid.flags.writeable
    with pytest.raises(FrozenInstanceError, match=r"Scan\.tm"):
        kept.tm = 7
    assert snapshot(kept) is kept
    assert kept == Scan(5, [1.0, 2.0], Pose2D(), ["a"], np.ones((2, 2)), {"k": 1.0})
    assert kept != scan
    assert repr(kept).startswith("Scan(tm=5, ranges=(1.0, 2.0)")


@pytest.mark.fault("A20")
def test_only_what_can_change_gets_a_snapshot() -> None:
    assert [is_mutable(cls) for cls in (Scan, FrozenScan, LooselyFrozen, TimedDouble, PointCloud, float)] == [
        True, False, True, False, False, False,
    ]  # fmt: skip
    for sample in (FrozenScan(1, (1.0,)), Exact(True, b"x", Hue.RED, Pose2D(), (1, "a"), "é", 0.5), 5, "x"):
        assert snapshot(sample) is sample
    kept = snapshot(Exact(single=0.1))
    assert type(kept) is Exact
    assert kept == Exact(single=float(np.float32(0.1)))
    buffer = np.zeros(4)
    kept = snapshot(LooselyFrozen(buffer[:]))
    buffer[:] = 1.0
    assert not kept.grid.any()


@pytest.mark.fault("A20")
def test_what_a_frozen_dataclass_holds_is_copied_where_it_can_change() -> None:
    ranges, inner = [1.0], Loose([1.0])
    kept, outer = snapshot(FrozenScan(1, ranges)), snapshot(Outer(inner, (inner,)))  # type: ignore[arg-type]
    ranges.append(2.0)
    inner.values.append(2.0)
    assert (kept, type(kept)) == (FrozenScan(1, (1.0,)), FrozenScan)
    assert outer == Outer(Loose((1.0,)), (Loose((1.0,)),))  # type: ignore[arg-type]
    assert snapshot(kept) is kept
    assert snapshot(outer) is outer


@pytest.mark.fault("B02", "B05")
@pytest.mark.parametrize(
    ("sample", "said"),
    [
        (FrozenScan(-1), r"FrozenScan\.tm: expected nanoseconds"),
        (FrozenScan(0, (1.0, "x")), r"FrozenScan\.ranges\[1\]: expected a number, got 'x'"),  # type: ignore[arg-type]
        (FrozenScan(0, 5), r"FrozenScan\.ranges: expected a sequence"),  # type: ignore[arg-type]
        (Ranged(300), r"Ranged\.octet: expected an integer 0\.\.255, got 300"),
        (Ranged(0, 1e300), r"Ranged\.single: expected a number that fits a 32-bit float"),
        (Ranged(0, 0.0, True), r"Ranged\.whole: expected an integer"),
        (Ranged(0, 0.0, 2**63), r"Ranged\.whole: expected an integer"),
        (Exact("yes"), r"Exact\.flag: expected True or False"),  # type: ignore[arg-type]
        (Exact(text="\ud800"), r"Exact\.text\[0\]: expected text without lone surrogates"),
        (Outer(Loose(["x"])), r"Loose\.values\[0\]: expected a number"),  # type: ignore[list-item]
        (2**63, "int: expected an integer"),
        ("\ud800", r"str\[0\]: expected text without lone surrogates"),
    ],
    ids=str,
)
def test_what_a_frozen_dataclass_did_not_check_is_refused(sample: Any, said: str) -> None:
    with pytest.raises(RecordError, match=said):
        snapshot(sample)


@pytest.mark.fault("B02")
def test_snapshot_checks_what_the_dataclass_did_not() -> None:
    with pytest.raises(RecordError, match=r"Scan\.ranges\[1\]: expected a number, got 'x'"):
        snapshot(Scan(0, [1.0, "x"]))  # type: ignore[list-item]
    with pytest.raises(RecordError, match=r"Scan\.tm: expected nanoseconds"):
        snapshot(Scan(-1))


def test_negative_zero_and_infinities_are_kept() -> None:
    assert math.copysign(1.0, TimedDouble(0, -0.0).data) == -1.0
    assert TimedFloat(0, math.inf).data == math.inf
