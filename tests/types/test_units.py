"""Units of fields: declared once, and known to `aiorts types`, schemas, connections, filters and plots."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.adapting.proposing import between
from aiorts.cli.commands.record_types import profile_of_type
from aiorts.errors import DeclarationError, RecordError, WiringError
from aiorts.testing import simulated
from aiorts.types import EMPTY, Point2D, Seq, TimedDouble, field, record
from aiorts.types.structure import sole_unit, units_of
from aiorts.wire import layout_text, schema_text, units_in
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter
from aiorts_log.analysis.series import read_series


@record
class Joint:
    """A joint of an arm."""

    tm: int = 0
    angle: float = field(default=0.0, unit="rad", doc="from the rest position")
    speed: float = field(default=0.0, unit="rad/s")
    count: int = 0


@record
class Degrees(Joint):
    """The same, as a supplier has it."""

    angle: float = field(default=0.0, unit="deg")


@record
class Arm:
    tm: int = 0
    tip: Point2D = field(default=Point2D(1.0, 2.0), unit="m")
    joints: Seq[Joint] = field(default=EMPTY)
    limits: tuple[float, ...] = field(default_factory=tuple, unit="N")


@record
class Angle:
    tm: int = 0
    data: float = field(default=0.0, unit="rad")


@dataclass
class Plain:
    tm: int = 0
    angle: float = field(default=0.5, unit="rad")


@record
class Turned:
    """Not the same type, with a field of the same name."""

    tm: int = 0
    angle: float = field(default=0.0, unit="deg")


def test_a_record_has_its_defaults_and_checks_beside_its_units() -> None:
    assert (Joint().angle, Joint(1, 2).angle, Arm().tip, Arm().limits, Plain().angle) == (
        0.0,
        2.0,
        Point2D(1, 2),
        (),
        0.5,
    )
    with pytest.raises(RecordError, match="angle"):
        Joint(angle="wide")  # type: ignore[arg-type]
    with pytest.raises(DeclarationError, match="as its default"):

        @record
        class Wrong:
            angle: float = field(default="wide", unit="rad")  # type: ignore[assignment]

    with pytest.raises(DeclarationError, match="unit = 3: expected text"):
        field(unit=3)  # type: ignore[call-overload]


def test_units_are_known_by_the_paths_of_fields() -> None:
    assert units_of(Joint) == {"angle": "rad", "speed": "rad/s"}
    assert units_of(Degrees) == {"angle": "deg", "speed": "rad/s"}
    assert units_of(Plain) == {"angle": "rad"}
    assert units_of(Arm) == {
        "tip.x": "m",
        "tip.y": "m",
        "limits": "N",
        "joints.angle": "rad",
        "joints.speed": "rad/s",
    }
    assert units_of(float) == {}
    assert (sole_unit(Angle), sole_unit(Joint), sole_unit(float)) == ("rad", "", "")


def test_aiorts_types_says_them() -> None:
    fields = {one["name"]: (one["unit"], one["doc"]) for one in profile_of_type(Joint)["fields"]}
    assert fields == {
        "tm": ("ns", "time stamp, since the epoch"),
        "angle": ("rad", "from the rest position"),
        "speed": ("rad/s", ""),
        "count": ("", ""),
    }


@pytest.mark.parametrize("as_json", [False, True])
def test_schemas_have_them_and_layouts_of_links_have_not(as_json: bool) -> None:
    document = json.loads(schema_text(Arm, as_json=as_json))
    assert units_in(document) == units_of(Arm)
    assert "x-unit" not in layout_text(Arm)
    assert "x-unit" not in schema_text(TimedDouble, as_json=as_json)


@pytest.mark.parametrize(
    ("schema", "units"),
    [
        (None, {}),
        ([], {}),
        ({"anyOf": 3, "items": {"x-unit": 1}}, {}),
        ({"properties": [1]}, {}),
        ({"x-unit": "m"}, {"": "m"}),
    ],
)
def test_a_schema_of_anybody_gives_what_it_has(schema: Any, units: dict[str, str]) -> None:
    assert units_in(schema) == units


class Ports(Component):
    joint = OutPort(Joint)
    degrees = OutPort(Degrees)
    plain_angle = OutPort(Angle)


class Takes(Component):
    joint = InPort(Joint)
    angle = InPort(Angle)
    turned = InPort(Turned)
    value = InPort(TimedDouble, unit="deg")


@simulated
async def test_ports_whose_fields_have_different_units_are_not_connected() -> None:
    async with Kernel() as kernel:
        ports, takes = await kernel.add(Ports("ports")), await kernel.add(Takes("takes"))
        await kernel.connect(ports.joint, takes.joint)
        await kernel.connect(ports.plain_angle, takes.angle)
        wrong = r"units of angle differ: ports\.degrees sends 'deg', takes\.joint takes 'rad'; declare one unit"
        with pytest.raises(WiringError, match=wrong):
            await kernel.connect(ports.degrees, takes.joint)
        ports.add_port("more", OutPort(Angle, unit="deg"))
        with pytest.raises(WiringError, match=r"units differ: ports\.more sends 'deg', takes\.angle takes 'rad'"):
            await kernel.connect("ports.more", takes.angle)
        await kernel.connect(ports.degrees, takes.joint, convert=lambda one: Joint(one.tm, one.angle * 0.0174533))


def test_a_port_that_contradicts_its_type_is_refused_where_it_is_declared() -> None:
    with pytest.raises(DeclarationError, match=r"Wrong\.deg: unit = 'deg': Angle has 'rad'"):

        class Wrong(Component):
            deg = OutPort(Angle, unit="deg")


def test_a_filter_between_two_ports_converts_their_fields() -> None:
    found = between(OutPort(Joint), InPort(Turned))
    assert found is not None
    assert found.entries == "0:angle>57.29577951308232>0:angle"
    found = between(OutPort(Angle), InPort(TimedDouble, unit="deg"))
    assert found is not None
    assert found.entries == "0>57.29577951308232>0"


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_plot_has_them_on_its_axes(tmp_path: Path, encoding: Any) -> None:
    file = tmp_path / "run.mcap"
    with RecordingWriter(file, RecordingOptions(encoding=encoding)) as writer:
        joint, arm = writer.add_port("arm.joint", Joint), writer.add_port("arm.whole", Arm)
        writer.write(joint, Joint(0, 1.0, 2.0), 0)
        writer.write(arm, Arm(joints=(Joint(0, 3.0),)), 0)
    names = ["arm.joint.angle", "arm.joint.count", "arm.whole.tip.x", "arm.whole.joints[0].speed", "arm.joint.tm"]
    with RecordingReader(file) as reader:
        groups = read_series(reader, names, 0, 2**62, lambda _: None)
    assert [group[0].unit for group in groups] == ["rad", "", "m", "rad/s", ""]


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_recording_from_before_a_field_had_a_unit_is_read(tmp_path: Path, encoding: Any) -> None:
    source = "@record\nclass Later:\n    tm: int = 0\n    data: float = field(default=0.0, unit={!r})"
    names = {"record": record, "field": field, "__name__": __name__}
    exec(source.format(""), names)
    before: Any = names["Later"]
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(encoding=encoding)) as writer:
        writer.write(writer.add_port("a.out", before), before(1, 2.0), 0)
    exec(source.format("rad"), names)
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert [one for _, _, one in reader.records()] == [names["Later"](1, 2.0)]  # type: ignore[operator]
        assert reader.ports["a.out"].units == {"data": "rad"}
