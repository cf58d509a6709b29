"""Every record of OpenRTM exists, as a frozen, slotted, checked value."""

from __future__ import annotations

# ruff: noqa: E501 - the table reads better with one record on a line
import copy
import dataclasses
import inspect
import subprocess
import sys
import timeit
from typing import Any

import numpy as np
import pytest

import aiorts.types as types
from aiorts.errors import DeclarationError, RecordError
from aiorts.types import (
    Array,
    PointCloud,
    Pose2D,
    Time,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedPose2D,
    TimedStringSeq,
    all_types,
    f64,
    fields_of,
    find_type,
    record,
    with_tm,
)
from each import each

# The records and enumerations of OpenRTM in short form: name, then `field:kind` in order; `t` is the time stamp, no kind is f64.
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


TABLE = records()


@pytest.mark.row(62)
def test_openrtm_has_126_records_and_5_enums() -> None:
    assert len(TABLE) == 126
    assert len(ENUMS) == 5
    own = {name for name in all_types() if name.startswith("aiorts.types.")}
    extra = {f"aiorts.types.{name}" for name in types.extra.__all__}
    assert own == {f"aiorts.types.{name}" for name in (*TABLE, *ENUMS)} | extra


@pytest.mark.row(62)
@each(TABLE)
def test_record_is_found_by_name_and_has_the_fields_of_the_idl(name: str) -> None:
    cls = find_type(name)
    assert [(field.name, field.spelling) for field in fields_of(cls)] == TABLE[name]
    assert getattr(types, name) is cls
    zero = cls()
    assert zero == cls()
    assert [field.name for field in dataclasses.fields(zero)] == [name for name, _ in TABLE[name]]
    assert not hasattr(zero, "__dict__")
    assert inspect.getdoc(cls)


@pytest.mark.row(62)
@each(ENUMS)
def test_enum_is_found_by_name_and_has_the_members_of_the_idl(name: str) -> None:
    prefix, members = ENUMS[name]
    cls: Any = find_type(name)
    assert [(member.name, member.value) for member in cls] == [(prefix + m, i) for i, m in enumerate(members.split())]


@each(TABLE)
def test_assignment_is_refused_and_names_the_field(name: str) -> None:
    sample = find_type(name)()
    for field, _ in TABLE[name]:
        with pytest.raises(dataclasses.FrozenInstanceError, match=rf"{name}\.{field}"):
            setattr(sample, field, 1)
        with pytest.raises(AttributeError, match=rf"{name}\.{field}"):
            delattr(sample, field)


def test_record_takes_positions_keywords_and_defaults() -> None:
    assert TimedDouble(1, 2.0) == TimedDouble(tm=1, data=2.0) == TimedDouble(1, data=2.0)
    assert TimedDouble().data == 0.0
    assert TimedDouble(data=3.0) == TimedDouble(0, 3.0)
    assert str(inspect.signature(TimedDouble)).startswith("(tm")
    for call in (lambda: TimedDouble(1, 2.0, 3), lambda: TimedDouble(tim=1)):
        with pytest.raises(TypeError, match="TimedDouble"):
            call()  # type: ignore[no-untyped-call]


def test_record_of_many_fields_takes_positions_keywords_and_defaults() -> None:
    cls: Any = find_type("Covariance3D")
    assert cls(1.0, aa=2.0).xx == 1.0
    assert cls(1.0, aa=2.0).aa == 2.0
    assert len(inspect.signature(cls).parameters) == 21
    for call in (lambda: cls(*[0.0] * 22), lambda: cls(1.0, xx=2.0), lambda: cls(qq=1.0)):
        with pytest.raises(TypeError, match="Covariance3D"):
            call()


def test_record_works_with_dataclasses_copy_match_and_hash() -> None:
    sample = TimedPose2D(5, Pose2D(heading=0.5))
    assert dataclasses.is_dataclass(sample)
    assert dataclasses.replace(sample, tm=6) == with_tm(sample, 6) == TimedPose2D(6, Pose2D(heading=0.5))
    assert copy.copy(sample) is sample
    assert copy.deepcopy(sample) is sample
    assert dataclasses.asdict(sample) == {"tm": 5, "data": {"position": {"x": 0.0, "y": 0.0}, "heading": 0.5}}
    assert len({sample, TimedPose2D(5, Pose2D(heading=0.5))}) == 1
    assert len({TimedDouble(0, float("nan")), TimedDouble(0, float("nan"))}) == 1
    match sample:
        case TimedPose2D(tm, Pose2D(_, heading)):
            assert (tm, heading) == (5, 0.5)
        case _:
            pytest.fail("did not match")
    with pytest.raises(TypeError):
        hash(TimedDoubleSeq(0, [1.0]))
    assert repr(sample) == "TimedPose2D(tm=5, data=Pose2D(position=Point2D(x=0.0, y=0.0), heading=0.5))"
    assert "100 in all" in repr(TimedDoubleSeq(0, np.zeros(100)))


def test_records_are_equal_when_their_values_are() -> None:
    nan = float("nan")
    assert TimedDouble(1, nan) == TimedDouble(1, nan)
    assert TimedDoubleSeq(1, [nan, 1.0]) == TimedDoubleSeq(1, [nan, 1.0])
    assert TimedDoubleSeq(1, [1.0]) != TimedDoubleSeq(1, [2.0])
    assert TimedDouble(1, 1.0) != TimedLong(1, 1)
    assert PointCloud(0, np.zeros((2, 6))) != PointCloud(0, np.zeros((3, 6)))


@pytest.mark.fault("B18")
@pytest.mark.parametrize("tm", [-1, 2**32 * 10**9, 1.5, None, True, "0"])
def test_time_stamp_out_of_range_or_of_wrong_type_is_refused(tm: Any) -> None:
    with pytest.raises(RecordError, match=r"TimedDouble\.tm: expected nanoseconds"):
        TimedDouble(tm, 1.0)
    with pytest.raises(RecordError, match=r"TimedDouble\.tm"):
        with_tm(TimedDouble(0, 1.0), tm)


@pytest.mark.fault("B18")
def test_time_is_normalised_and_never_wraps() -> None:
    for sec, nsec in ((0, 10**9), (-1, 0), (0, -1), (2**32, 0)):
        with pytest.raises(RecordError, match=r"Time\."):
            Time(sec, nsec)
    last = 2**32 * 10**9 - 1
    assert TimedDouble(last, 1.0).tm == last
    assert (TimedDouble(last).sec, TimedDouble(last).nsec) == (2**32 - 1, 999_999_999)
    assert TimedDouble(Time(3, 7), 1.0).tm == 3_000_000_007  # type: ignore[arg-type]
    later, earlier = Time.from_seconds(5.25), Time(5)
    assert later - earlier == 250_000_000
    assert earlier + 250_000_000 == later
    assert earlier < later
    assert Time.from_ns(later.ns) == later
    with pytest.raises(RecordError):
        Time() + -1
    assert with_tm(with_tm(TimedDouble(9, 1.0), 5), 9) == TimedDouble(9, 1.0)  # going back is the writer's right


def test_own_record_is_checked_like_any_other() -> None:
    @record
    class Base:
        tm: int = 0
        name: str = ""

        def loud(self) -> str:
            return self.name.upper()

    @record
    class Derived(Base):
        values: Array[f64] = types.EMPTY
        gain: f64 = 1.0

        def __post_init__(self) -> None:
            if self.gain < 0:
                raise RecordError(f"Derived.gain: expected 0 or more, got {self.gain}")

        def loud(self) -> str:
            return super().loud() + "!"

    sample = Derived(1, "a", [1.0, 2.0], 3.0)
    assert sample.loud() == "A!"
    assert isinstance(sample, Base)
    assert not sample.values.flags.writeable
    with pytest.raises(RecordError, match=r"Derived\.gain: expected 0 or more, got -1\.0"):
        Derived(gain=-1.0)
    with pytest.raises(DeclarationError, match=r"Wrong\.count: expected an integer .* as its default"):

        @record
        class Wrong:
            count: types.u8 = 300


def test_sequence_items_are_checked_and_named() -> None:
    assert TimedStringSeq(0, ["a", "b"]).data == ("a", "b")
    with pytest.raises(RecordError, match=r"TimedStringSeq\.data\[1\]: expected text, got 2"):
        TimedStringSeq(0, ["a", 2])  # type: ignore[list-item]
    with pytest.raises(RecordError, match=r"TimedStringSeq\.data: expected a sequence of str, got 'ab'"):
        TimedStringSeq(0, "ab")


@pytest.mark.slow(kept_by="cli/test_run.py::test_help_and_version_are_fast_and_load_no_system")
def test_importing_types_and_wire_loads_neither_numpy_nor_uvloop() -> None:
    code = "import sys, aiorts.types, aiorts.wire; print('numpy' in sys.modules, 'uvloop' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=100)
    assert done.stdout.split() == ["False", "False"], done.stdout


@pytest.mark.slow
def test_creating_a_checked_record_costs_at_most_four_plain_ones() -> None:
    class Plain:
        __slots__ = ("data", "tm")

        def __init__(self, tm: int, data: float) -> None:
            self.tm = tm
            self.data = data

    def cost(cls: Any) -> float:
        return min(timeit.repeat(lambda: cls(5, 1.0), number=5000, repeat=7))

    assert min(cost(TimedDouble) / cost(Plain) for _ in range(5)) < 4
