"""`convert` in a system file: a text that is found beside the file or by a plugin, checked before anything runs."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import AiortsError, PluginError, SystemFileError, WiringError
from aiorts.system import build, check, load

UNITS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble, TimedLong
class Lidar(Component):
    out = OutPort(TimedDouble, unit="m")
class Display(Component):
    inp = InPort(TimedLong, unit="mm")
class Plain(Component):
    inp = InPort(TimedDouble, unit="m")
class Bare(Component):
    inp = InPort(float)
"""
SCALING = """
from aiorts.types import TimedDouble, TimedLong
def to_mm(sample: TimedDouble) -> TimedLong:
    return TimedLong(sample.tm, round(sample.data * 1000))
def two(a, b): return a
def bare(sample): return sample.data
"""
FILE = """schema = 1
[components.lidar]
type = "units.py:Lidar"
[components.display]
type = "units.py:Display"
[[connections]]
from = "lidar.out"
to = "display.inp"
convert = {convert}
[contexts.main]
kind = "event"
members = ["lidar", "display"]
"""


def written(folder: Path, convert: str, old: str = "", new: str = "") -> Path:
    (folder / "units.py").write_text(UNITS)
    (folder / "scaling.py").write_text(SCALING)
    path = folder / "system.toml"
    path.write_text(FILE.format(convert=convert).replace(old, new) if old else FILE.format(convert=convert))
    return path


async def run(path: Path) -> tuple[Any, int]:
    async with Kernel() as kernel:
        await build(kernel, load(path))
        find: Any = kernel.find
        find("lidar.out").write_nowait(find("lidar.out").type(3, 1.5))
        (connector,) = kernel.connectors.values()
        return connector.profile.convert, find("display.inp").read_nowait().data


@pytest.mark.parametrize("text", ["scaling.py:to_mm", "map 0>1000>0"])
def test_a_text_converts_counted_from_the_files_folder_and_check_has_nothing_to_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    path = written(tmp_path, f'"{text}"')
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert [one for one in check(path) if one.severity != "note"] == []
    assert asyncio.run(run(path)) == (text, 1500)


@pytest.mark.parametrize(
    ("convert", "error", "said"),
    [
        ('"scalin.py:to_mm"', PluginError, "did you mean 'scaling.py:to_mm'?"),
        ('"scaling.py:to_mmm"', PluginError, "there is no 'to_mmm'; did you mean 'to_mm'?"),
        ('"scaling.py:two"', PluginError, "cannot be called with one sample alone"),
        ('"mpa 0>0"', PluginError, "no converter named 'mpa'; did you mean map?"),
        ('"map 0>1>"', WiringError, "convert = map 0>1>: map '0>1>', character 5"),
        ('"../scaling.py:to_mm"', SystemFileError, "is outside the system file's folder"),
        ('""', WiringError, "expected a text that names a converter"),
        ("3", WiringError, "convert = 3: expected text"),
    ],
)
def test_what_finds_none_is_found_with_its_place_and_refused_at_the_build(
    tmp_path: Path, convert: str, error: type[AiortsError], said: str
) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "scaling.py").write_text(SCALING)
    path = written(tmp_path / "inner", convert)
    (finding,) = (one for one in check(path) if one.severity == "error")
    assert said in f"{finding.cause}; {finding.remedy}"
    assert finding.line == 9
    assert finding.quote[finding.column - 1 :].startswith(convert)
    with pytest.raises(error) as caught:
        asyncio.run(run(path))
    assert said in str(caught.value)
    assert f"{path}:" in str(caught.value)


def test_what_it_makes_is_held_to_the_in_port_and_a_stamp_needs_a_time_there(tmp_path: Path) -> None:
    path = written(tmp_path, '"scaling.py:to_mm"', "units.py:Display", "units.py:Plain")
    (finding,) = (one for one in check(path) if one.severity == "error")
    assert "returns TimedLong as it says, the in-port takes TimedDouble" in f"{finding.cause}; {finding.remedy}"
    path = written(tmp_path, '"scaling.py:bare"\nstamp = "send"', "units.py:Display", "units.py:Bare")
    (finding,) = (one for one in check(path) if one.severity == "error")
    assert finding.cause == "display.inp takes float, which has no field tm to put it in"
    with pytest.raises(WiringError, match="float has no field tm"):
        asyncio.run(run(path))


def test_without_it_check_says_what_would_convert(tmp_path: Path) -> None:
    path = written(tmp_path, '"scaling.py:to_mm"', 'convert = "scaling.py:to_mm"', "")
    assert any("types differ" in one.cause for one in check(path))
