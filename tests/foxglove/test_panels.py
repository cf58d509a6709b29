"""Records that Foxglove's panels draw come under its schemas, with their own fields beside them."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

import jsonschema
import numpy as np
import pytest

from aiorts.types import (
    CameraImage,
    Geometry3D,
    Orientation3D,
    Point2D,
    Point3D,
    Pose2D,
    Pose3D,
    PoseVel2D,
    PoseVel3D,
    RangeData,
    RangerConfig,
    RangerGeometry,
    TimedDouble,
    TimedPose2D,
    TimedPose3D,
    TimedPoseVel2D,
    TimedPoseVel3D,
    full_name,
    record,
)
from aiorts.types.ros import builtin_interfaces, geometry_msgs, nav_msgs, sensor_msgs, std_msgs
from aiorts.wire import MsgpackCodec
from aiorts_foxglove.channels import Channel, Kind
from aiorts_foxglove.panels import PANELS

TM = 1_700_000_000_000_000_001
STAMP = {"sec": 1_700_000_000, "nsec": 1}
HEADER = std_msgs.Header(builtin_interfaces.Time(1_700_000_000, 1), "base")
AT, QUARTER = (
    {"x": 1.0, "y": 2.0, "z": 0.0},
    {"x": 0.0, "y": 0.0, "z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)},
)
POSE = Pose2D(Point2D(1.0, 2.0), math.pi / 2)
POSE3 = Pose3D(Point3D(1.0, 2.0, 3.0), Orientation3D(0.0, 0.0, math.pi / 2))
ROS_POSE = geometry_msgs.Pose(geometry_msgs.Point(1.0, 2.0, 0.0), geometry_msgs.Quaternion(**QUARTER))
NOWHERE = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
IN_MAP = {"timestamp": STAMP, "frame_id": "map", "pose": {"position": AT, "orientation": QUARTER}}
IN_MAP_3 = {**IN_MAP, "pose": {"position": {**AT, "z": 3.0}, "orientation": QUARTER}}
PIXELS = np.arange(12, dtype=np.uint8)
DATA = base64.b64encode(PIXELS.tobytes()).decode()

EXPECTED: dict[Any, tuple[str, dict[str, Any]]] = {
    TimedPose2D(TM, POSE): ("PoseInFrame", IN_MAP),
    TimedPose3D(TM, POSE3): ("PoseInFrame", IN_MAP_3),
    TimedPoseVel2D(TM, PoseVel2D(POSE)): ("PoseInFrame", IN_MAP),
    TimedPoseVel3D(TM, PoseVel3D(POSE3)): ("PoseInFrame", IN_MAP_3),
    geometry_msgs.PoseStamped(HEADER, ROS_POSE): ("PoseInFrame", {**IN_MAP, "frame_id": "base"}),
    geometry_msgs.TransformStamped(
        HEADER, "lidar", geometry_msgs.Transform(geometry_msgs.Vector3(1.0, 2.0, 0.0), ROS_POSE.orientation)
    ): (
        "FrameTransform",
        {
            "timestamp": STAMP,
            "parent_frame_id": "base",
            "child_frame_id": "lidar",
            "translation": AT,
            "rotation": QUARTER,
        },
    ),
}
WITH_ARRAYS: list[tuple[Any, str, dict[str, Any]]] = [
    (
        RangeData(
            TM, [1.0, 2.0, 3.0], RangerGeometry(Geometry3D(pose=POSE3)), RangerConfig(minAngle=-1.0, angularRes=0.5)
        ),
        "LaserScan",
        {**IN_MAP_3, "start_angle": -1.0, "end_angle": 0.0, "ranges": [1.0, 2.0, 3.0], "intensities": []},
    ),
    (
        sensor_msgs.LaserScan(HEADER, -1.0, 1.0, 0.5, ranges=[1.0, 2.0, 3.0], intensities=[0.5, 0.5, 1.0]),
        "LaserScan",
        {
            "timestamp": STAMP,
            "frame_id": "base",
            "pose": NOWHERE,
            "start_angle": -1.0,
            "end_angle": 0.0,
            "ranges": [1.0, 2.0, 3.0],
            "intensities": [0.5, 0.5, 1.0],
        },
    ),
    (
        CameraImage(TM, 2, 2, 24, "", 1.0, PIXELS),
        "RawImage",
        {
            "timestamp": STAMP,
            "frame_id": "map",
            "width": 2,
            "height": 2,
            "encoding": "rgb8",
            "step": 6,
            "data": DATA,
        },
    ),
    (
        sensor_msgs.Image(HEADER, 2, 2, "bgr8", 0, 6, PIXELS),
        "RawImage",
        {
            "timestamp": STAMP,
            "frame_id": "base",
            "width": 2,
            "height": 2,
            "encoding": "bgr8",
            "step": 6,
            "data": DATA,
        },
    ),
    (
        sensor_msgs.CompressedImage(HEADER, "jpeg", PIXELS),
        "CompressedImage",
        {"timestamp": STAMP, "frame_id": "base", "format": "jpeg", "data": DATA},
    ),
    (
        nav_msgs.Odometry(HEADER, "robot", geometry_msgs.PoseWithCovariance(ROS_POSE)),
        "PoseInFrame",
        {"timestamp": STAMP, "frame_id": "base"},
    ),
]
ALL = [(one, *told) for one, told in EXPECTED.items()] + WITH_ARRAYS


def shown(one: Any) -> tuple[Kind, dict[str, Any]]:
    kind = Kind.of(full_name(type(one)))
    return kind, json.loads(kind.payload({"frame": MsgpackCodec().encode(one)}))


@pytest.mark.parametrize(("one", "name", "fields"), ALL, ids=[full_name(type(one)) for one, *_ in ALL])
def test_a_record_that_is_drawn_comes_under_foxgloves_schema(one: Any, name: str, fields: dict[str, Any]) -> None:
    kind, message = shown(one)
    about = Channel(1, "a.out", kind).plain
    assert (about["schemaName"], about["schemaEncoding"]) == (f"foxglove.{name}", "jsonschema")
    schema = json.loads(about["schema"])
    assert schema["title"] == f"foxglove.{name}"
    jsonschema.validate(message, schema)
    assert fields.keys() <= schema["properties"].keys()
    for key, value in fields.items():
        assert message[key] == pytest.approx(value) if isinstance(value, float) else _near(message[key], value), key


def _near(found: Any, wanted: Any) -> bool:
    if isinstance(wanted, dict):
        return found.keys() == wanted.keys() and all(_near(found[key], one) for key, one in wanted.items())
    return bool(found == (pytest.approx(wanted) if isinstance(wanted, float) else wanted))


def test_each_row_of_the_table_is_looked_at() -> None:
    assert {full_name(type(one)) for one, *_ in ALL} == set(PANELS)


def test_its_own_fields_stay_for_plots() -> None:
    _, message = shown(TimedPose2D(TM, POSE))
    assert (message["tm"], message["data"]["position"], message["data"]["heading"]) == (
        TM,
        {"x": 1, "y": 2},
        math.pi / 2,
    )
    _, odometry = shown(WITH_ARRAYS[-1][0])
    assert odometry["pose"]["pose"]["position"] == odometry["pose"]["position"] == AT
    assert len(odometry["pose"]["covariance"]) == 36
    _, image = shown(CameraImage(TM, 2, 2, 24, "", 1.0, PIXELS))
    assert "pixels" not in image


def test_where_a_scan_has_seen_nothing_is_beyond_all_numbers() -> None:
    kind = Kind.of("sensor_msgs/LaserScan")
    scan = sensor_msgs.LaserScan(HEADER, ranges=[1.0, math.inf, math.nan])
    text = kind.payload({"frame": MsgpackCodec().encode(scan)}).decode()
    assert '"ranges":[1.0,1e999,1e999]' in text  # what JSON.parse takes; Infinity it refuses


def test_an_image_that_is_compressed_is_no_raw_one() -> None:
    _, message = shown(CameraImage(TM, 2, 2, 24, "JPEG", 1.0, PIXELS))
    assert (message["encoding"], message["data"]) == ("jpeg", "")


def test_angles_turn_about_x_then_y_then_z() -> None:
    _, message = shown(TimedPose3D(TM, Pose3D(Point3D(), Orientation3D(0.1, 0.2, 0.3))))
    x, y, z, w = (message["pose"]["orientation"][axis] for axis in "xyzw")
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.1)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(0.2)
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.3)


@record
class Labelled(TimedPose2D):
    """A pose with a name, of a user."""

    name: str = ""


def test_a_type_that_derives_from_one_is_drawn_and_others_are_as_they_were() -> None:
    kind, message = shown(Labelled(TM, POSE, "here"))
    assert (Channel(1, "a.out", kind).plain["schemaName"], message["name"]) == ("foxglove.PoseInFrame", "here")
    assert message["pose"] == _approx(IN_MAP["pose"])
    kind, message = shown(TimedDouble(TM, 1.0))
    assert (Channel(1, "a.out", kind).plain["schemaName"], message) == ("TimedDouble", {"tm": TM, "data": 1.0})


def _approx(pose: Any) -> Any:
    return {part: pytest.approx(one) for part, one in pose.items()}
