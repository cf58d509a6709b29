"""Generic tools read any record by a field path, and carry it as plain data, without running code."""

from __future__ import annotations

# ruff: noqa: E501 - tables read better with one case on a line
import json
import math
from typing import Any

import numpy as np
import pytest

from aiorts.errors import InvalidNameError, RecordError
from aiorts.types import (
    ActArrayState,
    Actuator,
    CameraImage,
    Geometry2D,
    Point2D,
    PointCloud,
    Pose2D,
    RangeData,
    Size2D,
    TimedChar,
    TimedDouble,
    TimedDoubleSeq,
    TimedMap,
    TimedNDArray,
    TimedStringSeq,
    all_types,
    find_type,
    from_plain,
    path_type,
    read_path,
    to_plain,
)
from each import each

GEOMETRY = Geometry2D(Pose2D(Point2D(1.0, 2.0), 3.0), Size2D(4.0, 5.0))
CLOUD = PointCloud(7_000_000_001, np.arange(12.0).reshape(2, 6))


@pytest.mark.row(66)
@pytest.mark.parametrize(
    ("record", "path", "value", "kind"),
    [
        (GEOMETRY, "pose.position.x", 1.0, "f64"),
        (GEOMETRY, "pose", GEOMETRY.pose, Pose2D),
        (GEOMETRY, "", GEOMETRY, Geometry2D),
        (RangeData(0, [1.0, 2.0]), "ranges[1]", 2.0, "f64"),
        (RangeData(0, [1.0, 2.0]), "ranges[-1]", 2.0, "f64"),
        (ActArrayState(0, [Actuator(9.0)]), "actuators[0].position", 9.0, "f64"),
        (CLOUD, "points[1].colour.b", 11.0, "f64"),
        (CLOUD, "tm", 7_000_000_001, "stamp"),
        (CLOUD, "sec", 7, "u32"),
        (CLOUD, "nsec", 1, "u32"),
        (TimedStringSeq(0, ["a"]), "data[0]", "a", "str"),
        (TimedMap(0, {"a b": [1, 2]}), "data['a b'][1]", 2, "map"),
        (TimedNDArray(0, [[1, 2], [3, 4]]), "data[1][0]", 3, "ndarray"),
    ],
)
def test_field_path_reads_any_record(record: Any, path: str, value: Any, kind: Any) -> None:
    got = read_path(record, path)
    assert got == value
    assert type(got) is type(value)
    found = path_type(type(record), path)
    assert found is kind if isinstance(kind, type) else found.spelling == kind  # type: ignore[union-attr]


@pytest.mark.row(66)
@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("pose.positon.x", r"Geometry2D\.pose has no field 'positon'; did you mean position\?"),
        ("pose.position.x.y", r"Geometry2D\.pose\.position\.x is a value of type float and has no field 'y'"),
        ("pose[0]", r"Geometry2D\.pose is a value of type Pose2D and has no items"),
        ("__class__", r"Geometry2D has no field '__class__'"),
        ("pose.__init__", r"Geometry2D\.pose has no field '__init__'"),
        ("tm", r"Geometry2D has no field 'tm'; its fields are pose, size"),
    ],
)
def test_path_that_leads_nowhere_says_how_far_it_leads(path: str, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        read_path(GEOMETRY, path)
    if "[" not in path and ".y" not in path:
        with pytest.raises(RecordError):
            path_type(Geometry2D, path)


@pytest.mark.parametrize(
    "path", [".pose", "pose.", "pose..x", "pose x", "pose[x]", "pose['x", "a[1", "0", "pose.position()", "a['b]"]
)
def test_malformed_path_names_the_character(path: str) -> None:
    with pytest.raises(InvalidNameError, match=r"character \d+"):
        read_path(GEOMETRY, path)


def test_index_beyond_the_sequence_is_an_error() -> None:
    with pytest.raises(RecordError, match=r"RangeData\.ranges\[5\]: expected an index below 2, got 5"):
        read_path(RangeData(0, [1.0, 2.0]), "ranges[5]")


@each(name for name, cls in all_types().items() if name.startswith("aiorts.") and hasattr(cls, "__match_args__"))
def test_plain_data_of_every_record_survives_json(name: str) -> None:
    cls = find_type(name)
    plain = json.loads(json.dumps(to_plain(cls()), allow_nan=False))
    assert from_plain(cls, plain) == cls()


@pytest.mark.parametrize(
    "record",
    [
        TimedDouble(2**61, math.nan), TimedDouble(0, -math.inf), TimedDouble(0, -0.0), CLOUD, GEOMETRY, TimedChar(0, "\xff"),
        TimedDoubleSeq(0, [math.nan, math.inf, -0.0, 1.0]), CameraImage(pixels=b"\0\xff"), ActArrayState(0, [Actuator(1.0, status=2)]),  # type: ignore[arg-type]
        TimedMap(1, {"a": math.inf, "b": b"\0", "c": np.zeros((2, 2), "u2"), "d": True, "e": 2**63, "f": "x", "g": 1.5}),
        TimedNDArray(0, np.array([1 + 2j])), TimedNDArray(0, np.zeros((0, 3))),
    ],
)  # fmt: skip
def test_plain_data_loses_nothing(record: Any) -> None:
    plain = json.loads(json.dumps(to_plain(record), allow_nan=False))
    back = from_plain(type(record), plain)
    assert back == record
    assert to_plain(back) == to_plain(record)


def test_plain_form_is_what_a_reader_expects() -> None:
    assert to_plain(TimedDouble(5, math.nan)) == {"tm": 5, "data": "NaN"}
    assert to_plain(ActArrayState(0, [Actuator()]))["actuators"][0]["status"] == "ACTUATOR_STATUS_IDLE"
    assert to_plain(CameraImage(pixels=b"\0\1"))["pixels"] == "AAE="


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({"tm": 0}, r"TimedDouble: missing field data; expected tm, data"),
        ({"tm": 0, "data": 1.0, "x": 1}, r"TimedDouble: unknown field x"),
        ({"tm": 0, "data": "nan"}, r"TimedDouble\.data: expected a number, \"NaN\""),
        ({"tm": -1, "data": 0.0}, r"TimedDouble\.tm: expected nanoseconds"),
        ([], r"TimedDouble: expected a mapping with tm, data, got a list of 0"),
    ],
)
def test_plain_data_that_is_wrong_names_the_field(plain: Any, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        from_plain(TimedDouble, plain)
