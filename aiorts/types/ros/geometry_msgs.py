"""Records of ROS's package geometry_msgs: m, rad, s.

A covariance is 6 by 6, row by row: x, y, z, and turns about them.
"""

from __future__ import annotations

from aiorts.types.record import record
from aiorts.types.ros.headed import Headed, check_length, zeros
from aiorts.types.ros.std_msgs import Header
from aiorts.types.spelling import Array, f64

__all__ = (
    "Point",
    "Pose",
    "PoseStamped",
    "PoseWithCovariance",
    "Quaternion",
    "Transform",
    "TransformStamped",
    "Twist",
    "TwistStamped",
    "TwistWithCovariance",
    "Vector3",
)


@record
class Vector3:
    """A direction with a length."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@record
class Point:
    """A place, m."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@record
class Quaternion:
    """An orientation."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0
    w: f64 = 1.0


@record
class Pose:
    """A place and an orientation."""

    position: Point = Point()
    orientation: Quaternion = Quaternion()


@record
class PoseWithCovariance:
    """A pose and how certain it is."""

    pose: Pose = Pose()
    covariance: Array[f64] = zeros(36)

    def __post_init__(self) -> None:
        check_length(self, 36, "covariance")


@record
class PoseStamped(Headed):
    """A pose in a frame at a moment."""

    header: Header = Header()
    pose: Pose = Pose()


@record
class Twist:
    """A velocity, m/s, and an angular velocity, rad/s."""

    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


@record
class TwistWithCovariance:
    """A twist and how certain it is."""

    twist: Twist = Twist()
    covariance: Array[f64] = zeros(36)

    def __post_init__(self) -> None:
        check_length(self, 36, "covariance")


@record
class TwistStamped(Headed):
    """A twist in a frame at a moment."""

    header: Header = Header()
    twist: Twist = Twist()


@record
class Transform:
    """A shift, m, and a turn: from one frame to another."""

    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@record
class TransformStamped(Headed):
    """The pose of the frame `child_frame_id` in the frame of the header at a moment."""

    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()
