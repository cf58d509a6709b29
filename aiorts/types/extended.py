"""The 28 geometric records of OpenRTM, and the same with a time stamp.

Lengths are in m, angles in rad, velocities in m/s and rad/s, accelerations in m/s2 and rad/s2. All fields are 0 by
default.
"""

from __future__ import annotations

# Annotations are read at run time, and names are those of the IDL.
# ruff: noqa: E741, N815
from aiorts.types.record import Stamped, record
from aiorts.types.spelling import f64

__all__ = (
    "RGBColour",
    "Point2D",
    "Vector2D",
    "Pose2D",
    "Velocity2D",
    "Acceleration2D",
    "PoseVel2D",
    "Size2D",
    "Geometry2D",
    "Covariance2D",
    "PointCovariance2D",
    "Carlike",
    "SpeedHeading2D",
    "Point3D",
    "Vector3D",
    "Orientation3D",
    "Pose3D",
    "Velocity3D",
    "AngularVelocity3D",
    "Acceleration3D",
    "AngularAcceleration3D",
    "PoseVel3D",
    "Size3D",
    "Geometry3D",
    "Covariance3D",
    "SpeedHeading3D",
    "OAP",
    "Quaternion",
    "TimedRGBColour",
    "TimedPoint2D",
    "TimedVector2D",
    "TimedPose2D",
    "TimedVelocity2D",
    "TimedAcceleration2D",
    "TimedPoseVel2D",
    "TimedSize2D",
    "TimedGeometry2D",
    "TimedCovariance2D",
    "TimedPointCovariance2D",
    "TimedCarlike",
    "TimedSpeedHeading2D",
    "TimedPoint3D",
    "TimedVector3D",
    "TimedOrientation3D",
    "TimedPose3D",
    "TimedVelocity3D",
    "TimedAngularVelocity3D",
    "TimedAcceleration3D",
    "TimedAngularAcceleration3D",
    "TimedPoseVel3D",
    "TimedSize3D",
    "TimedGeometry3D",
    "TimedCovariance3D",
    "TimedSpeedHeading3D",
    "TimedOAP",
    "TimedQuaternion",
)


@record
class RGBColour:
    """A colour, each part 0..1."""

    r: f64 = 0.0
    g: f64 = 0.0
    b: f64 = 0.0


@record
class Point2D:
    """A place in the plane, m."""

    x: f64 = 0.0
    y: f64 = 0.0


@record
class Vector2D:
    """A vector in the plane."""

    x: f64 = 0.0
    y: f64 = 0.0


@record
class Pose2D:
    """Place and heading in the plane, m and rad."""

    position: Point2D = Point2D()
    heading: f64 = 0.0


@record
class Velocity2D:
    """Velocity in the plane: vx, vy in m/s, va in rad/s."""

    vx: f64 = 0.0
    vy: f64 = 0.0
    va: f64 = 0.0


@record
class Acceleration2D:
    """Acceleration in the plane, m/s2."""

    ax: f64 = 0.0
    ay: f64 = 0.0


@record
class PoseVel2D:
    """Pose and velocity in the plane."""

    pose: Pose2D = Pose2D()
    velocities: Velocity2D = Velocity2D()


@record
class Size2D:
    """Length and width, m."""

    l: f64 = 0.0
    w: f64 = 0.0


@record
class Geometry2D:
    """Pose and size of a body in the plane."""

    pose: Pose2D = Pose2D()
    size: Size2D = Size2D()


@record
class Covariance2D:
    """Upper triangle of the covariance of (x, y, heading)."""

    xx: f64 = 0.0
    xy: f64 = 0.0
    xt: f64 = 0.0
    yy: f64 = 0.0
    yt: f64 = 0.0
    tt: f64 = 0.0


@record
class PointCovariance2D:
    """Upper triangle of the covariance of (x, y)."""

    xx: f64 = 0.0
    xy: f64 = 0.0
    yy: f64 = 0.0


@record
class Carlike:
    """Command of a car-like vehicle: m/s and rad."""

    speed: f64 = 0.0
    steeringAngle: f64 = 0.0


@record
class SpeedHeading2D:
    """Speed and heading in the plane: m/s and rad."""

    speed: f64 = 0.0
    heading: f64 = 0.0


@record
class Point3D:
    """A place in space, m."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@record
class Vector3D:
    """A vector in space."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0


@record
class Orientation3D:
    """Roll, pitch and yaw (r, p, y), rad."""

    r: f64 = 0.0
    p: f64 = 0.0
    y: f64 = 0.0


@record
class Pose3D:
    """Place and orientation in space, m and rad."""

    position: Point3D = Point3D()
    orientation: Orientation3D = Orientation3D()


@record
class Velocity3D:
    """Velocity in space: vx, vy, vz in m/s; vr, vp, va (yaw) in rad/s."""

    vx: f64 = 0.0
    vy: f64 = 0.0
    vz: f64 = 0.0
    vr: f64 = 0.0
    vp: f64 = 0.0
    va: f64 = 0.0


@record
class AngularVelocity3D:
    """Rates of turn about x, y, z, rad/s."""

    avx: f64 = 0.0
    avy: f64 = 0.0
    avz: f64 = 0.0


@record
class Acceleration3D:
    """Acceleration in space, m/s2."""

    ax: f64 = 0.0
    ay: f64 = 0.0
    az: f64 = 0.0


@record
class AngularAcceleration3D:
    """Angular acceleration about x, y, z, rad/s2."""

    aax: f64 = 0.0
    aay: f64 = 0.0
    aaz: f64 = 0.0


@record
class PoseVel3D:
    """Pose and velocity in space."""

    pose: Pose3D = Pose3D()
    velocities: Velocity3D = Velocity3D()


@record
class Size3D:
    """Length, width and height, m."""

    l: f64 = 0.0
    w: f64 = 0.0
    h: f64 = 0.0


@record
class Geometry3D:
    """Pose and size of a body in space."""

    pose: Pose3D = Pose3D()
    size: Size3D = Size3D()


@record
class Covariance3D:
    """Upper triangle of the covariance of (x, y, z, roll, pitch, yaw), row by row."""

    xx: f64 = 0.0
    xy: f64 = 0.0
    xz: f64 = 0.0
    xr: f64 = 0.0
    xp: f64 = 0.0
    xa: f64 = 0.0
    yy: f64 = 0.0
    yz: f64 = 0.0
    yr: f64 = 0.0
    yp: f64 = 0.0
    ya: f64 = 0.0
    zz: f64 = 0.0
    zr: f64 = 0.0
    zp: f64 = 0.0
    za: f64 = 0.0
    rr: f64 = 0.0
    rp: f64 = 0.0
    ra: f64 = 0.0
    pp: f64 = 0.0
    pa: f64 = 0.0
    aa: f64 = 0.0


@record
class SpeedHeading3D:
    """Speed in m/s and its direction in rad."""

    speed: f64 = 0.0
    direction: Orientation3D = Orientation3D()


@record
class OAP:
    """Orientation, approach and position vectors of a gripper."""

    orientation: Vector3D = Vector3D()
    approach: Vector3D = Vector3D()
    position: Vector3D = Vector3D()


@record
class Quaternion:
    """A rotation; all zero until it is set, as in OpenRTM."""

    x: f64 = 0.0
    y: f64 = 0.0
    z: f64 = 0.0
    w: f64 = 0.0


@record
class TimedRGBColour(Stamped):
    """RGBColour with a time stamp."""

    tm: int = 0
    data: RGBColour = RGBColour()


@record
class TimedPoint2D(Stamped):
    """Point2D with a time stamp."""

    tm: int = 0
    data: Point2D = Point2D()


@record
class TimedVector2D(Stamped):
    """Vector2D with a time stamp."""

    tm: int = 0
    data: Vector2D = Vector2D()


@record
class TimedPose2D(Stamped):
    """Pose2D with a time stamp."""

    tm: int = 0
    data: Pose2D = Pose2D()


@record
class TimedVelocity2D(Stamped):
    """Velocity2D with a time stamp."""

    tm: int = 0
    data: Velocity2D = Velocity2D()


@record
class TimedAcceleration2D(Stamped):
    """Acceleration2D with a time stamp."""

    tm: int = 0
    data: Acceleration2D = Acceleration2D()


@record
class TimedPoseVel2D(Stamped):
    """PoseVel2D with a time stamp."""

    tm: int = 0
    data: PoseVel2D = PoseVel2D()


@record
class TimedSize2D(Stamped):
    """Size2D with a time stamp."""

    tm: int = 0
    data: Size2D = Size2D()


@record
class TimedGeometry2D(Stamped):
    """Geometry2D with a time stamp."""

    tm: int = 0
    data: Geometry2D = Geometry2D()


@record
class TimedCovariance2D(Stamped):
    """Covariance2D with a time stamp."""

    tm: int = 0
    data: Covariance2D = Covariance2D()


@record
class TimedPointCovariance2D(Stamped):
    """PointCovariance2D with a time stamp."""

    tm: int = 0
    data: PointCovariance2D = PointCovariance2D()


@record
class TimedCarlike(Stamped):
    """Carlike with a time stamp."""

    tm: int = 0
    data: Carlike = Carlike()


@record
class TimedSpeedHeading2D(Stamped):
    """SpeedHeading2D with a time stamp."""

    tm: int = 0
    data: SpeedHeading2D = SpeedHeading2D()


@record
class TimedPoint3D(Stamped):
    """Point3D with a time stamp."""

    tm: int = 0
    data: Point3D = Point3D()


@record
class TimedVector3D(Stamped):
    """Vector3D with a time stamp."""

    tm: int = 0
    data: Vector3D = Vector3D()


@record
class TimedOrientation3D(Stamped):
    """Orientation3D with a time stamp."""

    tm: int = 0
    data: Orientation3D = Orientation3D()


@record
class TimedPose3D(Stamped):
    """Pose3D with a time stamp."""

    tm: int = 0
    data: Pose3D = Pose3D()


@record
class TimedVelocity3D(Stamped):
    """Velocity3D with a time stamp."""

    tm: int = 0
    data: Velocity3D = Velocity3D()


@record
class TimedAngularVelocity3D(Stamped):
    """AngularVelocity3D with a time stamp."""

    tm: int = 0
    data: AngularVelocity3D = AngularVelocity3D()


@record
class TimedAcceleration3D(Stamped):
    """Acceleration3D with a time stamp."""

    tm: int = 0
    data: Acceleration3D = Acceleration3D()


@record
class TimedAngularAcceleration3D(Stamped):
    """AngularAcceleration3D with a time stamp."""

    tm: int = 0
    data: AngularAcceleration3D = AngularAcceleration3D()


@record
class TimedPoseVel3D(Stamped):
    """PoseVel3D with a time stamp."""

    tm: int = 0
    data: PoseVel3D = PoseVel3D()


@record
class TimedSize3D(Stamped):
    """Size3D with a time stamp."""

    tm: int = 0
    data: Size3D = Size3D()


@record
class TimedGeometry3D(Stamped):
    """Geometry3D with a time stamp."""

    tm: int = 0
    data: Geometry3D = Geometry3D()


@record
class TimedCovariance3D(Stamped):
    """Covariance3D with a time stamp."""

    tm: int = 0
    data: Covariance3D = Covariance3D()


@record
class TimedSpeedHeading3D(Stamped):
    """SpeedHeading3D with a time stamp."""

    tm: int = 0
    data: SpeedHeading3D = SpeedHeading3D()


@record
class TimedOAP(Stamped):
    """OAP with a time stamp."""

    tm: int = 0
    data: OAP = OAP()


@record
class TimedQuaternion(Stamped):
    """Quaternion with a time stamp."""

    tm: int = 0
    data: Quaternion = Quaternion()
