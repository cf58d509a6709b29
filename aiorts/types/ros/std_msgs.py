"""Records of ROS's package std_msgs."""

from __future__ import annotations

from aiorts.types.record import record
from aiorts.types.ros.builtin_interfaces import Time


@record
class Header:
    """The time and the coordinate frame of the values of a message."""

    stamp: Time = Time()
    frame_id: str = ""
