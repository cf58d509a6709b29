"""`aiorts inspect` and `aiorts types`: what is there is shown as it is, and nothing is run for it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from aiorts import exits
from aiorts.cli.app import run_command
from aiorts.cli.commands.record_types import GROUPS, example_of
from aiorts.cli.console.report import LONGEST
from aiorts.types import all_types, fields_of, find_type
from aiorts.wire import LineReader

FLEXI = {
    "FlexiAdd": (("-p", "TimedDouble:2"), ["in input0", "in input1", "out output"]),
    "FlexiConst": (("-p", "TimedDouble", "-c", "1"), ["out output"]),
    "FlexiDump": (("-p", "TimedLong"), ["in input0"]),
    "FlexiDupe": (("-p", "TimedLong:2"), ["in input0", "out output0_0", "out output0_1"]),
    "FlexiFilter": (("-i", "TimedDouble", "-o", "TimedLong"), ["in input0", "out output0"]),
    "FlexiLogger": (("-p", "TimedLong"), ["in input0"]),
    "FlexiSelect": (("-p", "TimedLong:2"), ["in selection", "in input0", "in input1", "out output"]),
}
HOOKS = [
    "on_initialize",
    "on_finalize",
    "on_startup",
    "on_shutdown",
    "on_activated",
    "on_deactivated",
    "on_execute",
    "on_state_update",
    "on_rate_changed",
    "on_aborting",
    "on_error",
    "on_reset",
]
COMPONENT = """
from dataclasses import dataclass, field
from pathlib import Path
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble

@dataclass(frozen=True)
class Grip:
    '''How it is held.'''
    force: float = field(default=2.0, metadata={"unit": "N", "doc": "of the fingers"})
    name: str = "left"

@dataclass
class NoDefault:
    value: float

class Arm(Component):
    '''Moves.

    Further down.
    '''
    target = InPort(TimedDouble, unit="rad", shape=(), doc="where to")
    held = OutPort(Grip, name="grip")
    speed = Param(1.5, gt=0.0, le=float("inf"), unit="rad/s", doc="at most")
    mode = Param("slow", choices=("slow", "fast"))
    log_file = Param(Path("x.log"))

    def __init__(self, name=""):
        Path(CANARY).mkdir()
"""


def aiorts(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(arguments)
    said = capsys.readouterr()
    return status, said.out, said.err


def strict(text: str) -> Any:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    text = COMPONENT.replace("CANARY", repr(str(tmp_path / "canary")))
    hooks = "".join(
        f"    def {hook}(self{', error' if hook in ('on_error', 'on_aborting') else ''}):\n"
        f"        Path({str(tmp_path / 'canary')!r}).mkdir()\n"
        for hook in HOOKS
    )
    (tmp_path / "arm.py").write_text(text + hooks)
    return tmp_path


@pytest.mark.parametrize("name", FLEXI)
def test_the_ports_of_a_flexi_component_are_those_its_options_give(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options, ports = FLEXI[name]
    for spelled in (name, name.lower()):
        status, out, err = aiorts(capsys, "inspect", spelled, *options, "--json")
        assert (status, err) == (0, "")
        profile = strict(out)
        assert [f"{port['direction']} {port['name']}" for port in profile["ports"]] == ports
        assert (profile["needs"], profile["command"], profile["type"]) == ([], name.lower(), name)
    assert profile["package"].startswith("package aiorts ")
    assert Path(profile["source"]).is_file()


@pytest.mark.parametrize("name", FLEXI)
def test_without_options_it_says_which_are_needed(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "inspect", name)
    assert (status, err) == (0, "")
    needed = [option for option in FLEXI[name][0] if option.startswith("-")]
    assert f"give {' and '.join(needed)}" in out


def test_a_logger_without_options_is_shown_and_one_that_replays_needs_no_type(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = aiorts(capsys, "inspect", "FlexiLogger")
    assert (status, err) == (0, "")
    assert "give -p: aiorts inspect FlexiLogger -p ..." in out
    recording = tmp_path / "a.jsonl"
    recording.write_text('{"port": "speed", "type": "TimedDouble", "tm": 5, "data": 1.5, "log_time": 5}\n')
    for flag in ("-o", "--output"):
        status, out, err = aiorts(capsys, "inspect", "FlexiLogger", flag, "-l", str(recording), "--json")
        assert (status, err) == (0, "")
        assert [port["name"] for port in strict(out)["ports"]] == ["speed"]


def test_what_a_class_declares_is_shown_and_nothing_of_it_is_run(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Arm", "--speed", "3", "--json")
    assert (status, err) == (0, "")
    assert not (arm / "canary").exists()
    profile = strict(out)
    assert profile["ports"] == [
        {
            "name": "target",
            "direction": "in",
            "type": "TimedDouble",
            "unit": "rad",
            "shape": [],
            "doc": "where to",
            "connectors": [],
            "interfaces": [],
        },
        {
            "name": "grip",
            "direction": "out",
            "type": "Grip",
            "unit": None,
            "shape": None,
            "doc": "",
            "connectors": [],
            "interfaces": [],
        },
    ]
    assert profile["params"] == {"speed": 3.0, "mode": "slow", "log_file": "x.log"}
    assert profile["parameters"][0]["range"] == {"gt": 0.0, "le": "Infinity"}
    assert profile["parameters"][1]["choices"] == ["slow", "fast"]
    assert sorted(profile["hooks"]) == sorted(HOOKS)
    assert profile["source"] == str(arm / "arm.py")


def test_people_read_the_same(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Arm")
    assert out.startswith("Arm: Moves.\n")
    for expected in ("target", "TimedDouble", "rad", "where to", "0.0 < x", "rad/s", "on_execute", "'slow', 'fast'"):
        assert expected in out
    assert not (arm / "canary").exists()


GRIPPER = """
from typing import Protocol
from aiorts import MultiModeComponent, Param, Provided, Required

class Brake(Protocol):
    async def stop(self, force: float = 1.0, *, why: str) -> bool:
        '''Stop at once.

        For good.'''
    def ready(self) -> bool: ...

class Gripper(MultiModeComponent):
    modes = ("manual", "automatic")
    configurations = {"stiff": {"gain": 5.0}, "soft": {}}
    gain = Param(1.0)
    brake = Provided[Brake]()
    other = Required[Brake]()

    async def stop(self, force: float = 1.0, *, why: str) -> bool:
        return True

    def ready(self) -> bool:
        return True
"""


def test_sets_modes_and_the_methods_of_services_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "gripper.py").write_text(GRIPPER)
    _, out, _ = aiorts(capsys, "inspect", f"{tmp_path / 'gripper.py'}:Gripper")
    assert "Configuration sets\n  default  gain = 1.0\n  stiff    gain = 5.0\n  soft     as declared\n" in out
    assert "Modes\n  manual (default), automatic\n" in out
    methods = "    async stop(force: float = 1.0, *, why: str) -> bool  Stop at once.\n    ready() -> bool\n"
    assert f"Services\n  brake: provided Brake\n{methods}  other: required Brake\n{methods}" in out
    _, out, _ = aiorts(capsys, "inspect", f"{tmp_path / 'gripper.py'}:Gripper", "--json")
    profile = strict(out)
    assert profile["sets"] == {"default": {"gain": 1.0}, "stiff": {"gain": 5.0}, "soft": {}}
    assert profile["modes"] == ["manual", "automatic"]
    (brake,) = profile["ports"][0]["interfaces"]
    assert [method["name"] for method in brake["methods"]] == ["stop", "ready"]
    assert brake["methods"][0]["parameters"][1] == {"name": "why", "type": "str", "default": None, "kind": "keyword"}


@pytest.mark.parametrize(
    "name",
    ["FlexiFiler", "flexifilte", "TimedDoubel", "Foo", "", "file.py:", ":", "a:b:c", "x y:Z", "\0", "../..:X", "."],
)
def test_an_unknown_name_is_one_line_with_the_nearest(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "inspect", name)
    assert (status, out) == (2 if ":" in name or "\0" in name else 6, "")
    assert len(err.splitlines()) == 1
    assert len(err) <= LONGEST + 1
    nearest = {"FlexiFiler": "FlexiFilter", "flexifilte": "FlexiFilter", "TimedDoubel": "TimedDouble"}
    assert nearest.get(name, "") in err
    if name in ("Foo", "FlexiFiler"):
        assert "FlexiAdd" in err


def test_a_class_or_file_that_is_misspelt_is_told_the_nearest(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "did you mean 'Arm'?" in aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Amr")[2]
    assert "arm.py:Arm'?" in aiorts(capsys, "inspect", f"{arm / 'amr.py'}:Arm")[2]
    assert "it has Arm" in aiorts(capsys, "inspect", f"{arm / 'arm.py'}:")[2]
    assert (
        "there is no 'CANARY'; it has Grip, NoDefault, Arm" in aiorts(capsys, "inspect", f"{arm / 'arm.py'}:CANARY")[2]
    )
    status, _, err = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Arm", "--sped", "3")
    assert (status, "--speed" in err) == (2, True)
    status, _, err = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Arm", "--speed", "-3")
    assert (status, "must be > 0" in err) == (2, True)


@pytest.mark.parametrize("what", ["inspect", "doc"])
@pytest.mark.parametrize("name", ["NoSuch", "no_such.py:One", "no_such.module:One", "asyncio.no_such:One", "re:One"])
def test_what_is_not_there_ends_with_the_status_of_absence_and_what_is_to_be_started_with_a_refusal(
    what: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = aiorts(capsys, what, name)
    assert (status, out) == (exits.ABSENT, "")
    assert err.startswith("aiorts: E-UNKNOWN-TYPE: ")
    assert aiorts(capsys, "run", name)[0] == exits.REFUSED


@pytest.mark.fault("F05")
@pytest.mark.parametrize("text", ["raise SystemExit(3)", "import nothing_of_the_kind", "def broken(:", "1 / 0"])
def test_a_file_that_cannot_be_imported_is_one_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.py").write_text(text)
    status, out, err = aiorts(capsys, "inspect", f"{tmp_path / 'bad.py'}:X")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("aiorts: E-PLUGIN: ")


@pytest.mark.fault("F06")
def test_a_bad_port_is_marked(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "inspect", "FlexiFilter", "-i", "TimedDouble", "-o", "TimedLong:x")
    assert (status, out) == (2, "")
    _, quoted, mark = err.splitlines()
    assert quoted[mark.index("^")] == ":"


@pytest.mark.fault("F18")
@pytest.mark.parametrize("arguments", [("Foo",), ("FlexiFilter", "-i", "X", "-o", "Y"), (), ("TimedLong", "--bad")])
def test_an_error_is_json_as_well_when_json_was_asked_for(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = aiorts(capsys, "inspect", *arguments, "--json")
    assert status == (6 if arguments == ("Foo",) else 2)
    assert strict(out)["error"]["code"] in err
    assert "{" not in err


# -- types -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_type_is_listed_with_a_line_that_is_read_back(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "types", "--json")
    assert (status, err) == (0, "")
    listed = {one["full_name"]: one for one in strict(out)}
    assert listed.keys() >= {name for name in all_types() if name.startswith("aiorts.types.")}
    assert len([one for one in listed.values() if one["group"] != "user"]) >= 131
    for one in listed.values():
        assert one["group"] in GROUPS
        cls = find_type(one["full_name"])
        if not issubclass(cls, Enum) and one["group"] != "user":
            assert one["example"], one["name"]
            port, sample = LineReader({"input0": cls}).sample(one["example"], 7)
            assert (port, type(sample)) == ("input0", cls)
    origin = {one["openrtm"].partition(" in ")[2] for one in listed.values()} - {""}
    assert origin == {"BasicDataType.idl", "ExtendedDataTypes.idl", "InterfaceDataTypes.idl"}
    assert listed["aiorts.types.TimedDouble"]["fields"][0] == {
        "name": "tm",
        "type": "stamp",
        "default": 0,
        "required": False,
        "unit": "ns",
        "doc": "time stamp, since the epoch",
    }


@dataclass(frozen=True)
class Unmakeable:
    """Not even its own defaults please it."""

    value: float = 0.0

    def __post_init__(self) -> None:
        raise KeyError("value")


def test_a_type_that_cannot_be_made_is_listed_without_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert fields_of(Unmakeable)  # from now on it is known
    status, out, err = aiorts(capsys, "types", "Unmakeable", "--json")
    assert (status, err) == (0, "")
    assert [one["example"] for one in strict(out)] == [""]
    assert aiorts(capsys, "inspect", "Unmakeable")[0] == 0


@pytest.mark.parametrize(
    ("pattern", "found"),
    [("pose2d", "TimedPose2D"), ("Timed*Seq", "TimedLongSeq"), ("aiorts.types.TimedLong", "TimedLong")],
)
def test_a_pattern_chooses(pattern: str, found: str, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = aiorts(capsys, "types", pattern)
    names = [line.split()[0] for line in out.splitlines()]
    assert found in names
    assert "TimedState" not in names


def test_no_match_and_a_group(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, err = aiorts(capsys, "types", "TimedDoubel")
    assert (status, out) == (6, "")
    assert "did you mean TimedDouble" in err
    _, out, _ = aiorts(capsys, "types", "--group", "basic")
    assert len(out.splitlines()) == 25


@pytest.mark.row(64)
def test_types_of_a_module_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my_records_1.py").write_text(
        "from aiorts.types import record\n@record\nclass MyGrip:\n    force: float = 1.5\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    _, out, _ = aiorts(capsys, "types", "MyGrip", "--type-mod", "my_records_1")
    assert out.split() == ["MyGrip", "user", "force:", "f64"]
    _, out, _ = aiorts(capsys, "inspect", "MyGrip")
    assert '{"force": 1.5}' in out
    status, _, err = aiorts(capsys, "types", "--type-mod", "no_such_module_1")
    assert (status, "no_such_module_1" in err) == (2, True)


def test_a_type_of_a_file_shows_units_and_what_is_required(arm: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:Grip")
    assert "of the fingers" in out
    assert " N " in out
    status, out, _ = aiorts(capsys, "inspect", f"{arm / 'arm.py'}:NoDefault")
    assert (status, "required" in out) == (0, True)
    assert example_of(int) == '{"port": "input0", "type": "int", "data": 0}'


PLAIN = """\
from dataclasses import dataclass

@dataclass
class {0}:
    marks: {1}
    at: float = 0.0
"""


def test_a_dataclass_that_a_file_imports_is_a_type_of_that_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "marks_1.py").write_text(PLAIN.format("MarksA", "list[int]"))
    (tmp_path / "robot_1.py").write_text("from marks_1 import MarksA\n")
    status, out, err = aiorts(capsys, "inspect", "MarksA", "--type-mod", f"{tmp_path / 'robot_1.py'}")
    assert (status, err) == (0, "")
    assert "seq[i64]  required" in out


@pytest.mark.parametrize(
    ("command", "expected"), [(("inspect", "MarksB"), 6), (("flexidump", "-p", "MarksB"), 2)], ids=["inspect", "filter"]
)
def test_a_dataclass_that_cannot_travel_is_told_with_its_field(
    command: tuple[str, ...], expected: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "marks_2.py").write_text(PLAIN.format("MarksB", "set[int]"))
    status, _, err = aiorts(capsys, *command, "--type-mod", f"{tmp_path / 'marks_2.py'}")
    assert status == expected
    assert "MarksB.marks: a value of type set[int] cannot travel; use" in err


LARGE = """\
from aiorts import Component, Param
from aiorts.types import Array, f64, record

@record
class Grid:
    cells: Array[f64] = (0.5,) * 90
    small: Array[f64] = (1.0, 2.0)

class Mapper(Component):
    start = Param((0.5,) * 90)
"""


@pytest.mark.parametrize("name", ["Grid", "Mapper"])
def test_a_large_default_is_short_and_on_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "large.py").write_text(LARGE)
    status, out, _ = aiorts(capsys, "inspect", f"{tmp_path / 'large.py'}:{name}")
    assert status == 0
    (line,) = [line for line in out.partition("As a line of JSON")[0].splitlines() if "0.5, " in line]
    assert line.endswith("[0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5,... (90 items)")
    assert ("= [1.0, 2.0]" in out) is (name == "Grid")
