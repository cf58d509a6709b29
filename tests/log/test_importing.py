"""What ROS 2 and others recorded becomes an ordinary recording: every value, and what is left out by name."""

from __future__ import annotations

import builtins
import io
import json
import math
import os
import random
import sqlite3
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aiorts.types as t
from aiorts.cli.app import run_command
from aiorts_log import RecordingError, RecordingReader
from aiorts_log.foreign.importing import MessageCounts, import_recording
from aiorts_log.foreign.ros import Messages
from foreign_parts import BEGIN, SECOND, bag, float64, mcap_file, old_bag, ros
from log_parts import make, read


def stamped(i: int, frame: str = "map") -> Any:
    return ros("std_msgs/Header", ros("builtin_interfaces/Time", 100 + i, 7), frame)


def vector(*values: float) -> Any:
    return ros("geometry_msgs/Vector3", *values)


def turn() -> Any:
    return ros("geometry_msgs/Quaternion", 0.0, 0.0, math.sin(0.25), math.cos(0.25))


MAKERS: dict[str, tuple[str, Any]] = {
    "/imu/data": (
        "sensor_msgs/Imu",
        lambda i: ros(
            *("sensor_msgs/Imu", stamped(i), turn(), np.arange(9.0) * i, vector(i / 3, 2.0, 3.0)),
            *(np.zeros(9), vector(-i / 7, 0.0, 9.81), np.full(9, 0.5)),
        ),
    ),
    "/cmd_vel": (
        "geometry_msgs/Twist",
        lambda i: ros("geometry_msgs/Twist", vector(i, 0.5, 0.0), vector(0.0, 0.0, -i)),
    ),
    "/speed": ("std_msgs/Float32", lambda i: ros("std_msgs/Float32", i / 3)),
    "/letter": ("std_msgs/Char", lambda i: ros("std_msgs/Char", 200 + i)),
    "/scan": (
        "sensor_msgs/LaserScan",
        lambda i: ros(
            *("sensor_msgs/LaserScan", stamped(i), -1.0, 1.0, 0.1, 0.0, 0.1, 0.0, 30.0),
            *(np.array([1.0, np.inf, i], "f4"), np.zeros(0, "f4")),
        ),
    ),
    "/joints": (
        "sensor_msgs/JointState",
        lambda i: ros("sensor_msgs/JointState", stamped(i), ["a", "ü"], np.array([i, 2.0]), np.zeros(0), np.zeros(2)),
    ),
    "/pose": (
        "geometry_msgs/PoseStamped",
        lambda i: ros(
            "geometry_msgs/PoseStamped",
            *(stamped(i), ros("geometry_msgs/Pose", ros("geometry_msgs/Point", 1.0, 2.0, float(i)), turn())),
        ),
    ),
    "/path": (
        "geometry_msgs/Polygon",
        lambda i: ros("geometry_msgs/Polygon", [ros("geometry_msgs/Point32", 0.5, float(k), 1.0) for k in range(i)]),
    ),
    "/point": (
        "trajectory_msgs/JointTrajectoryPoint",
        lambda i: ros(
            *("trajectory_msgs/JointTrajectoryPoint", np.zeros(0), np.zeros(0), np.zeros(0), np.array([1.0 * i])),
            ros("builtin_interfaces/Duration", -2, 500_000_000 + i),
        ),
    ),
    "/wait": ("builtin_interfaces/Duration", lambda i: ros("builtin_interfaces/Duration", -1 - i, 5)),
}


def ported(samples: list[tuple[str, int, Any]], name: str) -> list[Any]:
    return [record for port, _, record in samples if port == name]


@pytest.mark.slow(kept_by="test_json_of_others_arrives_and_what_does_not_is_named")
@pytest.mark.parametrize("kind", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("whole", [True, False], ids=["folder", "file"])
def test_every_value_of_a_ros_recording_arrives(tmp_path: Path, kind: str, whole: bool) -> None:
    source = bag(tmp_path / "bag", kind, MAKERS)
    if not whole:
        (source,) = (one for one in source.iterdir() if one.suffix != ".yaml")
    report = import_recording(source, tmp_path / "run.mcap", whole=False)
    assert (report.left, report.lost) == ({}, {})
    found = read(tmp_path / "run.mcap")
    four = range(4)
    at = [(100 + i) * SECOND + 7 for i in four]
    logged = [BEGIN + i * SECOND for i in four]
    zero = np.zeros(9)
    pose = t.Pose3D(t.Point3D(), t.Orientation3D())
    assert pose is not None
    expected: dict[str, list[Any]] = {
        "imu_data_orientation": [t.TimedQuaternion(at[i], t.Quaternion(0.0, 0.0, turn().z, turn().w)) for i in four],
        "imu_data_orientation_covariance": [t.TimedDoubleSeq(at[i], np.arange(9.0) * i) for i in four],
        "imu_data_angular_velocity": [
            t.TimedAngularVelocity3D(at[i], t.AngularVelocity3D(i / 3, 2.0, 3.0)) for i in four
        ],
        "imu_data_angular_velocity_covariance": [t.TimedDoubleSeq(at[i], zero) for i in four],
        "imu_data_linear_acceleration": [
            t.TimedAcceleration3D(at[i], t.Acceleration3D(-i / 7, 0.0, 9.81)) for i in four
        ],
        "imu_data_linear_acceleration_covariance": [t.TimedDoubleSeq(at[i], np.full(9, 0.5)) for i in four],
        "cmd_vel": [t.TimedVelocity3D(logged[i], t.Velocity3D(i, 0.5, 0.0, 0.0, 0.0, -i)) for i in four],
        "speed": [t.TimedFloat(logged[i], i / 3) for i in four],
        "letter": [t.TimedOctet(logged[i], 200 + i) for i in four],
        "scan_angle_min": [t.TimedFloat(at[i], -1.0) for i in four],
        "scan_angle_max": [t.TimedFloat(at[i], 1.0) for i in four],
        "scan_angle_increment": [t.TimedFloat(at[i], 0.1) for i in four],
        "scan_time_increment": [t.TimedFloat(at[i], 0.0) for i in four],
        "scan_scan_time": [t.TimedFloat(at[i], 0.1) for i in four],
        "scan_range_min": [t.TimedFloat(at[i], 0.0) for i in four],
        "scan_range_max": [t.TimedFloat(at[i], 30.0) for i in four],
        "scan_ranges": [t.TimedFloatSeq(at[i], [1.0, math.inf, i]) for i in four],
        "scan_intensities": [t.TimedFloatSeq(at[i], []) for i in four],
        "joints_name": [t.TimedStringSeq(at[i], ("a", "ü")) for i in four],
        "joints_position": [t.TimedDoubleSeq(at[i], [i, 2.0]) for i in four],
        "joints_velocity": [t.TimedDoubleSeq(at[i], []) for i in four],
        "joints_effort": [t.TimedDoubleSeq(at[i], [0.0, 0.0]) for i in four],
        "pose_pose_orientation": [t.TimedQuaternion(at[i], t.Quaternion(0.0, 0.0, turn().z, turn().w)) for i in four],
        "path_points_x": [t.TimedFloatSeq(logged[i], [0.5] * i) for i in four],
        "path_points_y": [t.TimedFloatSeq(logged[i], list(range(i))) for i in four],
        "path_points_z": [t.TimedFloatSeq(logged[i], [1.0] * i) for i in four],
        "point_positions": [t.TimedDoubleSeq(logged[i], []) for i in four],
        "point_velocities": [t.TimedDoubleSeq(logged[i], []) for i in four],
        "point_accelerations": [t.TimedDoubleSeq(logged[i], []) for i in four],
        "point_effort": [t.TimedDoubleSeq(logged[i], [i]) for i in four],
        "point_time_from_start": [t.TimedLongLong(logged[i], -1_500_000_000 + i) for i in four],
        "wait_sec": [t.TimedLong(logged[i], -1 - i) for i in four],
        "wait_nanosec": [t.TimedULong(logged[i], 5) for i in four],
    }
    for name, records in expected.items():
        assert ported(found, name) == records, name
    assert report.samples.keys() == {*expected, "pose_pose"}
    assert set(report.samples.values()) == {4}
    for i, one in enumerate(ported(found, "pose_pose")):
        assert one.data.position == t.Point3D(1.0, 2.0, float(i))
        assert (one.tm, one.data.orientation.r, one.data.orientation.p) == (at[i], 0.0, 0.0)
        assert one.data.orientation.y == pytest.approx(0.5, abs=1e-15)
    assert sorted({log_time for _, log_time, _ in found}) == logged
    with RecordingReader(tmp_path / "run.mcap") as reader:
        said = reader.ports["imu_data_orientation"].metadata
        assert said == {"topic": "/imu/data", "type": "sensor_msgs/msg/Imu", "field": "orientation", "frame_id": "map"}
        assert reader.clean
        assert not reader.check()
        assert all(not port.unknown for port in reader.ports.values())


@pytest.mark.slow
def test_angles_of_any_quaternion_are_those_of_its_turn() -> None:
    from aiorts_log.foreign.ros_types import PARTS

    chance = random.Random(1)
    angles = PARTS["geometry_msgs/msg/Pose"][0].get
    for _ in range(200):
        r, p, y = chance.uniform(-3.1, 3.1), chance.uniform(-1.5, 1.5), chance.uniform(-3.1, 3.1)
        cr, sr, cp, sp = math.cos(r / 2), math.sin(r / 2), math.cos(p / 2), math.sin(p / 2)
        cy, sy, length = math.cos(y / 2), math.sin(y / 2), chance.uniform(0.1, 10.0)
        q = (sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)
        quaternion = ros("geometry_msgs/Quaternion", *(length * one for one in (*q, cr * cp * cy + sr * sp * sy)))
        found = angles(ros("geometry_msgs/Pose", ros("geometry_msgs/Point", 0.0, 0.0, 0.0), quaternion)).orientation
        assert (found.r, found.p, found.y) == pytest.approx((r, p, y), abs=1e-6)
    zero = ros("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 0.0)
    assert angles(ros("geometry_msgs/Pose", ros("geometry_msgs/Point", 0.0, 0.0, 0.0), zero)).orientation == (
        t.Orientation3D()
    )


def test_a_bag_without_definitions_has_those_of_the_distribution_and_names_what_it_lacks(tmp_path: Path) -> None:
    rows = [
        (1, "/f", "std_msgs/msg/Float64", [(30, float64(3.0)), (10, float64(1.0)), (20, float64(2.0))]),
        (2, "/own", "my_msgs/msg/Thing", [(15, b"\0\1\0\0abcd")] * 3),
        (3, "/f_", "std_msgs/msg/Float64", [(12, float64(-1.0)), (13, b"\0\1\0\0abc")]),
    ]
    report = import_recording(old_bag(tmp_path / "old.db3", rows), tmp_path / "run.mcap")
    assert read(tmp_path / "run.mcap") == [
        ("f", 10, t.TimedDouble(10, 1.0)),
        ("f_2", 12, t.TimedDouble(12, -1.0)),
        ("f", 20, t.TimedDouble(20, 2.0)),
        ("f", 30, t.TimedDouble(30, 3.0)),
    ]
    why = "the file does not hold its definition; record it with ROS 2 Iron or later"
    assert report.left == {"/own": why}
    assert "/own" not in report.lost  # by its kind, which is no loss
    assert report.messages["/own"] == MessageCounts(read=3, left_out=3)
    assert report.messages["/f_"] == MessageCounts(read=2, taken=1, lost=1)
    assert sum(report.lost["/f_"].values()) == 1
    assert "no std_msgs/msg/Float64" in next(iter(report.lost["/f_"]))


def test_json_of_others_arrives_and_what_does_not_is_named(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"n": {"type": "integer"}, "x": {"type": "number"}}}
    documents = [
        {"timestamp": {"sec": 5, "nsec": 6}, "n": 2**60, "x": 1, "deep": {"flag": True, "list": [1, 2.5]}, "s": "ü"},
        {"n": 1.5, "x": "NaN", "deep": {"flag": 3, "list": ["a", 1]}, "s": None},
    ]
    path = mcap_file(
        tmp_path / "others.mcap",
        [
            (
                "/a",
                "json",
                "A",
                "jsonschema",
                json.dumps(schema),
                [(i, json.dumps(d).encode()) for i, d in enumerate(documents)],
            ),
            ("/b", "json", "", "", "", [(7, b"[1, 2]"), (8, b"nonsense")]),
            ("/c", "protobuf", "C", "protobuf", "x", [(9, b"\x08\x01")]),
        ],
    )
    report = import_recording(path, tmp_path / "run.mcap")
    found = read(tmp_path / "run.mcap")
    tm = 5 * SECOND + 6
    assert {name: ported(found, name) for name in report.samples} == {
        "a_timestamp_sec": [t.TimedDouble(tm, 5.0)],
        "a_timestamp_nsec": [t.TimedDouble(tm, 6.0)],
        "a_n": [t.TimedLongLong(tm, 2**60)],
        "a_x": [t.TimedDouble(tm, 1.0), t.TimedDouble(1, math.nan)],
        "a_deep_flag": [t.TimedBoolean(tm, True)],
        "a_deep_list": [t.TimedDoubleSeq(tm, [1.0, 2.5])],
        "a_s": [t.TimedString(tm, "ü")],
        "b_value": [t.TimedDoubleSeq(7, [1.0, 2.0])],
    }
    protobuf = "its messages are protobuf; only ROS 2 and JSON are read"
    assert report.left == {"/c": protobuf, "/a s": "null, which is no value, in some messages"}
    assert report.lost == {
        "/a n": {"values that are no integers of 64 bits": 1},
        "/a deep.flag": {"values that are no TimedBoolean, as the others are": 1},
        "/a deep.list": {"lists of what is neither all numbers, nor texts, nor truth values": 1},
        "/b": {"no JSON: JSONDecodeError": 1},
    }
    assert report.messages == {
        "/a": MessageCounts(read=2, taken=2),
        "/b": MessageCounts(read=2, taken=1, lost=1),
        "/c": MessageCounts(read=1, left_out=1),
    }


def test_the_reader_opens_recordings_of_others_and_tells_what_it_does_not_read(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "others.mcap", [("/c", "protobuf", "C", "protobuf", "x", [(9, b"\x08\x01")])])
    with RecordingReader(path) as reader:
        (sample,) = reader.samples()
        assert (sample.data, sample.port.plain(sample.data)["encoding"]) == (b"\x08\x01", "protobuf")
        assert sample.port.unknown == "its messages are protobuf, which are not read here"
        with pytest.raises(RecordingError, match="protobuf"):
            list(reader.records())


HOSTILE = {
    "a name with code in it": "float64 x;__import__('os').system('touch canary')",
    "a field that ends a text": "float64 x\\\");open('canary','w')#",
    "a type with code in it": "a/b\");open('canary','w')# x",
    "a keyword": "float64 class\nfloat64 __class__\nfloat64 import",
    "a list without end": "geometry_msgs/Point[900000000] x\n" + "=" * 80 + "\nMSG: geometry_msgs/Point\nfloat64 x",
    "a type within itself": "a/B x\n" + "=" * 80 + "\nMSG: a/B\na/B x",
    "texts without end": "string[100000000] x",
    "numbers without end": "float64[4000000000] x",
    "nothing": "",
    "no definition": "\0\0\0",
    "too long": "# " + "x" * 300_000,
}


@pytest.mark.fault("D12")
@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_definition_is_left_out_and_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    data = [(1, b"\0\1\0\0" + bytes(64))]
    good = ("/f", "cdr", "std_msgs/msg/Float64", "ros2msg", "float64 data", [(2, float64(1.0))])
    path = mcap_file(tmp_path / "evil.mcap", [("/evil", "cdr", "a/msg/A", "ros2msg", text, data), good])
    before, began = set(sys.modules), time.process_time()
    tracemalloc.start()
    try:
        report = import_recording(path, tmp_path / "run.mcap")
        assert tracemalloc.get_traced_memory()[1] < 32 * 2**20
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < 10.0
    assert report.samples.get("f") == 1
    assert not (tmp_path / "canary").exists()
    assert all(name.startswith(("rosbags", "numpy", "aiorts")) for name in set(sys.modules) - before if "evil" in name)
    if text not in (HOSTILE["a keyword"], HOSTILE["nothing"]):
        assert "/evil" in report.left


def test_values_of_constants_are_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = "string X=\"'); open('canary','w'); ('\"\nint32 Y=1\nfloat64 data"
    path = mcap_file(tmp_path / "a.mcap", [("/a", "cdr", "a/msg/A", "ros2msg", text, [(2, float64(1.5))])])
    assert Messages("a/msg/A", "ros2msg", text)._store.fielddefs["a/msg/A"][0] == []
    import_recording(path, tmp_path / "run.mcap")
    assert ported(read(tmp_path / "run.mcap"), "a") == [t.TimedDouble(2, 1.5)]
    assert not (tmp_path / "canary").exists()


@pytest.mark.slow
@pytest.mark.fault("D08")
def test_lengths_in_messages_that_cannot_be_take_no_memory(tmp_path: Path) -> None:
    text = "float64[] x\na/E[] e\nstring s\n" + "=" * 80 + "\nMSG: a/E\nuint8 x"
    full = b"\0\1\0\0" + b"\xff\xff\xff\xff" + bytes(60)
    path = mcap_file(
        tmp_path / "a.mcap", [("/a", "cdr", "a/msg/A", "ros2msg", text, [(2, full), (3, b""), (4, b"\0")])]
    )
    tracemalloc.start()
    try:
        report = import_recording(path, tmp_path / "run.mcap")
        assert tracemalloc.get_traced_memory()[1] < 32 * 2**20
    finally:
        tracemalloc.stop()
    assert sum(report.lost["/a"].values()) == 3
    assert report.samples == {}


YAML = {
    "tag": "a: !!python/object/apply:os.system ['touch canary']\n",
    "bomb": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{c}: &{c} [{','.join([f'*{p}'] * 9)}]\n" for p, c in zip("abcdefgh", "bcdefghi", strict=True)),
    "no": "rosbag2_bagfile_information: {relative_file_paths: no, version: no}\n",
    "twice": "rosbag2_bagfile_information: 1\nrosbag2_bagfile_information: {relative_file_paths: [../../etc/passwd]}\n",
    "fifo": "",
}


@pytest.mark.slow
@pytest.mark.fault("F02")
@pytest.mark.timeout(30)
@pytest.mark.parametrize("what", YAML)
def test_the_yaml_of_a_bag_is_not_read_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """Not even opened: a pipe that nobody writes into would hold whoever does forever."""
    monkeypatch.chdir(tmp_path)
    source = bag(tmp_path / "bag", "MCAP", {"/speed": MAKERS["/speed"]}, 2)
    said = source / "metadata.yaml"
    said.unlink()
    if what == "fifo":
        os.mkfifo(said)
    else:
        said.write_text(YAML[what])
    opened: list[str] = []
    genuine = builtins.open

    def watched(path: Any, *arguments: Any, **more: Any) -> Any:
        opened.append(str(path))
        return genuine(path, *arguments, **more)

    monkeypatch.setattr(builtins, "open", watched)
    tracemalloc.start()
    try:
        import_recording(source, tmp_path / "run.mcap")
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()
    assert not any(one.endswith(".yaml") for one in opened)
    assert not (tmp_path / "canary").exists()
    assert len(read(tmp_path / "run.mcap")) == 2


def refuse(source: Path, tmp_path: Path) -> str:
    with pytest.raises(RecordingError) as told:
        import_recording(source, tmp_path / "run.mcap")
    return str(told.value)


@pytest.mark.slow(kept_by="test_json_of_others_arrives_and_what_does_not_is_named")
def test_what_cannot_be_imported_says_why(tmp_path: Path) -> None:
    make(tmp_path / "own.mcap", 1)
    assert "was made by aiorts and needs no import" in refuse(tmp_path / "own.mcap", tmp_path)
    (tmp_path / "empty").mkdir()
    assert "there is no .mcap or .db3 file in it" in refuse(tmp_path / "empty", tmp_path)
    (tmp_path / "empty" / "a.db3.zstd").touch()
    assert "unpack it first with unzstd" in refuse(tmp_path / "empty", tmp_path)
    assert "unpack it first with unzstd" in refuse(tmp_path / "empty" / "a.db3.zstd", tmp_path)
    with sqlite3.connect(tmp_path / "other.db3") as database:
        database.execute("CREATE TABLE addresses(x)")
    database.close()
    assert "no ROS 2 bag: its database has no table topics" in refuse(tmp_path / "other.db3", tmp_path)
    (tmp_path / "cut.db3").write_bytes((tmp_path / "other.db3").read_bytes()[:100] + bytes(5000))
    assert "damaged" in refuse(tmp_path / "cut.db3", tmp_path)
    open_bag = old_bag(tmp_path / "open.db3", [])
    (tmp_path / "open.db3-wal").write_bytes(b"more")
    assert "did not close it: open.db3-wal holds more" in refuse(open_bag, tmp_path)
    packed = old_bag(tmp_path / "packed.db3", [(1, "/f", "std_msgs/msg/Float64", [(1, b"\x28\xb5\x2f\xfd1234")])])
    report = import_recording(packed, tmp_path / "packed.mcap")
    assert report.lost == {"/f": {"its messages are compressed one by one; ros2 bag convert unpacks them": 1}}
    alone = mcap_file(tmp_path / "alone.mcap", [("/c", "protobuf", "C", "protobuf", "x", [(9, b"")])])
    assert "nothing in it can be imported: /c: its messages are protobuf" in refuse(alone, tmp_path)
    assert not (tmp_path / "run.mcap").exists()


def test_the_command_tells_what_arrived_and_what_did_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [(1, "/f", "std_msgs/msg/Float64", [(1, float64(3.0))]), (2, "/o\x1b", "my/msg/T", [(1, b"")])]
    source = old_bag(tmp_path / "old.db3", rows)
    assert run_command(["log", "import", str(source), str(tmp_path / "run.mcap")]) == 0
    out = capsys.readouterr().out
    assert "1 sample of 1 port\n  f: 1 sample of /f\n" in out
    assert "left out: /o\\x1b: the file does not hold its definition" in out
    assert run_command(["log", "import", str(source), str(tmp_path / "run.mcap")]) == 2
    assert "E-RECORDING" in capsys.readouterr().err
    assert run_command(["log", "import", str(source), str(tmp_path / "run.mcap"), "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ports"] == {"f": "/f"}
    assert run_command(["log", "import", str(tmp_path / "nothing.db3"), str(tmp_path / "x.mcap")]) == 2


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


def test_on_a_terminal_standard_error_shows_how_much_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(1, "/f", "std_msgs/msg/Float64", [(number, float64(3.0)) for number in range(1, 300)])]
    source, screen = old_bag(tmp_path / "old.db3", rows), Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    assert run_command(["log", "import", str(source), str(tmp_path / "run.mcap")]) == 0
    assert run_command(["log", "convert", str(tmp_path / "run.mcap"), str(tmp_path / "run.csv")]) == 0
    for label in ("importing", "converting"):
        assert label in screen.getvalue()
        assert "100%" in screen.getvalue().rpartition(label)[2]


@pytest.mark.slow(kept_by="cli/test_help.py::test_a_missing_extra_says_which_command_installs_it")
def test_without_the_library_the_error_names_the_command(tmp_path: Path) -> None:
    source = old_bag(tmp_path / "old.db3", [(1, "/f", "std_msgs/msg/Float64", [(1, float64(3.0))])])
    code = (
        "import sys; sys.modules['rosbags'] = None; from aiorts.cli.app import run_command;"
        f"sys.exit(run_command(['log', 'import', {str(source)!r}, {str(tmp_path / 'run.mcap')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 2
    assert "E-EXTRA" in done.stderr
    assert 'pip install "aiorts[ros]"' in done.stderr
    assert not (tmp_path / "run.mcap").exists()
