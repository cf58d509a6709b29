"""Records of ROS's package std_msgs."""

from __future__ import annotations

from aiorts.types.record import record
from aiorts.types.ros.builtin_interfaces import Time


@record
class Header:
    """When and in which coordinate frame the values of a message hold."""

    stamp: Time = Time()
    frame_id: str = ""
