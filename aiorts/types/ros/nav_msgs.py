"""Records of ROS's package nav_msgs."""

from __future__ import annotations

from aiorts.types.record import record, zero
from aiorts.types.ros.geometry_msgs import PoseWithCovariance, TwistWithCovariance
from aiorts.types.ros.headed import Headed
from aiorts.types.ros.std_msgs import Header


@record
class Odometry(Headed):
    """An estimate of a robot's pose, in the header's frame, and of its twist, in the frame `child_frame_id`."""

    header: Header = Header()
    child_frame_id: str = ""
    pose: PoseWithCovariance = zero(PoseWithCovariance)
    twist: TwistWithCovariance = zero(TwistWithCovariance)
