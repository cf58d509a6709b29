"""Messages of ROS 2 are records by the names that ROS gives them; a bare name never means one of them."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aiorts
import aiorts.types.ros as ros
from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import PortTypeError, RecordError, UnknownTypeError, WiringError
from aiorts.testing import Rig, simulated
from aiorts.types import (
    Quaternion,
    Time,
    all_types,
    fields_of,
    find_type,
    from_plain,
    full_name,
    has_tm,
    path_type,
    read_path,
    record,
    to_plain,
    type_name,
    with_tm,
)
from aiorts.wire import LineReader, MsgpackCodec, line_of
from aiorts_log.foreign.ros_records import MESSAGES

RECORDS: dict[str, Any] = {
    full_name(cls): cls for name in ros.__all__ if hasattr(cls := getattr(ros, name), "__dataclass_fields__")
}
HEADED = [cls for cls in RECORDS.values() if issubclass(cls, ros.Headed)]
TM = 1_700_000_000_000_000_007


@pytest.mark.parametrize("name", RECORDS)
def test_each_is_found_by_the_name_of_ros_alone(name: str) -> None:
    cls = RECORDS[name]
    assert find_type(name) is find_type(name.replace("/", "/msg/")) is cls
    assert type_name(cls) == full_name(cls) == name
    assert all_types()[name] is cls
    short = name.rpartition("/")[2]
    others = [known for known in all_types() if known.rpartition(".")[2] == short]  # of this process
    if others:
        with contextlib.suppress(UnknownTypeError):  # several have it
            assert find_type(short) is not cls
    else:
        with pytest.raises(UnknownTypeError, match=f"did you mean {name}"):
            find_type(short)


def test_the_bare_names_of_openrtm_stay_theirs() -> None:
    assert find_type("Quaternion") is Quaternion
    assert find_type("Time") is Time
    assert type_name(Quaternion) == "Quaternion"
    with pytest.raises(RecordError, match="expected a geometry_msgs/Quaternion, got an instance of Quaternion"):
        ros.Imu(orientation=Quaternion())  # type: ignore[arg-type]


def test_a_name_of_ros_that_nobody_has_is_told_with_near_ones() -> None:
    with pytest.raises(UnknownTypeError, match="unknown type 'sensor_msgs/Imus'; did you mean sensor_msgs/Imu"):
        find_type("sensor_msgs/Imus")
    with pytest.raises(UnknownTypeError):
        find_type("my_msgs/msg/Thing")


@pytest.mark.slow(kept_by="test_each_is_found_by_the_name_of_ros_alone")
def test_they_are_loaded_when_one_is_asked_for() -> None:
    code = (
        "import sys, aiorts.types as t\nfrom aiorts import Kernel\n"
        "assert not [name for name in sys.modules if name.startswith('aiorts.types.ros')]\n"
        "t.find_type('sensor_msgs/msg/Imu')\n"
        "assert 'aiorts.types.ros.nav_msgs' in sys.modules and 'numpy' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.slow(kept_by="test_each_comes_back_from_bytes_and_from_plain_data")
def test_a_frame_that_names_one_is_decoded_where_none_was_loaded() -> None:
    frame = MsgpackCodec().encode(ros.TwistStamped(twist=ros.Twist(ros.Vector3(1.0, 2.0, 3.0))))
    code = f"from aiorts.wire import MsgpackCodec\nprint(MsgpackCodec().decode({frame!r}).twist.linear.y)"
    done = subprocess.run([sys.executable, "-c", code], check=True, timeout=60, capture_output=True, text=True)
    assert done.stdout == "2.0\n"


@pytest.mark.parametrize("cls", HEADED, ids=full_name)
def test_the_time_stamp_is_that_of_the_header(cls: Any) -> None:
    sample = cls(header=ros.Header(ros.Time(1_700_000_000, 7), "map"))
    assert has_tm(cls)
    assert (sample.tm, sample.sec, sample.nsec, sample.frame_id) == (TM, TM // 10**9, 7, "map")
    later = with_tm(sample, TM + 5)
    assert later == cls(header=ros.Header(ros.Time(1_700_000_000, 12), "map"))
    assert with_tm(sample, Time.from_ns(TM + 5)) == later
    assert (read_path(later, "tm"), str(path_type(cls, "tm"))) == (TM + 5, "stamp")
    with pytest.raises(RecordError, match="tm: expected nanoseconds"):
        with_tm(sample, -1)
    with pytest.raises(RecordError, match=r"Time.sec: expected an integer"):
        with_tm(sample, 2**31 * 10**9)


def test_a_stamp_before_1970_is_kept_and_is_no_time() -> None:
    sample = ros.TwistStamped(ros.Header(ros.Time(-1, 4_000_000_000), "map"))
    assert (sample.tm, sample.header.stamp.ns) == (3_000_000_000, 3_000_000_000)
    assert ros.Time.from_ns(-1) == ros.Time(-1, 999_999_999)
    assert ros.TwistStamped(ros.Header(ros.Time(-5, 1))).tm == 0


def test_covariances_have_their_length() -> None:
    for cls, length, names in (
        (ros.Imu, 9, [f"{of}_covariance" for of in ("orientation", "angular_velocity", "linear_acceleration")]),
        (ros.NavSatFix, 9, ["position_covariance"]),
        (ros.PoseWithCovariance, 36, ["covariance"]),
        (ros.TwistWithCovariance, 36, ["covariance"]),
    ):
        for name in names:
            assert getattr(cls(), name).tolist() == [0.0] * length
            assert getattr(cls(**{name: np.ones(length)}), name).tolist() == [1.0] * length
            with pytest.raises(RecordError, match=rf"{cls.__name__}.{name}: expected {length} numbers, got 4"):
                cls(**{name: [0.0] * 4})


@pytest.mark.parametrize("cls", HEADED, ids=full_name)
def test_a_line_of_json_tells_the_time_and_is_believed(cls: Any) -> None:
    sample = with_tm(cls(), TM)
    line = line_of("port", sample)
    assert f'"tm": {TM}, "data": {{"header": {{"stamp": {{"sec": 1700000000, "nanosec": 7}}' in line
    reader = LineReader({"port": cls})
    assert reader.sample(line, 3) == ("port", sample)
    assert reader.sample(line.replace(f'"tm": {TM}, ', ""), 3) == ("port", sample)
    assert reader.sample(line.replace(f'"tm": {TM}', '"tm": 5'), 3) == ("port", with_tm(sample, 5))


def described(cls: Any, name: str) -> Iterator[tuple[str, str]]:
    """Fields of a record as definitions of ROS spell them."""
    numbers = {"f64": "float64", "f32": "float32", "str": "string", "bool": "bool"}
    numbers |= {
        f"{sign}{bits}": f"{word}{bits}" for sign, word in (("i", "int"), ("u", "uint")) for bits in (8, 16, 32)
    }
    for field in fields_of(cls):
        inner = field.spelling.removeprefix("seq[").removesuffix("]")
        kind = numbers.get(inner, inner.replace("/", "/msg/"))
        length = len(getattr(cls(), field.name)) or "" if inner != field.spelling else 0
        yield field.name, kind if inner == field.spelling else f"{kind}[{length}]"


def spelled(desc: Any) -> str:
    kind, what = int(desc[0]), desc[1]
    if kind == 1:
        return str(what[0])
    return str(what) if kind == 2 else f"{spelled(what[0])}[{what[1] or ''}]"


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["HUMBLE", "JAZZY", "KILTED"])
def test_names_and_types_of_all_fields_are_those_of_ros(distribution: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores[f"ROS2_{distribution}"])
    for name, cls in RECORDS.items():
        constants, fields = store.fielddefs[name.replace("/", "/msg/")]
        assert list(described(cls, name)) == [(field, spelled(desc)) for field, desc in fields], name
        assert {one: getattr(cls, one) for one, _, _ in constants} == {one: value for one, _, value in constants}, name


@pytest.mark.parametrize("cls", RECORDS.values(), ids=full_name)
def test_each_comes_back_from_bytes_and_from_plain_data(cls: Any) -> None:
    codec = MsgpackCodec()
    assert codec.decode(codec.encode(cls())) == cls()
    assert from_plain(cls, to_plain(cls())) == cls()


@simulated
async def test_a_port_that_stamps_sets_the_header() -> None:
    class Source(Component):
        out = OutPort(ros.Imu, stamp="write")

        def on_execute(self) -> None:
            self.out.write_nowait(ros.Imu(ros.Header(ros.Time(9, 9), "base")))

    async with Rig(Source()) as rig:
        await rig.tick()
        (sample,) = rig.values("out")
        assert sample.header == ros.Header(ros.Time.from_ns(rig.clock.time_ns()), "base")
        assert sample.tm == rig.clock.time_ns()


@simulated
async def test_ports_of_one_short_name_are_told_apart() -> None:
    class Source(Component):
        out = OutPort(ros.Quaternion)

    class Sink(Component):
        into = InPort(Quaternion)

    async with Kernel() as kernel:
        source, sink = await kernel.create(Source), await kernel.create(Sink)
        with pytest.raises(WiringError, match=r"sends geometry_msgs/Quaternion, sink0.into takes Quaternion; "):
            await kernel.connect(source.out, sink.into)
        with pytest.raises(PortTypeError, match=r"expected a geometry_msgs/Quaternion, got Quaternion"):
            source.out.write_nowait(Quaternion())  # type: ignore[arg-type]


def test_any_record_may_have_its_time_stamp_elsewhere() -> None:
    @record
    class Late:
        micros: int = 0

        @property
        def tm(self) -> int:
            return self.micros * 1000

        def with_tm(self, tm: int) -> Late:
            return Late(tm // 1000)

    @record
    class Never:
        micros: int = 0

        @property
        def tm(self) -> int:
            return self.micros * 1000

    assert (has_tm(Late), has_tm(Never)) == (True, False)
    assert with_tm(Late(3), 5000) == Late(5)
    assert line_of("port", Late(3)) == '{"port": "port", "type": "Late", "tm": 3000, "data": {"micros": 3}}'


def test_the_page_of_the_guide_is_so() -> None:
    page = (Path(aiorts.__file__).parent / "guide" / "pages" / "howto" / "ros-bag.md").read_text(encoding="utf-8")
    code = page.partition("```python\n")[2].partition("```")[0]
    exec(compile(code, "ros.md", "exec"), {"__name__": "ros_page"})
    assert all(name.rpartition("/")[2] in page for name in MESSAGES)
