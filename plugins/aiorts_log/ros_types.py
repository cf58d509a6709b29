"""Which records the messages of ROS 2 become: tables from its types to ours, and what reads a field. Pure.

A message becomes a sample of one port for each of its parts: those of well-known types keep their shape (a Vector3 is a
Vector3D), all other numbers and texts become the timed record of their own type. Lists of messages become columns: a
list of points is a list of x, one of y, one of z.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

import aiorts.types as t

__all__ = ("FIELDS", "LISTS", "PARTS", "PARTS_OF_FIELDS", "SCALARS", "TIMES", "Column", "nanoseconds")

Get = Callable[[Any], Any]


class Column(NamedTuple):
    """What becomes a port: the field, the timed record, and what makes its `data` of a message."""

    path: str
    cls: type
    get: Get


SCALARS: Final[dict[str, type]] = {
    "bool": t.TimedBoolean,
    "byte": t.TimedOctet,
    "octet": t.TimedOctet,
    "char": t.TimedOctet,
    "int8": t.TimedShort,
    "uint8": t.TimedOctet,
    "int16": t.TimedShort,
    "uint16": t.TimedUShort,
    "int32": t.TimedLong,
    "uint32": t.TimedULong,
    "int64": t.TimedLongLong,
    "uint64": t.TimedULongLong,
    "float32": t.TimedFloat,
    "float64": t.TimedDouble,
    "string": t.TimedString,
}
"""The record of a number or text of ROS 2, which is as wide or wider."""
LISTS: Final[dict[str, tuple[type, str]]] = {
    "bool": (t.TimedBooleanSeq, "?"),
    "byte": (t.TimedOctetSeq, "u1"),
    "octet": (t.TimedOctetSeq, "u1"),
    "char": (t.TimedOctetSeq, "u1"),
    "int8": (t.TimedShortSeq, "i2"),
    "uint8": (t.TimedOctetSeq, "u1"),
    "int16": (t.TimedShortSeq, "i2"),
    "uint16": (t.TimedUShortSeq, "u2"),
    "int32": (t.TimedLongSeq, "i4"),
    "uint32": (t.TimedULongSeq, "u4"),
    "int64": (t.TimedLongLongSeq, "i8"),
    "uint64": (t.TimedULongLongSeq, "u8"),
    "float32": (t.TimedFloatSeq, "f4"),
    "float64": (t.TimedDoubleSeq, "f8"),
    "string": (t.TimedStringSeq, ""),
}
"""The record of a list, and the type of its array; a list of texts is a tuple."""
TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def nanoseconds(time: Any) -> int:
    """A Time or Duration in ns; ROS 2 has signed seconds."""
    return int(time.sec) * 10**9 + int(time.nanosec)


def _xyz(cls: type) -> Get:
    return lambda m: cls(m.x, m.y, m.z)


def _angles(q: Any) -> t.Orientation3D:
    """Roll, pitch, yaw of a quaternion, which need not have length 1; one of length 0 turns nothing, as in ROS."""
    x, y, z, w = q.x, q.y, q.z, q.w
    square = x * x + y * y + z * z + w * w
    if not square:
        return t.Orientation3D()
    return t.Orientation3D(
        math.atan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z),
        math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x) / square))),
        math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z),
    )


def _quaternion(q: Any) -> t.Quaternion:
    return t.Quaternion(q.x, q.y, q.z, q.w)


def _each(field: str, names: str = "xyz") -> list[str]:
    return [f"{field}.{name}" for name in names]


def _velocity(m: Any) -> t.Velocity3D:
    return t.Velocity3D(m.linear.x, m.linear.y, m.linear.z, m.angular.x, m.angular.y, m.angular.z)


_VECTOR: Final = (Column("", t.TimedVector3D, _xyz(t.Vector3D)),)
_POINT: Final = (Column("", t.TimedPoint3D, _xyz(t.Point3D)),)
_TURN: Final = (Column("", t.TimedAngularVelocity3D, _xyz(t.AngularVelocity3D)),)
_PUSH: Final = (Column("", t.TimedAcceleration3D, _xyz(t.Acceleration3D)),)
PARTS: Final[dict[str, tuple[Column, ...]]] = {
    "geometry_msgs/msg/Vector3": _VECTOR,
    "geometry_msgs/msg/Point": _POINT,
    "geometry_msgs/msg/Point32": _POINT,
    "geometry_msgs/msg/Quaternion": (Column("", t.TimedQuaternion, _quaternion),),
    "geometry_msgs/msg/Pose2D": (Column("", t.TimedPose2D, lambda m: t.Pose2D(t.Point2D(m.x, m.y), m.theta)),),
    "geometry_msgs/msg/Pose": (
        Column("", t.TimedPose3D, lambda m: t.Pose3D(_xyz(t.Point3D)(m.position), _angles(m.orientation))),
        Column("orientation", t.TimedQuaternion, lambda m: _quaternion(m.orientation)),
    ),
    "geometry_msgs/msg/Transform": (
        Column("", t.TimedPose3D, lambda m: t.Pose3D(_xyz(t.Point3D)(m.translation), _angles(m.rotation))),
        Column("rotation", t.TimedQuaternion, lambda m: _quaternion(m.rotation)),
    ),
    "geometry_msgs/msg/Twist": (Column("", t.TimedVelocity3D, _velocity),),
    "geometry_msgs/msg/Accel": (
        Column("linear", t.TimedAcceleration3D, lambda m: _xyz(t.Acceleration3D)(m.linear)),
        Column("angular", t.TimedAngularAcceleration3D, lambda m: _xyz(t.AngularAcceleration3D)(m.angular)),
    ),
}
"""Well-known types as wholes. A pose turns by roll, pitch and yaw here; its quaternion is a port of its own."""
PARTS_OF_FIELDS: Final[dict[tuple[str, str], tuple[Column, ...]]] = {
    ("sensor_msgs/msg/Imu", "angular_velocity"): _TURN,
    ("sensor_msgs/msg/Imu", "linear_acceleration"): _PUSH,
}
"""By type and field: what says more than the field's own type does."""
FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "geometry_msgs/msg/Vector3": ("x", "y", "z"),
    "geometry_msgs/msg/Point": ("x", "y", "z"),
    "geometry_msgs/msg/Point32": ("x", "y", "z"),
    "geometry_msgs/msg/Quaternion": ("x", "y", "z", "w"),
    "geometry_msgs/msg/Pose2D": ("x", "y", "theta"),
    "geometry_msgs/msg/Pose": (*_each("position"), *_each("orientation", "xyzw")),
    "geometry_msgs/msg/Transform": (*_each("translation"), *_each("rotation", "xyzw")),
    "geometry_msgs/msg/Twist": (*_each("linear"), *_each("angular")),
    "geometry_msgs/msg/Accel": (*_each("linear"), *_each("angular")),
}
"""What they have to consist of: a file may call anything a Vector3."""


def scalar_of(kind: str) -> Get:
    """What makes a number of ours of one of numpy or Python."""
    if kind == "string":
        return str
    return bool if kind == "bool" else float if kind.startswith("float") else int


def array_of(kind: str, values: Any) -> Any:
    """The `data` of a list."""
    code = LISTS[kind][1]
    return np.array(values, dtype=code) if code else tuple(values)
