"""A ROS 2 bag becomes whole records, and a bag again that `rosbags` reads as it was."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import aiorts.types as t
import aiorts.types.ros as r
from aiorts.cli.app import run_command
from aiorts_log import RecordingError, RecordingOptions, RecordingReader, RecordingWriter
from aiorts_log.analysis.convert import cut
from aiorts_log.foreign.exporting import ExportReport, export_ros2
from aiorts_log.foreign.importing import import_recording
from aiorts_log.foreign.ros_records import MESSAGES, maker, ros_name, standard_types, unmaker
from foreign_parts import old_bag
from log_parts import make, read

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND
COUNT = 3


@cache
def store() -> Any:
    pytest.importorskip("rosbags")
    return standard_types()


def value_of(desc: Any, chance: random.Random) -> Any:
    """A value of a field of any type of ROS, none of them a default; extremes and NaN among them."""
    kind, what = int(desc[0]), desc[1]
    if kind == 2:
        return message_of(what, chance)
    if kind != 1:
        (inner, what), length = (int(what[0][0]), what[0][1]), what[1]
        count = length or chance.randint(1, 7)
        items = [value_of((inner, what), chance) for _ in range(count)]
        if inner == 1 and what[0] != "string":
            return np.array(items, {"float64": "f8", "float32": "f4"}.get(what[0], what[0]))
        return items
    if what[0] == "string":
        return chance.choice(["map", "ümlaut", "frame id", "a\tb\n", "日本", "x" * 300])
    if what[0] == "bool":
        return True
    if what[0].startswith("float"):
        found = chance.choice([chance.uniform(-1e3, 1e3), 1e-30, -0.0, float("inf"), float("nan"), 3.0e38])
        return float(np.float32(found)) if what[0] == "float32" else found
    bits = int(what[0].lstrip("uint"))
    low, high = (1, 2**bits - 1) if what[0][0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return chance.choice([low, high, chance.randint(low, high)])


def message_of(name: str, chance: random.Random) -> Any:
    if name == "builtin_interfaces/msg/Time":
        return store().types[name](chance.randint(1, 2**31 - 1), chance.randint(0, SECOND - 1))
    return store().types[name](*(value_of(desc, chance) for _, desc in store().fielddefs[name][1]))


@cache
def messages() -> tuple[tuple[str, str, int, Any], ...]:
    """Topic, type, time and message: several of each of the twelve types, in order of their times."""
    chance = random.Random(4)
    return tuple(
        (f"/robot/{short.rpartition('/')[2].lower()}", short.replace("/", "/msg/"), BEGIN + (12 * i + k) * 1001, one)
        for i in range(COUNT)
        for k, short in enumerate(MESSAGES)
        for one in [message_of(short.replace("/", "/msg/"), chance)]
    )


def bag(path: Path, storage: str, rows: Any = None) -> Path:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage.upper()]) as writer:
        connections: dict[str, Any] = {}
        for topic, name, when, message in messages() if rows is None else rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store())
            writer.write(connections[topic], when, bytes(store().serialize_cdr(message, name)))
    return path


def read_bag(path: Path) -> Iterator[tuple[str, str, int, Any]]:
    """What `rosbags` reads of a bag, by the definitions that the bag itself has."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    with highlevel.AnyReader([path]) as reader:
        for connection, when, data in reader.messages():
            yield connection.topic, connection.msgtype, when, reader.deserialize(data, connection.msgtype)


def same(left: Any, right: Any, where: str) -> None:
    """Equal field by field, arrays with their type and to the bit, -0.0 and NaN too."""
    if dataclasses.is_dataclass(left):
        names = [one.name for one in dataclasses.fields(left)]
        assert names == [one.name for one in dataclasses.fields(right)], where
        for name in names:
            same(getattr(left, name), getattr(right, name), f"{where}.{name}")
    elif isinstance(left, list):
        assert len(left) == len(right), where
        for number, pair in enumerate(zip(left, right, strict=True)):
            same(*pair, f"{where}[{number}]")
    elif isinstance(left, np.ndarray):
        assert (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes()), where
    elif isinstance(left, float):
        assert np.float64(left).tobytes() == np.float64(right).tobytes(), where
    else:
        assert (type(left), left) == (type(right), right), where


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_of_all_twelve_comes_back_equal_in_every_field(tmp_path: Path, storage: str) -> None:
    report = import_recording(bag(tmp_path / "bag", storage), tmp_path / "run.mcap")
    assert (report.left, report.lost) == ({}, {})
    assert report.samples == {f"robot_{name.rpartition('/')[2].lower()}": COUNT for name in MESSAGES}
    done = export_ros2(tmp_path / "run.mcap", tmp_path / "again", storage=storage)  # type: ignore[arg-type]
    assert done.messages == {f"/robot/{name.rpartition('/')[2].lower()}": COUNT for name in MESSAGES}
    assert (done.left, done.not_closed) == ({}, ())
    found = list(read_bag(tmp_path / "again"))
    assert [row[:3] for row in found] == [row[:3] for row in messages()]
    for (topic, *_, one), (*_, other) in zip(messages(), found, strict=True):
        same(one, other, topic)
    ending = {"mcap": "mcap", "sqlite3": "db3"}[storage]
    assert sorted(one.name for one in (tmp_path / "again").iterdir()) == [f"again.{ending}", "metadata.yaml"]


@pytest.mark.slow(kept_by="test_a_bag_of_all_twelve_comes_back_equal_in_every_field")
def test_messages_are_records_with_the_time_and_frame_of_their_header(tmp_path: Path) -> None:
    import_recording(bag(tmp_path / "bag", "mcap"), tmp_path / "run.mcap")
    found = read(tmp_path / "run.mcap")
    assert len(found) == len(messages())
    for (port, log_time, record), (topic, name, when, message) in zip(found, messages(), strict=True):
        assert (port, log_time, ros_name(type(record))) == (topic[1:].replace("/", "_"), when, name)
        if isinstance(record, r.Headed):
            assert record.tm == message.header.stamp.sec * SECOND + message.header.stamp.nanosec
            assert record.frame_id == message.header.frame_id
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert {port.name: port.type_name for port in reader.ports.values()}["robot_imu"] == "sensor_msgs/Imu"
        assert all(sample.publish_time == getattr(sample.record, "tm", sample.log_time) for sample in reader.samples())


@pytest.mark.parametrize("name", MESSAGES)
def test_any_message_is_equal_after_it_was_a_record(name: str) -> None:
    cls = MESSAGES[name]
    make_one, unmake, full = maker(cls), unmaker(cls, store()), ros_name(cls)

    @settings(max_examples=15, deadline=None, database=None)
    @given(st.randoms(use_true_random=False))
    def check(chance: random.Random) -> None:
        message = message_of(full, chance)
        record = make_one(store().deserialize_cdr(store().serialize_cdr(message, full), full))
        same(message, unmake(record), full)
        again = t.from_plain(cls, t.to_plain(record))
        same(message, unmake(again), full)

    check()


@pytest.mark.slow(kept_by="test_a_bag_of_all_twelve_comes_back_equal_in_every_field")
@pytest.mark.parametrize("ending", ["csv", "txt", "jsonl"])
def test_whole_records_come_back_from_every_form(tmp_path: Path, ending: str) -> None:
    import_recording(bag(tmp_path / "bag", "mcap"), tmp_path / "run.mcap")
    other, again = tmp_path / f"run.{ending}", tmp_path / "again.mcap"
    back: list[str] = []
    if ending == "csv":
        with RecordingReader(tmp_path / "run.mcap") as reader:
            for port in reader.ports.values():
                back += ["--port", port.name, "--type", port.type_name]
    assert run_command(["log", "convert", str(tmp_path / "run.mcap"), str(other)]) == 0
    assert run_command(["log", "convert", str(other), str(again), *back]) == 0
    assert read(again) == read(tmp_path / "run.mcap")


def test_what_is_only_called_so_is_taken_in_parts(tmp_path: Path) -> None:
    typesys, rosbag2 = pytest.importorskip("rosbags.typesys"), pytest.importorskip("rosbags.rosbag2")
    name, types = "sensor_msgs/msg/Imu", typesys.get_typestore(typesys.Stores.EMPTY)
    types.register(typesys.get_types_from_msg("float64 speed", name))
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/imu", name, typestore=types)
        writer.write(connection, BEGIN, bytes(types.serialize_cdr(types.types[name](2.5), name)))
    import_recording(tmp_path / "bag", tmp_path / "run.mcap")
    assert read(tmp_path / "run.mcap") == [("imu", BEGIN, t.TimedDouble(BEGIN, 2.5))]


@pytest.mark.slow(kept_by="test_what_is_only_called_so_is_taken_in_parts")
def test_a_bag_without_definitions_gives_whole_records_too(tmp_path: Path) -> None:
    rows = {(topic, name): [] for topic, name, _, _ in messages()}  # type: dict[tuple[str, str], list[Any]]
    for topic, name, when, message in messages():
        rows[topic, name].append((when, bytes(store().serialize_cdr(message, name))))
    old_bag(tmp_path / "old.db3", [(i, *key, found) for i, (key, found) in enumerate(rows.items())])
    import_recording(tmp_path / "old.db3", tmp_path / "old.mcap")
    import_recording(bag(tmp_path / "bag", "mcap"), tmp_path / "run.mcap")
    assert read(tmp_path / "old.mcap") == read(tmp_path / "run.mcap")


def test_a_message_that_is_none_is_reported_and_the_others_arrive(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    name, cls = "geometry_msgs/msg/TwistStamped", MESSAGES["geometry_msgs/TwistStamped"]
    whole = bytes(store().serialize_cdr(message_of(name, random.Random(2)), name))
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/t", name, typestore=store())
        no_text = whole[:16] + b"\xff" + whole[17:]
        for when, data in enumerate([whole, whole[:20], b"", no_text, b"\0\1\0\0" + b"\xff" * 40, whole]):
            writer.write(connection, BEGIN + when, data)
    report = import_recording(tmp_path / "bag", tmp_path / "run.mcap")
    assert [(when - BEGIN, type(record)) for _, when, record in read(tmp_path / "run.mcap")] == [(0, cls), (5, cls)]
    assert sum(report.lost["/t"].values()) == 4
    assert all(why.startswith(f"no {name}: ") for why in report.lost["/t"])


def mixed(path: Path) -> Path:
    """A recording of a run here: two ports with messages of ROS, one without."""
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        ports = [
            writer.add_port(name, cls)
            for name, cls in (("base0.twist", r.Twist), ("imu.2nd-data", r.Imu), ("pid0.speed", t.TimedDouble))
        ]
        for i in range(3):
            writer.write(ports[0], r.Twist(r.Vector3(1.0 * i, 0.0, 0.0)), BEGIN + i)
            writer.write(ports[1], r.Imu(r.Header(r.Time(i, 5), "base")), BEGIN + i)
            writer.write(ports[2], t.TimedDouble(BEGIN, 1.5), BEGIN + i)
    return path


@pytest.mark.slow
def test_what_ros_has_no_message_for_is_named_and_left_out_on_request_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = mixed(tmp_path / "run.mcap"), tmp_path / "bag"
    said = (
        r"port 'pid0.speed' cannot be exported: its samples are TimedDouble, no message of ROS 2; --skip-others "
        r"exports the others alone \(base0.twist, imu.2nd-data\), --port some of them"
    )
    with pytest.raises(RecordingError, match=said):
        export_ros2(source, target)
    assert not target.exists()
    command = ["log", "export", "--to", "ros2", str(source), "-o", str(target)]
    assert run_command(command) == 2
    assert "E-RECORDING" in capsys.readouterr().err
    assert run_command([*command, "--skip-others"]) == 0
    out = capsys.readouterr()
    assert out.out.splitlines() == [
        f"{target}: 6 messages of 2 topics",
        "  /base0/twist: 3 messages of base0.twist",
        "  /imu/_2nd_data: 3 messages of imu.2nd-data",
    ]
    assert out.err == "  left out: pid0.speed: its samples are TimedDouble, no message of ROS 2\n"
    found = [(topic, when, message) for topic, _, when, message in read_bag(target)]
    assert [(topic, when) for topic, when, _ in found] == [
        (topic, BEGIN + i) for i in range(3) for topic in ("/base0/twist", "/imu/_2nd_data")
    ]
    assert [message.linear.x for topic, _, message in found if "twist" in topic] == [0.0, 1.0, 2.0]
    assert run_command([*command, "--skip-others"]) == 2
    assert "exists already, and a folder is not replaced" in capsys.readouterr().err
    chosen = export_ros2(source, tmp_path / "one", ports=["base0.twist"])
    assert chosen == ExportReport({"/base0/twist": 3}, {"/base0/twist": "base0.twist"})


@pytest.mark.parametrize(
    ("ports", "said"),
    [
        ({"a.b": r.Twist, "a b": r.Twist}, None),
        ({"a-b": r.Twist, "a_b": r.Twist}, "ports 'a-b' and 'a_b' would both be the topic /a_b"),
    ],
)
def test_ports_that_cannot_have_a_topic_of_their_own(tmp_path: Path, ports: dict[str, Any], said: str | None) -> None:
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        for name, cls in ports.items():
            writer.write(writer.add_port(name, cls), cls(), BEGIN)
    if said is None:
        assert export_ros2(tmp_path / "run.mcap", tmp_path / "bag").topics == {"/a/b": "a.b", "/a_b": "a b"}
        return
    with pytest.raises(RecordingError, match=said):
        export_ros2(tmp_path / "run.mcap", tmp_path / "bag")
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]


def test_a_recording_without_messages_of_ros_is_said_to_have_none(tmp_path: Path) -> None:
    make(tmp_path / "run.mcap", 3)
    with pytest.raises(RecordingError, match="no port has messages of ROS 2, which are Imu, "):
        export_ros2(tmp_path / "run.mcap", tmp_path / "bag", skip_others=True)


def test_a_recording_without_samples_becomes_a_bag_without_messages(tmp_path: Path) -> None:
    cut(mixed(tmp_path / "run.mcap"), tmp_path / "cut.mcap", start=BEGIN + 10, end=BEGIN + 11, ports=["base0.twist"])
    assert export_ros2(tmp_path / "cut.mcap", tmp_path / "none").messages == {}
    assert list(read_bag(tmp_path / "none")) == []


def test_a_port_that_sent_nothing_needs_no_message_of_ros(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        writer.add_port("quiet", t.TimedDouble)
        writer.write(writer.add_port("base0.twist", r.Twist), r.Twist(), BEGIN)
    assert export_ros2(tmp_path / "run.mcap", tmp_path / "bag").messages == {"/base0/twist": 1}


def test_an_interrupted_export_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import aiorts_log.foreign.exporting as exporting

    source = mixed(tmp_path / "run.mcap")
    genuine = exporting._encoder

    def failing(port: Any, store: Any) -> Callable[[bytes], bytes]:
        encode, left = genuine(port, store), [2]

        def one(data: bytes) -> bytes:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            return encode(data)

        return one

    monkeypatch.setattr(exporting, "_encoder", failing)
    with pytest.raises(KeyboardInterrupt):
        export_ros2(source, tmp_path / "bag", skip_others=True)
    assert [one.name for one in tmp_path.iterdir()] == ["run.mcap"]
