"""`aiorts new --from RTC.xml`: a component with all that the file says, that runs and is configured by its .conf."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from aiorts import Catalogue, Component, Param
from aiorts.cli.app import run_command
from aiorts.cli.new.project import literal
from aiorts.errors import ConfigurationError
from aiorts.system import check
from aiorts_openrtm.mapping.describing import description
from openrtm_parts import REAL

OPENING = """<?xml version="1.0" encoding="UTF-8"?>
<rtc:RtcProfile xmlns:rtc="http://www.openrtp.org/namespaces/rtc" xmlns:rtcDoc="urn:doc" xmlns:rtcExt="urn:ext"
  rtc:version="0.3" rtc:id="RTC:lab:arm:Arm_RTC:1.0">
"""
BASIC = """<rtc:BasicInfo rtc:name="Arm_RTC" rtc:description='Moves "it" C:\\new &amp; é.' rtc:executionRate="50"
  rtc:executionType="PeriodicExecutionContext"/>"""
CONFIGURATION = """<rtc:ConfigurationSet>
  <rtc:Configuration rtc:name="gain" rtc:type="double" rtc:defaultValue="2.5" rtc:unit="rad/s">
    <rtc:Constraint><rtc:ConstraintUnitType><rtc:propertyIsBetween>
      <rtc:LowerBoundary><rtc:Literal>0</rtc:Literal></rtc:LowerBoundary>
      <rtc:UpperBoundary><rtc:Literal>10</rtc:Literal></rtc:UpperBoundary>
    </rtc:propertyIsBetween></rtc:ConstraintUnitType></rtc:Constraint>
    <rtcExt:Properties rtcExt:name="__widget__" rtcExt:value="slider.0.5"/>
    <rtcDoc:Doc rtcDoc:description='How "hard" it pulls; it says so in more words than a line holds'/>
  </rtc:Configuration>
  <rtc:Configuration rtc:name="mode" rtc:type="string" rtc:defaultValue="soft"/>
  <rtc:Configuration rtc:name="count" rtc:type="int" rtc:defaultValue=""/>
  <rtc:Configuration rtc:name="on" rtc:type="bool" rtc:defaultValue="true"/>
  <rtc:Configuration rtc:name="offsets" rtc:type="std::vector&lt;double&gt;" rtc:defaultValue="1,2.5"/>
  <rtc:Configuration rtc:name="loose" rtc:type="short" rtc:defaultValue="3">
    <rtcExt:Properties rtcExt:name="__widget__" rtcExt:value="slider"/>
  </rtc:Configuration>
</rtc:ConfigurationSet>"""
PORTS = """<rtc:DataPorts rtc:portType="DataInPort" rtc:name="angle" rtc:type="RTC::TimedDouble" rtc:unit="rad">
  <rtcDoc:Doc rtcDoc:description="Where to."/></rtc:DataPorts>
<rtc:DataPorts rtc:portType="DataOutPort" rtc:name="class" rtc:type="RTC::TimedDouble"/>
<rtc:DataPorts rtc:portType="DataOutPort" rtc:name="pose" rtc:type="RTC::TimedPose3D"/>
<rtc:ServicePorts rtc:name="brake"><rtc:ServiceInterface rtc:direction="Provided" rtc:name="stop" rtc:type="Brake"/>
</rtc:ServicePorts>
<rtc:ServicePorts rtc:name="both"><rtc:ServiceInterface rtc:direction="Provided" rtc:name="one" rtc:type="One"/>
<rtc:ServiceInterface rtc:direction="Required" rtc:name="two" rtc:type="Two"/></rtc:ServicePorts>"""
WHOLE = f"{OPENING}{BASIC}{CONFIGURATION}{PORTS}</rtc:RtcProfile>"
CONF = "conf.default.gain: 4.5\nconf.default.mode: stiff\nconf.default.offsets: 3,4\nconf.fast.gain: 9\n"


def arm(folder: Path, text: str = WHOLE, name: str = "arm", *more: str) -> int:
    (folder / "RTC.xml").write_text(text, encoding="utf-8")
    return run_command(["new", name, "--from", str(folder / "RTC.xml"), "--folder", str(folder), *more])


def ran(folder: Path, *words: str) -> str:
    done = subprocess.run([sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def made_of(folder: Path, name: str = "arm") -> Any:
    """The class that was made."""
    catalogue = Catalogue((folder / name,))
    (found,) = (one for one in catalogue.extensions("components").values() if one[0].folder is not None)
    return found[0].load()


def test_all_that_the_file_says_is_in_the_component(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert arm(tmp_path, name="whole_arm") == 0
    said = capsys.readouterr().err
    assert "RTC.xml:" in said
    assert "needs a lower and an upper bound; it is left out" in said
    assert "its methods are in IDL" in said
    cls = made_of(tmp_path, "whole_arm")
    assert cls.__doc__ == "Moves 'it' C:\\new & é."
    made = cls("arm0")
    gain = made.params["gain"].spec
    assert (gain.default, gain.unit, str(gain.constraint), gain.widget) == (2.5, "rad/s", "0 <= x <= 10", "slider.0.5")
    assert gain.doc.startswith('How "hard" it pulls')
    values = made.params.values_in_force
    assert values == {"gain": 2.5, "mode": "soft", "count": 0, "on": True, "offsets": (1.0, 2.5), "loose": 3}
    assert list(map(type, values.values())) == [float, str, int, bool, tuple, int]
    assert set(made.ports) >= {"angle", "class", "pose", "brake", "both"}
    assert (made.ports["angle"].unit, made.ports["angle"].doc) == ("rad", "Where to.")
    system = tomllib.loads((tmp_path / "whole_arm" / "system.toml").read_text())
    assert system["contexts"]["loop"]["rate"] == 50.0


@pytest.mark.slow(kept_by="test_all_that_the_file_says_is_in_the_component")
def test_it_runs_passes_its_test_and_every_checker(tmp_path: Path) -> None:
    assert arm(tmp_path) == 0
    folder = tmp_path / "arm"
    ran(tmp_path, "aiorts", "run", str(folder / "system.toml"), "--simulate", "--for", "1")
    ran(folder, "pytest", "-q", "-p", "no:cacheprovider")
    ran(folder, "ruff", "check", "--no-cache")
    ran(folder, "ruff", "format", "--no-cache", "--check", ".")
    ran(folder, "mypy", "--strict", ".")
    ran(folder, "pyright", "--pythonpath", sys.executable, ".")


@pytest.mark.slow(kept_by="test_all_that_the_file_says_is_in_the_component")
@pytest.mark.parametrize("conf", [CONF, "conf.default.gain: 12\n"], ids=["fits", "outside"])
def test_it_runs_and_is_configured_by_its_conf(
    tmp_path: Path, conf: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert arm(tmp_path) == 0
    (tmp_path / "Arm_RTC0.conf").write_text(conf)
    assert run_command(["import", "Arm_RTC0.conf", "-o", "system.toml"]) == 0
    code = tmp_path / "arm" / "aiorts_arm" / "component.py"
    shown = "        print(self.gain, self.mode, self.offsets, self.count)\n        self.finish()\n"
    text = code.read_text()
    at = text.index("        for angle in")
    code.write_text(text[:at] + shown + text[at:])
    words = [sys.executable, "-m", "aiorts", "run", "system.toml", "--simulate", "--for", "1"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    if conf == CONF:
        assert (done.returncode, done.stdout) == (0, "4.5 stiff (3.0, 4.0) 0\n"), done.stderr
    else:
        assert done.returncode != 0
        assert "must be <= 10" in done.stderr


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("TimedPose3D", "TimedPoze3D", "port pose: "),
        ('rtc:name="mode"', 'rtc:name="a b"', "letters, digits and _"),
        ('rtc:name="mode"', 'rtc:name="name"', "has this name already"),
        ('rtc:name="mode"', 'rtc:name="gain"', "is given twice"),
        ("rtc:BasicInfo", "rtc:BasikInfo", "BasicInfo is missing"),
        ("</rtc:ConfigurationSet>", "", "RTC.xml:"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place_and_nothing_is_written(
    tmp_path: Path, old: str, new: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert arm(tmp_path, WHOLE.replace(old, new)) == 2
    assert says in capsys.readouterr().err
    assert [one.name for one in tmp_path.iterdir()] == ["RTC.xml"]


def test_a_file_that_no_plugin_reads_says_what_to_install(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in ("a.idl", "a"):
        assert run_command(["new", "arm", "--from", file, "--folder", str(tmp_path)]) != 0
        assert "no plugin that is installed reads files" in capsys.readouterr().err
    assert run_command(["new", "arm", "--from", str(tmp_path / "none.xml"), "--folder", str(tmp_path)]) == 2
    assert "none.xml" in capsys.readouterr().err


def test_without_the_plugin_it_is_said_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Catalogue, "extensions", lambda *_: {})
    assert arm(tmp_path) == 2
    assert "install one that offers this, as aiorts_openrtm does for RTC.xml" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("rated", '"50"', '"1e12"', "it is 10.0"),
        ("placed", 'name="angle"', 'name="位置 1"', "a port cannot be called '位置 1' here; it is port_1"),
        ("served", 'name="brake"', 'name="止"', "a port cannot be called '止' here; it is service"),
        ("offered", "Arm_RTC", "腕", "is no name for a component here"),
    ],
)
def test_what_has_another_name_or_rate_here_is_said_and_runs(
    tmp_path: Path, name: str, old: str, new: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert arm(tmp_path, WHOLE.replace(old, new), name) == 0
    assert says in capsys.readouterr().err
    assert [one for one in check(tmp_path / name / "system.toml") if one.severity == "error"] == []


def test_options_add_to_the_file(tmp_path: Path) -> None:
    assert arm(tmp_path, WHOLE, "more_arm", "--out", "extra:TimedLong", "--param", "depth=2") == 0
    made = made_of(tmp_path, "more_arm")("arm0")
    assert "extra" in made.ports
    assert made.params["depth"].value == 2


@pytest.mark.parametrize("text", ['a"b', "a'b", "\"'", "\\", "\u202e\n\0", "é😀", '""\''])
def test_any_text_is_itself_again(text: str) -> None:
    assert eval(literal(text)) == text
    assert eval(literal((text,))) == (text,)
    assert literal(text).isprintable()


@pytest.mark.slow(kept_by="test_all_that_the_file_says_is_in_the_component")
@pytest.mark.skipif(REAL is None, reason="the files of the robot arm are not here")
def test_the_real_component_is_made_and_runs(tmp_path: Path) -> None:
    assert REAL is not None
    words = ["new", "gui", "--from", str(REAL / "gui_mycobot_RTC.xml"), "--folder", str(tmp_path)]
    assert run_command(words) == 0
    shown = ran(tmp_path, "aiorts", "run", "gui/system.toml", "--simulate", "--for", "0.01")
    assert "poseOut TimedPose3D" in shown


# -- one reading of a text, notes, lines -------------------------------------------------------------------------------

READINGS = [
    *(("bool", text) for text in ("1", "0", "YES", "no", "on", "Off", "true", "maybe", "2")),
    *(("int", text) for text in ("0x10", "1_000", " 7 ", "-3", "1.5", "many", "0b11")),
    *(("double", text) for text in ("1e3", "1_000.5", "nan", "inf", "x")),
    *(("short", "0x10"), ("std::vector<int>", "0x10,2"), ("std::vector<int>", "1,x")),
]


@pytest.mark.parametrize(("kind", "text"), READINGS)
def test_a_default_is_read_as_a_parameter_reads_it_or_it_is_a_note(
    kind: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    configuration = f'<rtc:ConfigurationSet><rtc:Configuration rtc:name="p" rtc:type="{kind.replace("<", "&lt;")}"'
    configuration += f' rtc:defaultValue="{text}"/></rtc:ConfigurationSet>'
    assert arm(tmp_path, f"{OPENING}{BASIC}{configuration}</rtc:RtcProfile>") == 0
    said = capsys.readouterr().err
    bare = kind.removeprefix("std::vector<").removesuffix(">")
    zero = {"bool": False, "double": 0.0}.get(bare, 0)
    parameter: Any = type("Read", (Component,), {"p": Param(zero)})()
    expected, doubtful = [], False
    for part in text.split(",") if "vector" in kind else [text]:
        try:
            value = parameter.params.check({"p": part})["p"]
        except ConfigurationError:
            value = math.nan
        doubtful = doubtful or not math.isfinite(value)
        expected.append(value if math.isfinite(value) else zero)
    (found,) = (one.default for one in description(tmp_path / "RTC.xml").parameters)
    assert found == (tuple(expected) if "vector" in kind else expected[0])
    assert type(found) is (tuple if "vector" in kind else type(zero))
    assert ("RTC.xml:5: p: default" in said) is doubtful


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (
            '<rtc:ConfigurationSet>\n<rtc:Configuration rtc:name="k" rtc:type="int"/>\n'
            '<rtc:Configuration rtc:name="k" rtc:type="int"/></rtc:ConfigurationSet>',
            "RTC.xml:7: k: is given twice (first in line 6)",
        ),
        (
            '<rtc:DataPorts rtc:portType="DataInPort" rtc:name="a" rtc:type="RTC::TimedDouble"/>\n'
            '<rtc:DataPorts rtc:portType="DataInPort" rtc:name="a" rtc:type="RTC::TimedDouble"/>',
            "RTC.xml:6: a: is given twice (first in line 5)",
        ),
        (
            '<rtc:ServicePorts rtc:name="s">'
            '<rtc:ServiceInterface rtc:direction="Provided" rtc:name="i" rtc:type="I"/>\n'
            '<rtc:ServiceInterface rtc:direction="Provided" rtc:name="i" rtc:type="I"/></rtc:ServicePorts>',
            "RTC.xml:6: i: is given twice (first in line 5)",
        ),
    ],
)
def test_what_is_given_twice_is_said_with_both_lines(
    inside: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert arm(tmp_path, f"{OPENING}{BASIC}{inside}</rtc:RtcProfile>") == 2
    err = capsys.readouterr().err
    assert f"E-OPENRTM: {tmp_path}/{said}" in err


def test_a_widget_that_needs_no_bounds_stays_where_the_constraint_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = WHOLE.replace('rtc:defaultValue="2.5"', 'rtc:defaultValue="20"').replace('"slider.0.5"', '"text"')
    assert arm(tmp_path, text, "arm_text") == 0
    assert "its constraint is left out" in capsys.readouterr().err
    assert made_of(tmp_path, "arm_text")("arm0").params["gain"].spec.widget == "text"


@pytest.mark.parametrize("default", ["20", "much"])
def test_a_default_outside_its_constraint_costs_the_constraint_alone(
    default: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = WHOLE.replace('rtc:defaultValue="2.5"', f'rtc:defaultValue="{default}"')
    if default == "much":
        text = text.replace("<rtc:Literal>0<", "<rtc:Literal>1<")
    name = f"arm_{default}"
    assert arm(tmp_path, text, name) == 0
    assert "its constraint is left out" in capsys.readouterr().err
    gain = made_of(tmp_path, name)("arm0").params["gain"].spec
    assert gain.default == (20.0 if default == "20" else 0.0)


DIO = """<rtc:DataPorts rtc:portType="DataInPort" rtc:name="DIO" rtc:type="RTC::TimedULong"/>
<rtc:DataPorts rtc:portType="DataOutPort" rtc:name="DIO" rtc:type="RTC::TimedULong"/>
<rtc:ConfigurationSet><rtc:Configuration rtc:name="AI" rtc:type="int" rtc:defaultValue="1"/></rtc:ConfigurationSet>
<rtc:DataPorts rtc:portType="DataInPort" rtc:name="AI" rtc:type="RTC::TimedDouble"/>"""


@pytest.mark.slow(kept_by="test_a_default_outside_its_constraint_costs_the_constraint_alone")
def test_an_in_port_and_an_out_port_of_one_name_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert arm(tmp_path, f"{OPENING}{BASIC}{DIO}</rtc:RtcProfile>") == 0
    assert "RTC.xml:6: there is an in-port 'DIO', too; the out-port is 'DIO_out' here" in capsys.readouterr().err
    assert not [one for one in check(tmp_path / "arm" / "system.toml") if one.severity == "error"]
    done = ran(tmp_path / "arm", "aiorts", "run", "system.toml", "--simulate", "--for", "1", "--control=off")
    assert "Traceback" not in done
