"""Tables from ROS 2 types to records, and the functions that read a field.

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

Get = Callable[[Any], Any]


class Column(NamedTuple):
    """A future port: the field, the timed record, and the function that makes its `data` of a message."""

    path: str
    cls: type
    get: Get


_OCTET: Final = (t.TimedOctet, t.TimedOctetSeq, "u1")
_RECORDS: Final[dict[str, tuple[type, type, str]]] = {
    "bool": (t.TimedBoolean, t.TimedBooleanSeq, "?"),
    **dict.fromkeys(("byte", "octet", "char", "uint8"), _OCTET),
    "int8": (t.TimedShort, t.TimedShortSeq, "i2"),
    "int16": (t.TimedShort, t.TimedShortSeq, "i2"),
    "uint16": (t.TimedUShort, t.TimedUShortSeq, "u2"),
    "int32": (t.TimedLong, t.TimedLongSeq, "i4"),
    "uint32": (t.TimedULong, t.TimedULongSeq, "u4"),
    "int64": (t.TimedLongLong, t.TimedLongLongSeq, "i8"),
    "uint64": (t.TimedULongLong, t.TimedULongLongSeq, "u8"),
    "float32": (t.TimedFloat, t.TimedFloatSeq, "f4"),
    "float64": (t.TimedDouble, t.TimedDoubleSeq, "f8"),
    "string": (t.TimedString, t.TimedStringSeq, ""),
}
SCALARS: Final = {kind: scalar for kind, (scalar, _, _) in _RECORDS.items()}
"""The record for a number or text of ROS 2; its type is as wide as ROS's, or wider."""
LISTS: Final = {kind: (of_list, code) for kind, (_, of_list, code) in _RECORDS.items()}
"""The record of a list, and the type of its array; a list of texts is a tuple."""
TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")


def nanoseconds(time: Any) -> int:
    """A Time or Duration in ns; ROS 2 has signed seconds."""
    return int(time.sec) * 10**9 + int(time.nanosec)


def _xyz(cls: type) -> Get:
    return lambda m: cls(m.x, m.y, m.z)


def _angles(q: Any) -> t.Orientation3D:
    """Roll, pitch, yaw of a quaternion of any length; one of length 0 is no rotation, as in ROS."""
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
"""Well-known types with a record of their own. A pose has roll, pitch and yaw; its quaternion is a second port."""
PARTS_OF_FIELDS: Final[dict[tuple[str, str], tuple[Column, ...]]] = {
    ("sensor_msgs/msg/Imu", "angular_velocity"): _TURN,
    ("sensor_msgs/msg/Imu", "linear_acceleration"): _PUSH,
}
"""The records that say more than a field's own type, by type and field."""
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
"""The fields that well-known types must have: a file may call anything a Vector3."""


def scalar_of(kind: str) -> Get:
    """The function that makes a plain number or text of a value of numpy or Python."""
    if kind == "string":
        return str
    return bool if kind == "bool" else float if kind.startswith("float") else int


def array_of(kind: str, values: Any) -> Any:
    """The `data` of a list."""
    code = LISTS[kind][1]
    return np.array(values, dtype=code) if code else tuple(values)
