"""The records that Foxglove's 3D and Image panels draw, with the schema of each and the values of its fields.

A panel recognises a schema's name and fields. A message of one of these types has the fields of its record, for plots
and tables, and in addition those of the schema.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, sin
from types import MappingProxyType
from typing import Any, Final

from aiorts.types import full_name
from aiorts.wire import json_message

FRAME: Final = "map"
"""The frame of records that name none, which are all but those of ROS."""
_COMPRESSED: Final = ("jpeg", "jpg", "png", "webp", "avif")


@dataclass(frozen=True, slots=True)
class Panel:
    """The way in which the records of a type are drawn."""

    name: str
    """The schema's name."""
    fields: Mapping[str, Any]
    """JSON schemas of the fields that are added to the record's fields, or replace them."""
    values: Callable[[Any], Mapping[str, Any]]
    """The values of these fields."""
    left_out: str = ""
    """A field of the record that is left out, since one of `fields` has its value under another name."""

    def schema_with(self, schema: str) -> str:
        """The schema of the messages, from that of the records."""
        document = json.loads(schema)
        document["title"] = self.name
        document["properties"] |= self.fields
        document["properties"].pop(self.left_out, None)
        document["required"] = [one for one in document["required"] if one in document["properties"]]
        return json.dumps(document, separators=(",", ":"))

    def message(self, record: Any) -> bytes:
        """A record as a message."""
        plain = {**json_message(record), **self.values(record)}
        plain.pop(self.left_out, None)
        return _text(plain).encode()


def panel_of(cls: type) -> Panel | None:
    """The panel that draws the records of a type, or of a type that it derives from; None where no panel does."""
    return next((PANELS[name] for name in map(full_name, cls.__mro__[:-1]) if name in PANELS), None)


def _text(value: Any) -> str:
    """The value as JSON text. NaN and infinities, which JSON lacks, become 1e999 or -1e999: nothing is drawn there."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{json.dumps(key)}:{_text(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        try:
            return json.dumps(value, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
        except ValueError:
            return f"[{','.join(map(_text, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return "-1e999" if value < 0 else "1e999"
    return json.dumps(value, ensure_ascii=False)


# -- the schemas' fields ---------------------------------------------------------------------------------------------


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_TEXT: Final = {"type": "string"}
_NUMBER: Final = {"type": "number"}
_NUMBERS: Final = {"type": "array", "items": _NUMBER}
_WHOLE: Final = {"type": "integer", "minimum": 0}
_BYTES: Final = {"type": "string", "contentEncoding": "base64"}
_VECTOR: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_TURN: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object(position=_VECTOR, orientation=_TURN)
_STAMPED: Final = {"timestamp": _object(sec=_WHOLE, nsec=_WHOLE), "frame_id": _TEXT}
_POSE_IN_FRAME: Final = {**_STAMPED, "pose": _POSE}
_SCAN: Final = {
    **_STAMPED,
    "pose": _POSE,
    "start_angle": _NUMBER,
    "end_angle": _NUMBER,
    "ranges": _NUMBERS,
    "intensities": _NUMBERS,
}
_TRANSFORM: Final = {
    "timestamp": _STAMPED["timestamp"],
    "parent_frame_id": _TEXT,
    "child_frame_id": _TEXT,
    "translation": _VECTOR,
    "rotation": _TURN,
}
_RAW_IMAGE: Final = {
    **_STAMPED,
    "width": _WHOLE,
    "height": _WHOLE,
    "encoding": _TEXT,
    "step": _WHOLE,
    "data": _BYTES,
}


# -- their values ----------------------------------------------------------------------------------------------------


def _stamped(record: Any) -> dict[str, Any]:
    """The time stamp of a record, and its frame, which a header names."""
    header = getattr(record, "header", None)
    ns = int(record.tm)
    stamp = {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}
    return {"timestamp": stamp, "frame_id": FRAME if header is None else header.frame_id}


def _vector(one: Any) -> dict[str, float]:
    return {"x": one.x, "y": one.y, "z": getattr(one, "z", 0.0)}


def _turn(one: Any) -> dict[str, float]:
    return {"x": one.x, "y": one.y, "z": one.z, "w": one.w}


def _turned(roll: float, pitch: float, yaw: float) -> dict[str, float]:
    """The quaternion of these angles: about x, then y, then z."""
    r, p, y = roll / 2, pitch / 2, yaw / 2
    return {
        "x": sin(r) * cos(p) * cos(y) - cos(r) * sin(p) * sin(y),
        "y": cos(r) * sin(p) * cos(y) + sin(r) * cos(p) * sin(y),
        "z": cos(r) * cos(p) * sin(y) - sin(r) * sin(p) * cos(y),
        "w": cos(r) * cos(p) * cos(y) + sin(r) * sin(p) * sin(y),
    }


def _pose(one: Any) -> dict[str, Any]:
    """Foxglove's pose of a Pose2D, a Pose3D or a pose of ROS."""
    if hasattr(one, "heading"):
        turn = _turned(0.0, 0.0, one.heading)
    elif hasattr(one.orientation, "w"):
        turn = _turn(one.orientation)
    else:
        turn = _turned(one.orientation.r, one.orientation.p, one.orientation.y)
    return {"position": _vector(one.position), "orientation": turn}


def _range_data(record: Any) -> dict[str, Any]:
    config, count = record.config, len(record.ranges)
    step = config.angularRes or ((config.maxAngle - config.minAngle) / max(1, count - 1))
    return {
        **_stamped(record),
        "pose": _pose(record.geometry.geometry.pose),
        "start_angle": config.minAngle,
        "end_angle": config.minAngle + step * max(0, count - 1),
        "ranges": record.ranges.tolist(),
        "intensities": [],
    }


def _laser_scan(record: Any) -> dict[str, Any]:
    return {
        **_stamped(record),
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _turned(0.0, 0.0, 0.0)},
        "start_angle": record.angle_min,
        "end_angle": record.angle_min + record.angle_increment * max(0, len(record.ranges) - 1),
        "ranges": record.ranges.tolist(),
        "intensities": record.intensities.tolist(),
    }


def _transform(record: Any) -> dict[str, Any]:
    stamped, transform = _stamped(record), record.transform
    return {
        "timestamp": stamped["timestamp"],
        "parent_frame_id": stamped["frame_id"],
        "child_frame_id": record.child_frame_id,
        "translation": _vector(transform.translation),
        "rotation": _turn(transform.rotation),
    }


def _camera_image(record: Any) -> dict[str, Any]:
    """The fields of a camera image; a compressed image has no data here, since a raw image is never compressed."""
    raw = record.format.lower() not in _COMPRESSED
    return {
        **_stamped(record),
        "encoding": record.format.lower() or {8: "mono8", 24: "rgb8", 32: "rgba8"}.get(record.bpp, ""),
        "step": record.width * record.bpp // 8,
        "data": base64.b64encode(record.pixels.tobytes() if raw else b"").decode("ascii"),
    }


def _odometry(record: Any) -> dict[str, Any]:
    """The fields of an odometry: its pose with covariance and the schema's pose have one name, and are merged."""
    pose = {**json_message(record)["pose"], **_pose(record.pose.pose)}
    return {**_stamped(record), "pose": pose}


def _poses(get: Callable[[Any], Any]) -> Panel:
    return Panel("foxglove.PoseInFrame", _POSE_IN_FRAME, lambda one: {**_stamped(one), "pose": _pose(get(one))})


PANELS: Final[Mapping[str, Panel]] = MappingProxyType(
    {
        "aiorts.types.TimedPose2D": _poses(lambda one: one.data),
        "aiorts.types.TimedPose3D": _poses(lambda one: one.data),
        "aiorts.types.TimedPoseVel2D": _poses(lambda one: one.data.pose),
        "aiorts.types.TimedPoseVel3D": _poses(lambda one: one.data.pose),
        "geometry_msgs/PoseStamped": _poses(lambda one: one.pose),
        "nav_msgs/Odometry": Panel("foxglove.PoseInFrame", _POSE_IN_FRAME, _odometry),
        "geometry_msgs/TransformStamped": Panel("foxglove.FrameTransform", _TRANSFORM, _transform),
        "aiorts.types.RangeData": Panel("foxglove.LaserScan", _SCAN, _range_data),
        "sensor_msgs/LaserScan": Panel("foxglove.LaserScan", _SCAN, _laser_scan),
        "aiorts.types.CameraImage": Panel("foxglove.RawImage", _RAW_IMAGE, _camera_image, "pixels"),
        "sensor_msgs/Image": Panel("foxglove.RawImage", _RAW_IMAGE, _stamped),
        "sensor_msgs/CompressedImage": Panel(
            "foxglove.CompressedImage", {**_STAMPED, "data": _BYTES, "format": _TEXT}, _stamped
        ),
    }
)
"""The panels, by the full names of types."""
