"""Messages of ROS 2 as records, by the names that ROS gives them: `sensor_msgs/Imu` is `aiorts.types.ros.Imu`.

Each package of ROS has a module. All are loaded when this package is imported, or when a name such as `sensor_msgs/Imu`
or `sensor_msgs/msg/Imu` is looked up. A bare name ("Imu", "Quaternion") never means a record of ROS.
"""

from __future__ import annotations

from aiorts.types.ros import geometry_msgs as _geometry_msgs
from aiorts.types.ros import sensor_msgs as _sensor_msgs
from aiorts.types.ros.builtin_interfaces import Time
from aiorts.types.ros.geometry_msgs import *
from aiorts.types.ros.headed import Headed
from aiorts.types.ros.nav_msgs import Odometry
from aiorts.types.ros.sensor_msgs import *
from aiorts.types.ros.std_msgs import Header

__all__ = [
    "Headed",
    "Header",
    "Odometry",
    "Time",
]
__all__ += _geometry_msgs.__all__
__all__ += _sensor_msgs.__all__
