"""The 44 device records and 5 enumerations of OpenRTM. Those that are port data carry their own `tm`.

Field names are those of the IDL, so that profiles and logs of OpenRTM fit. Lengths are in m and angles in rad, unless
the record states other units.
"""

from __future__ import annotations

# Annotations are read at run time, and names are those of the IDL.
# ruff: noqa: N815
from enum import IntEnum

from aiorts.types.extended import (
    OAP,
    Covariance2D,
    Covariance3D,
    Geometry3D,
    Orientation3D,
    Point2D,
    Point3D,
    PointCovariance2D,
    Pose2D,
    Pose3D,
    RGBColour,
    Size3D,
    Vector2D,
    Vector3D,
    Velocity2D,
    Velocity3D,
)
from aiorts.types.record import Stamped, record, zero
from aiorts.types.spelling import EMPTY, Array, Rows, Seq, f64, u8, u16, u32
from aiorts.types.stamps import Time

__all__ = (
    "ActArrayActuatorPos",
    "ActArrayActuatorSpeed",
    "ActArrayActuatorCurrent",
    "ActArrayActuatorStatus",
    "Actuator",
    "ActArrayState",
    "ActArrayActuatorType",
    "ActArrayActuatorGeometry",
    "ActArrayGeometry",
    "BumperGeometry",
    "BumperArrayGeometry",
    "CameraImage",
    "CameraInfo",
    "FiducialInfo",
    "Fiducials",
    "FiducialFOV",
    "GPSTime",
    "GPSFixType",
    "GPSData",
    "GripperStatus",
    "GripperState",
    "GripperGeometry",
    "INSData",
    "LimbStatus",
    "LimbState",
    "Hypothesis2D",
    "Hypotheses2D",
    "Hypothesis3D",
    "Hypotheses3D",
    "OGMapConfig",
    "OGMapTile",
    "PointFeature",
    "PoseFeature",
    "LineFeature",
    "Features",
    "MultiCameraImages",
    "MulticameraGeometry",
    "Waypoint2D",
    "Path2D",
    "Waypoint3D",
    "Path3D",
    "PointCloudPoint",
    "PointCloud",
    "PanTiltAngles",
    "PanTiltState",
    "RangerGeometry",
    "RangerConfig",
    "RangeData",
    "IntensityData",
)


@record
class ActArrayActuatorPos(Stamped):
    """Position of one actuator (index from 0), m or rad."""

    tm: int = 0
    index: u16 = 0
    position: f64 = 0.0


@record
class ActArrayActuatorSpeed(Stamped):
    """Speed of one actuator (index from 0), m/s or rad/s."""

    tm: int = 0
    index: u16 = 0
    speed: f64 = 0.0


@record
class ActArrayActuatorCurrent(Stamped):
    """Current through one actuator (index from 0), A."""

    tm: int = 0
    index: u16 = 0
    current: f64 = 0.0


class ActArrayActuatorStatus(IntEnum):
    """The activity of an actuator."""

    ACTUATOR_STATUS_IDLE = 0
    ACTUATOR_STATUS_MOVING = 1
    ACTUATOR_STATUS_BRAKED = 2
    ACTUATOR_STATUS_STALLED = 3


@record
class Actuator:
    """State of an actuator: m or rad, per s, per s2, A."""

    position: f64 = 0.0
    speed: f64 = 0.0
    accel: f64 = 0.0
    current: f64 = 0.0
    status: ActArrayActuatorStatus = ActArrayActuatorStatus.ACTUATOR_STATUS_IDLE


@record
class ActArrayState(Stamped):
    """State of all actuators of an array."""

    tm: int = 0
    actuators: Seq[Actuator] = EMPTY


class ActArrayActuatorType(IntEnum):
    """Whether an actuator slides or turns."""

    ACTARRAY_ACTUATORTYPE_LINEAR = 0
    ACTARRAY_ACTUATORTYPE_ROTARY = 1


@record
class ActArrayActuatorGeometry:
    """The geometry of an actuator.

    `length` is the distance to the next actuator, ranges are in m or rad, `axis` is the axis of motion.
    """

    type: ActArrayActuatorType = ActArrayActuatorType.ACTARRAY_ACTUATORTYPE_LINEAR
    length: f64 = 0.0
    orientation: Orientation3D = Orientation3D()
    axis: Vector3D = Vector3D()
    minRange: f64 = 0.0
    centre: f64 = 0.0
    maxRange: f64 = 0.0
    homePosition: f64 = 0.0
    hasBrakes: bool = False


@record
class ActArrayGeometry:
    """The geometry of an array of actuators."""

    arrayGeometry: Geometry3D = Geometry3D()
    actuatorGeometry: Seq[ActArrayActuatorGeometry] = EMPTY


@record
class BumperGeometry:
    """Pose and size of a bumper, m; `roc` is its radius of curvature, 0 when straight."""

    pose: Pose3D = Pose3D()
    size: Size3D = Size3D()
    roc: f64 = 0.0


@record
class BumperArrayGeometry:
    """The places of the bumpers of an array."""

    arrayGeometry: Geometry3D = Geometry3D()
    bumperGeometry: Rows[BumperGeometry] = EMPTY


@record
class CameraImage(Stamped):
    """An image as bytes, row by row or encoded as `format` names.

    Bpp = bits per pixel; a whole-number pixel divided by fDiv is the real value.
    """

    tm: int = 0
    width: u16 = 0
    height: u16 = 0
    bpp: u16 = 0
    format: str = ""
    fDiv: f64 = 0.0
    pixels: Array[u8] = EMPTY


@record
class CameraInfo:
    """Intrinsic parameters: focal length in m, k1 and k2 radial, p1 and p2 tangential distortion."""

    focalLength: Vector2D = Vector2D()
    principalPoint: Point2D = Point2D()
    k1: f64 = 0.0
    k2: f64 = 0.0
    p1: f64 = 0.0
    p2: f64 = 0.0


@record
class FiducialInfo:
    """A marker that was seen, with the uncertainty of its pose (m, rad) and size (m)."""

    id: u32 = 0
    pose: Pose3D = Pose3D()
    poseUncertainty: Pose3D = Pose3D()
    size: Size3D = Size3D()
    sizeUncertainty: Size3D = Size3D()


@record
class Fiducials(Stamped):
    """The markers seen at one moment."""

    tm: int = 0
    fiducialsList: Seq[FiducialInfo] = EMPTY


@record
class FiducialFOV:
    """Field of view of a marker detector: m, rad."""

    minRange: f64 = 0.0
    maxRange: f64 = 0.0
    viewAngle: f64 = 0.0


@record
class GPSTime:
    """Time of the satellites. `msec` has microseconds, whatever its name says: OpenRTM documents it so."""

    sec: u32 = 0
    msec: u32 = 0


class GPSFixType(IntEnum):
    """Quality of a position fix."""

    GPS_FIX_NONE = 0
    GPS_FIX_NORMAL = 1
    GPS_FIX_DGPS = 2


@record
class GPSData(Stamped):
    """A position fix.

    Latitude and longitude in deg, altitude above the ellipsoid in m, errors as 1 sigma in m, heading in rad from true
    north, speeds in m/s.
    """

    tm: int = 0
    timeFromGPS: GPSTime = GPSTime()
    latitude: f64 = 0.0
    longitude: f64 = 0.0
    altitude: f64 = 0.0
    horizontalError: f64 = 0.0
    verticalError: f64 = 0.0
    heading: f64 = 0.0
    horizontalSpeed: f64 = 0.0
    verticalSpeed: f64 = 0.0
    numSatellites: u16 = 0
    fixType: GPSFixType = GPSFixType.GPS_FIX_NONE


class GripperStatus(IntEnum):
    """The activity of a gripper."""

    GRIPPER_STATE_OPEN = 0
    GRIPPER_STATE_CLOSED = 1
    GRIPPER_STATE_MOVING = 2
    GRIPPER_STATE_UNKNOWN = 3


@record
class GripperState(Stamped):
    """State of a gripper."""

    tm: int = 0
    status: GripperStatus = GripperStatus.GRIPPER_STATE_OPEN


@record
class GripperGeometry:
    """The outside (in the parent's frame) and the inside (in its own frame) of the open gripper."""

    exterior: Geometry3D = Geometry3D()
    interior: Geometry3D = Geometry3D()


@record
class INSData(Stamped):
    """Inertial navigation: deg, m; velocity east, north, up in m/s; orientation in rad with 0 = east."""

    tm: int = 0
    latitude: f64 = 0.0
    longitude: f64 = 0.0
    altitude: f64 = 0.0
    heightAMSL: f64 = 0.0
    velocityENU: Velocity3D = Velocity3D()
    orientation: Orientation3D = Orientation3D()


class LimbStatus(IntEnum):
    """The activity of a limb; OOR = out of reach."""

    LIMB_STATUS_IDLE = 0
    LIMB_STATUS_BRAKED = 1
    LIMB_STATUS_MOVING = 2
    LIMB_STATUS_OOR = 3
    LIMB_STATUS_COLLISION = 4


@record
class LimbState(Stamped):
    """State of a limb: the pose of its end."""

    tm: int = 0
    oapMatrix: OAP = OAP()
    status: LimbStatus = LimbStatus.LIMB_STATUS_IDLE


@record
class Hypothesis2D:
    """One of several possible poses, with the weight of its mixture."""

    mean: Pose2D = Pose2D()
    covariance: Covariance2D = Covariance2D()
    weight: f64 = 0.0


@record
class Hypotheses2D(Stamped):
    """All poses that are possible at one moment."""

    tm: int = 0
    hypotheses: Rows[Hypothesis2D] = EMPTY


@record
class Hypothesis3D:
    """One of several possible poses in space, with the weight of its mixture."""

    mean: Pose3D = Pose3D()
    covariance: Covariance3D = Covariance3D()
    weight: f64 = 0.0


@record
class Hypotheses3D(Stamped):
    """All poses in space that are possible at one moment."""

    tm: int = 0
    hypotheses: Rows[Hypothesis3D] = EMPTY


@record
class OGMapConfig:
    """An occupancy grid: m per cell, number of cells, pose of cell (0, 0)."""

    xScale: f64 = 0.0
    yScale: f64 = 0.0
    width: u32 = 0
    height: u32 = 0
    origin: Pose2D = Pose2D()


@record
class OGMapTile:
    """A part of an occupancy grid, cells row by row."""

    column: u32 = 0
    row: u32 = 0
    width: u32 = 0
    height: u32 = 0
    cells: Array[u8] = EMPTY


@record
class PointFeature:
    """A point found in the plane."""

    probability: f64 = 0.0
    position: Point2D = Point2D()
    covariance: PointCovariance2D = PointCovariance2D()


@record
class PoseFeature:
    """A pose found in the plane."""

    probability: f64 = 0.0
    position: Pose2D = Pose2D()
    covariance: Covariance2D = Covariance2D()


@record
class LineFeature:
    """A line found in the plane, distance rho and angle alpha with their covariance.

    `Sighted` tells whether that end of the line was seen.
    """

    probability: f64 = 0.0
    rho: f64 = 0.0
    alpha: f64 = 0.0
    covariance: PointCovariance2D = PointCovariance2D()
    start: Point2D = Point2D()
    end: Point2D = Point2D()
    startSighted: bool = False
    endSighted: bool = False


@record
class Features(Stamped):
    """All features found at one moment."""

    tm: int = 0
    pointFeatures: Rows[PointFeature] = EMPTY
    poseFeatures: Rows[PoseFeature] = EMPTY
    lineFeatures: Seq[LineFeature] = EMPTY


@record
class MultiCameraImages(Stamped):
    """One image of each camera."""

    tm: int = 0
    images: Seq[CameraImage] = EMPTY


@record
class MulticameraGeometry:
    """The places of the cameras (OpenRTM spells it with a small c)."""

    geometry: Geometry3D = Geometry3D()
    cameraGeometries: Rows[Geometry3D] = EMPTY


@record
class Waypoint2D:
    """A pose to pass: tolerances in m and rad, the time to be there, the greatest speed."""

    target: Pose2D = Pose2D()
    distanceTolerance: f64 = 0.0
    headingTolerance: f64 = 0.0
    timeLimit: Time = Time()
    maxSpeed: Velocity2D = Velocity2D()


@record
class Path2D(Stamped):
    """A way through the plane."""

    tm: int = 0
    waypoints: Seq[Waypoint2D] = EMPTY


@record
class Waypoint3D:
    """A pose in space to pass: tolerances in m and rad, the time to be there, the greatest speed."""

    target: Pose3D = Pose3D()
    distanceTolerance: f64 = 0.0
    headingTolerance: f64 = 0.0
    timeLimit: Time = Time()
    maxSpeed: Velocity3D = Velocity3D()


@record
class Path3D(Stamped):
    """A way through space."""

    tm: int = 0
    waypoints: Seq[Waypoint3D] = EMPTY


@record
class PointCloudPoint:
    """A point with its colour."""

    point: Point3D = Point3D()
    colour: RGBColour = RGBColour()


@record
class PointCloud(Stamped):
    """Points as one array of six columns (x, y, z, r, g, b), whose items are read as records."""

    tm: int = 0
    points: Rows[PointCloudPoint] = EMPTY


@record
class PanTiltAngles(Stamped):
    """Angles of a pan-tilt unit, rad."""

    tm: int = 0
    pan: f64 = 0.0
    tilt: f64 = 0.0


@record
class PanTiltState(Stamped):
    """Angles (with a time stamp of their own) in rad and speeds in rad/s of a pan-tilt unit."""

    tm: int = 0
    angles: PanTiltAngles = PanTiltAngles()
    panSpeed: f64 = 0.0
    tiltSpeed: f64 = 0.0


@record
class RangerGeometry:
    """The places of a range finder and its elements."""

    geometry: Geometry3D = Geometry3D()
    elementGeometries: Rows[Geometry3D] = EMPTY


@record
class RangerConfig:
    """Settings of a range finder: rad, m, Hz."""

    minAngle: f64 = 0.0
    maxAngle: f64 = 0.0
    angularRes: f64 = 0.0
    minRange: f64 = 0.0
    maxRange: f64 = 0.0
    rangeRes: f64 = 0.0
    frequency: f64 = 0.0


@record
class RangeData(Stamped):
    """The ranges of one scan, in m, with the geometry and settings of the scanner."""

    tm: int = 0
    ranges: Array[f64] = EMPTY
    geometry: RangerGeometry = zero(RangerGeometry)
    config: RangerConfig = RangerConfig()


@record
class IntensityData(Stamped):
    """The intensities of one scan, 0..1, with the geometry and settings of the scanner."""

    tm: int = 0
    intensities: Array[f64] = EMPTY
    geometry: RangerGeometry = zero(RangerGeometry)
    config: RangerConfig = RangerConfig()
