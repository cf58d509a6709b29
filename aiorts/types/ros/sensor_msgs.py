"""Records of ROS's package sensor_msgs; a covariance is 3 by 3, row by row, with -1 in front where nothing is known."""

from __future__ import annotations

from typing import ClassVar

from aiorts.types.record import record
from aiorts.types.ros.geometry_msgs import Quaternion, Vector3
from aiorts.types.ros.headed import Headed, check_length, zeros
from aiorts.types.ros.std_msgs import Header
from aiorts.types.spelling import EMPTY, Array, Seq, f32, f64, i8, u8, u16, u32

__all__ = (
    "CompressedImage",
    "Image",
    "Imu",
    "JointState",
    "LaserScan",
    "NavSatFix",
    "NavSatStatus",
    "PointCloud2",
    "PointField",
)


@record
class Imu(Headed):
    """Values of an inertial measurement unit: orientation, angular velocity (rad/s), acceleration (m/s^2)."""

    header: Header = Header()
    orientation: Quaternion = Quaternion()
    orientation_covariance: Array[f64] = zeros(9)
    angular_velocity: Vector3 = Vector3()
    angular_velocity_covariance: Array[f64] = zeros(9)
    linear_acceleration: Vector3 = Vector3()
    linear_acceleration_covariance: Array[f64] = zeros(9)

    def __post_init__(self) -> None:
        check_length(
            *(self, 9, "orientation_covariance"),
            *("angular_velocity_covariance", "linear_acceleration_covariance"),
        )


@record
class LaserScan(Headed):
    """One turn of a planar range finder: angles in rad, times in s, ranges in m, intensities in units of the device."""

    header: Header = Header()
    angle_min: f32 = 0.0
    angle_max: f32 = 0.0
    angle_increment: f32 = 0.0
    time_increment: f32 = 0.0
    scan_time: f32 = 0.0
    range_min: f32 = 0.0
    range_max: f32 = 0.0
    ranges: Array[f32] = EMPTY
    intensities: Array[f32] = EMPTY


@record
class Image(Headed):
    """A picture as bytes, `step` bytes a row; `encoding` is the format of a pixel ("rgb8", "mono16")."""

    header: Header = Header()
    height: u32 = 0
    width: u32 = 0
    encoding: str = ""
    is_bigendian: u8 = 0
    step: u32 = 0
    data: Array[u8] = EMPTY


@record
class CompressedImage(Headed):
    """A picture as a file of the kind that `format` names ("jpeg", "png")."""

    header: Header = Header()
    format: str = ""
    data: Array[u8] = EMPTY


@record
class PointField:
    """A value within each point of a PointCloud2: its name, first byte, type, and number of elements."""

    INT8: ClassVar[int] = 1
    UINT8: ClassVar[int] = 2
    INT16: ClassVar[int] = 3
    UINT16: ClassVar[int] = 4
    INT32: ClassVar[int] = 5
    UINT32: ClassVar[int] = 6
    FLOAT32: ClassVar[int] = 7
    FLOAT64: ClassVar[int] = 8

    name: str = ""
    offset: u32 = 0
    datatype: u8 = 0
    count: u32 = 0


@record
class PointCloud2(Headed):
    """Points as bytes: `point_step` bytes a point, `row_step` bytes a row; `fields` describes those of a point."""

    header: Header = Header()
    height: u32 = 0
    width: u32 = 0
    fields: Seq[PointField] = EMPTY
    is_bigendian: bool = False
    point_step: u32 = 0
    row_step: u32 = 0
    data: Array[u8] = EMPTY
    is_dense: bool = False


@record
class JointState(Headed):
    """Joints by name, and the position (rad or m), velocity and effort (Nm or N) of each; unknown ones are empty."""

    header: Header = Header()
    name: Seq[str] = EMPTY
    position: Array[f64] = EMPTY
    velocity: Array[f64] = EMPTY
    effort: Array[f64] = EMPTY


@record
class NavSatStatus:
    """The kind of a satellite receiver's fix (STATUS_...), and the systems it uses (a sum of SERVICE_...)."""

    STATUS_UNKNOWN: ClassVar[int] = -2
    STATUS_NO_FIX: ClassVar[int] = -1
    STATUS_FIX: ClassVar[int] = 0
    STATUS_SBAS_FIX: ClassVar[int] = 1
    STATUS_GBAS_FIX: ClassVar[int] = 2
    SERVICE_UNKNOWN: ClassVar[int] = 0
    SERVICE_GPS: ClassVar[int] = 1
    SERVICE_GLONASS: ClassVar[int] = 2
    SERVICE_COMPASS: ClassVar[int] = 4
    SERVICE_GALILEO: ClassVar[int] = 8

    status: i8 = -2
    service: u16 = 0


@record
class NavSatFix(Headed):
    """A position on the earth: degrees, m above the ellipsoid; covariance in m^2 (COVARIANCE_TYPE_...: its source)."""

    COVARIANCE_TYPE_UNKNOWN: ClassVar[int] = 0
    COVARIANCE_TYPE_APPROXIMATED: ClassVar[int] = 1
    COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[int] = 2
    COVARIANCE_TYPE_KNOWN: ClassVar[int] = 3

    header: Header = Header()
    status: NavSatStatus = NavSatStatus()
    latitude: f64 = 0.0
    longitude: f64 = 0.0
    altitude: f64 = 0.0
    position_covariance: Array[f64] = zeros(9)
    position_covariance_type: u8 = 0

    def __post_init__(self) -> None:
        check_length(self, 9, "position_covariance")
