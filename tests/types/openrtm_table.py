"""The records and enumerations of OpenRTM in short form: name, then `field:kind` in order. `t` is the time stamp."""

from __future__ import annotations

BASIC = {
    "State": "i16", "Short": "i16", "Long": "i32", "UShort": "u16", "ULong": "u32", "Float": "f32", "Double": "f64",
    "Char": "char", "WChar": "wchar", "Boolean": "bool", "Octet": "u8", "String": "str", "WString": "str",
}  # fmt: skip

PLAIN = """
RGBColour r g b
Point2D x y
Vector2D x y
Pose2D position:Point2D heading
Velocity2D vx vy va
Acceleration2D ax ay
PoseVel2D pose:Pose2D velocities:Velocity2D
Size2D l w
Geometry2D pose:Pose2D size:Size2D
Covariance2D xx xy xt yy yt tt
PointCovariance2D xx xy yy
Carlike speed steeringAngle
SpeedHeading2D speed heading
Point3D x y z
Vector3D x y z
Orientation3D r p y
Pose3D position:Point3D orientation:Orientation3D
Velocity3D vx vy vz vr vp va
AngularVelocity3D avx avy avz
Acceleration3D ax ay az
AngularAcceleration3D aax aay aaz
PoseVel3D pose:Pose3D velocities:Velocity3D
Size3D l w h
Geometry3D pose:Pose3D size:Size3D
Covariance3D xx xy xz xr xp xa yy yz yr yp ya zz zr zp za rr rp ra pp pa aa
SpeedHeading3D speed direction:Orientation3D
OAP orientation:Vector3D approach:Vector3D position:Vector3D
Quaternion x y z w
"""

INTERFACE = """
ActArrayActuatorPos t index:u16 position
ActArrayActuatorSpeed t index:u16 speed
ActArrayActuatorCurrent t index:u16 current
Actuator position speed accel current status:ActArrayActuatorStatus
ActArrayState t actuators:seq[Actuator]
ActArrayActuatorGeometry type:ActArrayActuatorType length orientation:Orientation3D axis:Vector3D minRange centre maxRange homePosition hasBrakes:bool
ActArrayGeometry arrayGeometry:Geometry3D actuatorGeometry:seq[ActArrayActuatorGeometry]
BumperGeometry pose:Pose3D size:Size3D roc
BumperArrayGeometry arrayGeometry:Geometry3D bumperGeometry:seq[BumperGeometry]
CameraImage t width:u16 height:u16 bpp:u16 format:str fDiv pixels:seq[u8]
CameraInfo focalLength:Vector2D principalPoint:Point2D k1 k2 p1 p2
FiducialInfo id:u32 pose:Pose3D poseUncertainty:Pose3D size:Size3D sizeUncertainty:Size3D
Fiducials t fiducialsList:seq[FiducialInfo]
FiducialFOV minRange maxRange viewAngle
GPSTime sec:u32 msec:u32
GPSData t timeFromGPS:GPSTime latitude longitude altitude horizontalError verticalError heading horizontalSpeed verticalSpeed numSatellites:u16 fixType:GPSFixType
GripperState t status:GripperStatus
GripperGeometry exterior:Geometry3D interior:Geometry3D
INSData t latitude longitude altitude heightAMSL velocityENU:Velocity3D orientation:Orientation3D
LimbState t oapMatrix:OAP status:LimbStatus
Hypothesis2D mean:Pose2D covariance:Covariance2D weight
Hypotheses2D t hypotheses:seq[Hypothesis2D]
Hypothesis3D mean:Pose3D covariance:Covariance3D weight
Hypotheses3D t hypotheses:seq[Hypothesis3D]
OGMapConfig xScale yScale width:u32 height:u32 origin:Pose2D
OGMapTile column:u32 row:u32 width:u32 height:u32 cells:seq[u8]
PointFeature probability position:Point2D covariance:PointCovariance2D
PoseFeature probability position:Pose2D covariance:Covariance2D
LineFeature probability rho alpha covariance:PointCovariance2D start:Point2D end:Point2D startSighted:bool endSighted:bool
Features t pointFeatures:seq[PointFeature] poseFeatures:seq[PoseFeature] lineFeatures:seq[LineFeature]
MultiCameraImages t images:seq[CameraImage]
MulticameraGeometry geometry:Geometry3D cameraGeometries:seq[Geometry3D]
Waypoint2D target:Pose2D distanceTolerance headingTolerance timeLimit:Time maxSpeed:Velocity2D
Path2D t waypoints:seq[Waypoint2D]
Waypoint3D target:Pose3D distanceTolerance headingTolerance timeLimit:Time maxSpeed:Velocity3D
Path3D t waypoints:seq[Waypoint3D]
PointCloudPoint point:Point3D colour:RGBColour
PointCloud t points:seq[PointCloudPoint]
PanTiltAngles t pan tilt
PanTiltState t angles:PanTiltAngles panSpeed tiltSpeed
RangerGeometry geometry:Geometry3D elementGeometries:seq[Geometry3D]
RangerConfig minAngle maxAngle angularRes minRange maxRange rangeRes frequency
RangeData t ranges:seq[f64] geometry:RangerGeometry config:RangerConfig
IntensityData t intensities:seq[f64] geometry:RangerGeometry config:RangerConfig
"""

ENUMS = {
    "ActArrayActuatorStatus": ("ACTUATOR_STATUS_", "IDLE MOVING BRAKED STALLED"),
    "ActArrayActuatorType": ("ACTARRAY_ACTUATORTYPE_", "LINEAR ROTARY"),
    "GPSFixType": ("GPS_FIX_", "NONE NORMAL DGPS"),
    "GripperStatus": ("GRIPPER_STATE_", "OPEN CLOSED MOVING UNKNOWN"),
    "LimbStatus": ("LIMB_STATUS_", "IDLE BRAKED MOVING OOR COLLISION"),
}


def records() -> dict[str, list[tuple[str, str]]]:
    """Name -> (field, kind), all 126."""
    table: dict[str, list[tuple[str, str]]] = {"Time": [("sec", "u32"), ("nsec", "u32")]}
    for name, kind in BASIC.items():
        table[f"Timed{name}"] = [("tm", "stamp"), ("data", kind)]
        if name != "State":
            table[f"Timed{name}Seq"] = [("tm", "stamp"), ("data", f"seq[{kind}]")]
    for line in PLAIN.split("\n")[1:-1]:
        name, *fields = line.split()
        table[name] = [_field(field) for field in fields]
        table[f"Timed{name}"] = [("tm", "stamp"), ("data", name)]
    for line in INTERFACE.split("\n")[1:-1]:
        name, *fields = line.split()
        table[name] = [_field(field) for field in fields]
    return table


def _field(text: str) -> tuple[str, str]:
    if text == "t":
        return "tm", "stamp"
    name, _, kind = text.partition(":")
    return name, kind or "f64"
