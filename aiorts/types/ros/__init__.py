"""Messages of ROS 2 as records, by the names that ROS gives them: `sensor_msgs/Imu` is `aiorts.types.ros.Imu`.

A module for each package of ROS. They are loaded when this is imported, or when a name such as `sensor_msgs/Imu` or
`sensor_msgs/msg/Imu` is asked for; no bare name ("Imu", "Quaternion") ever means one of them.
"""

from __future__ import annotations

from aiorts.types.ros.builtin_interfaces import Time
from aiorts.types.ros.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    TwistStamped,
    TwistWithCovariance,
    Vector3,
)
from aiorts.types.ros.headed import Headed
from aiorts.types.ros.nav_msgs import Odometry
from aiorts.types.ros.sensor_msgs import (
    CompressedImage,
    Image,
    Imu,
    JointState,
    LaserScan,
    NavSatFix,
    NavSatStatus,
    PointCloud2,
    PointField,
)
from aiorts.types.ros.std_msgs import Header

__all__ = [
    "CompressedImage",
    "Headed",
    "Header",
    "Image",
    "Imu",
    "JointState",
    "LaserScan",
    "NavSatFix",
    "NavSatStatus",
    "Odometry",
    "Point",
    "PointCloud2",
    "PointField",
    "Pose",
    "PoseStamped",
    "PoseWithCovariance",
    "Quaternion",
    "Time",
    "Transform",
    "TransformStamped",
    "Twist",
    "TwistStamped",
    "TwistWithCovariance",
    "Vector3",
]
