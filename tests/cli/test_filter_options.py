"""The options of the filters: values that begin with "-", errors that name the option, modules of the user's types."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from run_parts import here

TYPES = """
from dataclasses import dataclass
from aiorts.types import record


@record
class Battery:
    tm: int = 0
    data: float = 0.0


@dataclass(frozen=True)
class Reading:
    volts: float = 0.0
    cells: int = 0
"""
SIX = {
    "flexiconst": ["-p", "TimedLong", "-c", "1", "--count", "1"],
    "flexidump": ["-p", "TimedLong"],
    "flexidupe": ["-p", "TimedLong:2"],
    "flexifilter": ["-i", "TimedLong", "-o", "TimedLong"],
    "flexiselect": ["-p", "TimedLong:2"],
    "flexiadd": ["-p", "TimedLong:2"],
}


def aiorts(
    *arguments: str, stdin: str = "", cwd: Path | None = None, path: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """`-P`: as the installed command, which has not the current folder where Python looks for modules."""
    found = [str(path)] if path is not None else []
    return subprocess.run(
        [sys.executable, "-P", "-c", "import sys; from aiorts.cli import main; sys.exit(main())", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=40,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*found, *filter(None, [os.environ.get("PYTHONPATH", "")])])},
    )


@pytest.mark.fault("F17")
@pytest.mark.parametrize(
    ("arguments", "stdin", "out"),
    [
        (["flexiconst", "-p", "TimedLong", "-c", "-5", "--count", "1"], "", '"data": -5}'),
        (["flexiconst", "-p", "TimedLong", "--const=-5", "--count", "1"], "", '"data": -5}'),
        (["flexidump", "-p", "TimedLong", "-v", "-1"], "7", "has new data"),
        (["flexifilter", "-i", "TimedLong", "-o", "TimedLong", "--clamp", "-5,5"], "-7", '"data": -5}'),
        (["flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "--nan", "-1"], '"NaN"', '"data": -1}'),
        (
            ["flexifilter", "-i", "TimedLong", "-o", "TimedLongSeq:2", "--reset", "-1", "-m", "0>0:1"],
            "7",
            '"data": [-1, 7]}',
        ),
    ],
)
def test_a_value_may_begin_with_a_minus_sign(arguments: list[str], stdin: str, out: str) -> None:
    done = here(*arguments, stdin=stdin)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith(f"{out}\n")


@pytest.mark.fault("F17")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["flexifilter", "-i", "TimedLong", "-o", "TimedLong", "--round", "up"],
            "--round 'up': must be one of 'nearest'",
        ),
        (["flexifilter", "-i", "TimedLong", "-o", "TimedLong", "--clamp", "-5,x"], "--clamp '-5,x': element 1 ('x')"),
        (
            ["flexifilter", "-i", "TimedLong", "-o", "TimedLong", "--check", "--overflow", "x"],
            "--overflow 'x': must be",
        ),
        (["flexiconst", "-p", "TimedLong", "-c", "1", "-r", "nan"], "--rate 'nan': must be > 0.0"),
        (["flexiconst", "-p", "TimedLong", "-c", "1", "--count", "-1"], "--count '-1'"),
        (["flexidump", "-p", "TimedLong", "--rate-limit", "-1"], "--rate-limit '-1': must be >= 0.0"),
        (["flexidump", "-p", "TimedLong", "-v", "much"], "--verbosity 'much': must be an int"),
    ],
)
def test_a_value_that_is_refused_is_named_with_its_option(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("aiorts: E-")
    assert said in line
    assert "draft" not in line


@pytest.mark.fault("F17")
@pytest.mark.parametrize(
    "options", [["-p", "TimedLong:2", "-p", "TimedLong:3"], ["-p", "TimedLong:2", "-v", "1", "-v", "2"]]
)
def test_an_option_given_twice_is_refused_and_none_of_it_forgotten(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["flexiadd", *options]) == 2
    assert f"--{'port' if options[2] == '-p' else 'verbosity'}: given 2 times; give it once" in capsys.readouterr().err


@pytest.mark.slow(kept_by="flexi/test_originals.py::test_types_of_any_module_can_be_used")
@pytest.mark.row(64)
@pytest.mark.parametrize(("where", "flag"), [("path", "--type-mod"), ("here", "-m")])
def test_types_of_a_module_of_the_user_can_be_used(tmp_path: Path, where: str, flag: str) -> None:
    (tmp_path / "mytypes.py").write_text(TYPES)
    places = {"cwd": tmp_path} if where == "here" else {"path": tmp_path}
    made = aiorts(
        *["flexiconst", flag, "mytypes", "-p", "Battery", "-c", "0.5", "-p", "mytypes.Reading"],
        *["-c", '{"volts": 12.5}', "--count", "1"],
        **places,
    )
    assert (made.returncode, made.stderr) == (0, "")
    lines = [json.loads(line) for line in made.stdout.splitlines()]
    assert [(line["type"], line["data"]) for line in lines] == [
        ("Battery", 0.5),
        ("Reading", {"volts": 12.5, "cells": 0}),
    ]
    shown = aiorts(
        *["flexifilter", "-i", "Reading", "-o", "Battery", "-m", "0:volts>2>0", "--type-mod", "mytypes"],
        stdin=json.dumps({"data": lines[1]["data"]}),
        **places,
    )
    assert (shown.returncode, json.loads(shown.stdout)["data"]) == (0, 25.0)


@pytest.mark.slow(kept_by="test_without_verbosity_nothing_is_said_of_the_ports")
@pytest.mark.row(64)
@pytest.mark.parametrize("name", sorted(SIX))
def test_each_of_the_six_takes_type_modules_and_a_verbosity(tmp_path: Path, name: str) -> None:
    (tmp_path / "mytypes.py").write_text(TYPES)
    arguments = [part.replace("TimedLong", "Battery") for part in SIX[name]]
    done = aiorts(name, *arguments, "--type-mod", "mytypes", "-v", "1", "--debug", cwd=tmp_path)
    assert done.returncode == 0
    assert "ports: " in done.stderr
    assert "Battery" in done.stderr


def test_without_verbosity_nothing_is_said_of_the_ports() -> None:
    done = here("flexidump", *SIX["flexidump"], "-v", "0", "--debug")
    assert done.returncode == 0
    assert "ports: " not in done.stderr


@pytest.mark.slow(kept_by="cli/test_plugins_commands.py::test_a_module_of_types_that_cannot_be_had_is_one_line")
@pytest.mark.fault("F05")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("def (", "SyntaxError"),
        ("import nowhere_at_all", "No module named 'nowhere_at_all'"),
        (None, "there is no such module; did you mean 'mytypes'?"),
    ],
)
def test_a_type_module_that_cannot_be_had_is_one_line(tmp_path: Path, text: str | None, said: str) -> None:
    (tmp_path / "mytypes.py").write_text(text or "")
    done = aiorts(
        "flexidump", "-p", "TimedLong", "--type-mod", "mytypes" if text else "mytipes", cwd=tmp_path, stdin="1"
    )
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("aiorts: E-PLUGIN: ")
    assert said in line


@pytest.mark.slow
def test_a_module_of_the_current_folder_takes_no_place_of_pythons_own(tmp_path: Path) -> None:
    (tmp_path / "wave.py").write_text("raise RuntimeError('not this one')")
    (tmp_path / "mytypes.py").write_text(f"import wave\n{TYPES}")  # which nobody has imported before
    done = aiorts("flexidump", "-p", "Battery", "--type-mod", "mytypes", cwd=tmp_path, stdin="1.5")
    assert (done.returncode, done.stderr) == (0, "")
