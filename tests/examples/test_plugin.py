"""The example plugin as a newcomer meets it: as it lies there, and installed beside aiorts in a new environment."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGIN = ROOT / "examples" / "plugin"
DRAWS = importlib.util.find_spec("matplotlib") is not None


def run(*command: str | Path, stdin: str = "", cwd: Path = ROOT) -> str:
    path = os.pathsep.join([str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        list(map(str, command)),
        input=stdin,
        capture_output=True,
        text=True,
        timeout=60,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.environ.get("PYTHONPATH") or path},
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    return done.stdout


def in_use(*aiorts: str | Path, cwd: Path) -> None:
    """The component, the type and the command, from a command line."""
    states = run(*aiorts, "batterywatch", "--cells", "3", stdin='{"tm": 1, "data": 12.6}\n', cwd=cwd)
    state = {"voltage": 12.6, "charge": 1.0, "low": False}
    assert json.loads(states)["type"] == "BatteryState"
    assert json.loads(states)["data"] == state
    shown = run(*aiorts, "flexidump", "-p", "BatteryState", "--field", "charge", stdin=states, cwd=cwd)
    assert "BatteryState 0.000000001: " in shown
    assert "1.0" in shown
    assert run(*aiorts, "battery-life", "--capacity", "5", "--current", "2.5", cwd=cwd) == "2 h 00 min\n"
    listed = json.loads(run(*aiorts, "plugins", "--json", cwd=cwd))
    offered = {one["kind"]: one["name"] for one in listed["extensions"] if "aiorts_battery" in one["target"]}
    assert offered == {
        "components": "BatteryWatch",
        "types": "BatteryState",
        "commands": "battery-life",
        "codecs": "deflate",
        "services": "battery",
    }


def recordings(*aiorts: str | Path, cwd: Path) -> None:
    """Its type in recordings: every command of `aiorts log`, replay, filters and lists know it without any option."""
    lines = "".join(f'{{"tm": {tm}, "data": {11 + tm / 10}}}\n' for tm in range(9))
    states = run(*aiorts, "batterywatch", stdin=lines, cwd=cwd)
    run(*aiorts, "flexilogger", "-p", "BatteryState", "-l", "run.mcap", stdin=states, cwd=cwd)
    log = (*aiorts, "log")
    full = "aiorts_battery.records.BatteryState"
    info = json.loads(run(*log, "info", "run.mcap", "--check", "--json", cwd=cwd))
    assert [(port["type"], port["unknown"]) for port in info["ports"]] == [(full, "")]
    assert [json.loads(line)["type"] for line in run(*log, "cat", "run.mcap", cwd=cwd).splitlines()] == [
        "BatteryState"
    ] * 9
    run(*log, "convert", "run.mcap", "run.csv", cwd=cwd)
    run(*log, "convert", "run.csv", "new.mcap", "--port", "input0", "--type", "BatteryState", cwd=cwd)
    run(*log, "cut", "new.mcap", "cut.mcap", "--start", "+0", cwd=cwd)
    run(*log, "merge", "new.mcap", "cut.mcap", "both.mcap", "--prefix", "a.", "--prefix", "b.", cwd=cwd)
    run(*log, "salvage", "new.mcap", "whole.mcap", cwd=cwd)
    assert run(*log, "diff", "run.mcap", "whole.mcap", cwd=cwd) == "equal: 9 samples of 1 port\n"
    if DRAWS:
        run(*log, "plot", "run.mcap", "input0.charge", "-o", "run.svg", cwd=cwd)
    replayed = run(*aiorts, "flexilogger", "-o", "-l", "run.mcap", "--speed", "max", "--absolute", cwd=cwd)
    filtered = (*aiorts, "flexifilter", "-i", full, "-o", "TimedDouble", "-m", "0:voltage>1>0")
    voltages = [json.loads(line)["data"] for line in run(*filtered, stdin=replayed, cwd=cwd).splitlines()]
    assert voltages == [11 + tm / 10 for tm in range(9)]
    assert full in run(*aiorts, "types", "battery*", "--json", cwd=cwd)


@pytest.mark.slow(kept_by="log/test_declared_types.py::test_every_command_imports_a_module_of_types_that_it_is_told")
@pytest.mark.row(64)
@pytest.mark.parametrize(
    "command",
    [
        ["info", "run.mcap"],
        ["cat", "run.mcap"],
        ["convert", "run.mcap", "new.csv"],
        ["cut", "run.mcap", "new.mcap"],
        ["merge", "run.mcap", "run.mcap", "new.mcap", "--join"],
        ["diff", "run.mcap", "run.mcap"],
        pytest.param(
            ["plot", "run.mcap", "input0.charge", "-o", "new.svg"],
            marks=pytest.mark.skipif(not DRAWS, reason="matplotlib is not installed"),
        ),
        ["salvage", "run.mcap", "new.mcap"],
    ],
    ids=lambda command: command[0],
)
def test_a_command_that_is_told_the_module_needs_no_plugin(command: list[str], tmp_path: Path) -> None:
    aiorts = (sys.executable, "-m", "aiorts")
    samples = run(*aiorts, "--plugins", PLUGIN, "batterywatch", stdin='{"tm": 1, "data": 12.6}\n', cwd=tmp_path)
    write = ("flexilogger", "-p", "BatteryState", "-l", "run.mcap")
    run(*aiorts, "--plugins", PLUGIN, *write, stdin=samples, cwd=tmp_path)
    (tmp_path / "aiorts_battery").symlink_to(PLUGIN / "aiorts_battery")
    told = run(*aiorts, "log", *command, "--type-mod", "aiorts_battery.records", cwd=tmp_path)
    assert "no type" not in told


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(64)
def test_as_it_lies_there(tmp_path: Path) -> None:
    in_use(sys.executable, "-m", "aiorts", "--plugins", PLUGIN, cwd=tmp_path)


@pytest.mark.slow(kept_by="log/test_declared_types.py::test_every_command_imports_a_module_of_types_that_it_is_told")
@pytest.mark.row(64)
def test_as_it_lies_there_its_type_is_known_in_recordings(tmp_path: Path) -> None:
    recordings(sys.executable, "-m", "aiorts", "--plugins", PLUGIN, cwd=tmp_path)


@pytest.mark.slow(kept_by="test_as_it_lies_there")
@pytest.mark.row(54)
def test_its_codec_stands_between_two_filters(tmp_path: Path) -> None:
    aiorts = (sys.executable, "-m", "aiorts", "--plugins", PLUGIN)
    frames = ["flexiconst", "-p", "TimedLong", "-c", "7", "--count", "2", "-r", "100", "--codec", "deflate"]
    dump = ["flexidump", "-p", "TimedLong", "--format", "values", "--codec", "deflate"]
    made = subprocess.run([*aiorts, *frames], capture_output=True, timeout=40, cwd=tmp_path)
    dumped = subprocess.run([*aiorts, *dump], input=made.stdout, capture_output=True, timeout=40, cwd=tmp_path)
    assert (dumped.returncode, dumped.stdout.split(), dumped.stderr) == (0, [b"7", b"7"], b"")


@pytest.mark.slow(kept_by="test_as_it_lies_there")
@pytest.mark.row(64)
@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling is not installed")
def test_built_and_installed_in_a_new_environment(tmp_path: Path) -> None:
    copy = tmp_path / "source"
    for file in sorted(PLUGIN.rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts:
            (copy / file.relative_to(PLUGIN)).parent.mkdir(parents=True, exist_ok=True)
            (copy / file.relative_to(PLUGIN)).write_bytes(file.read_bytes())
    build = ("-m", "pip", "wheel", "-q", "--no-deps", "--no-index", "--no-build-isolation", "-w", tmp_path, copy)
    run(sys.executable, *build, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    folder = tmp_path / "env"
    venv.create(folder, symlinks=True, with_pip=False)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    install = ("-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    run(sys.executable, *install, cwd=tmp_path)
    # aiorts itself is where it is for this test: the dependencies' folder, and the checkout.
    site = Path(sysconfig.get_path("purelib", "venv", vars={"base": str(folder), "platbase": str(folder)}))
    here = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    added = [str(ROOT), str(ROOT / "plugins"), *sorted(here)]
    (site / "dependencies.pth").write_text(f"import sys; sys.path.extend({added!r})\n")
    in_use(python, "-m", "aiorts", cwd=tmp_path)
    recordings(python, "-m", "aiorts", cwd=tmp_path)
    found = run(python, "-c", "import aiorts_battery; print(aiorts_battery.__file__)", cwd=tmp_path)
    assert str(site) in found


@pytest.mark.slow(kept_by="test_as_it_lies_there")
def test_its_own_tests_pass() -> None:
    told = run(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", PLUGIN / "tests")
    assert "passed" in told
    assert "skipped" not in told
