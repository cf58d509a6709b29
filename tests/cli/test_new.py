"""`aiorts new`: a plugin that runs, passes its test and is clean, for whatever ports; nothing half made."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.new.design import design
from aiorts.cli.new.project import files_of
from aiorts.system import check
from aiorts.types import all_types, full_name, has_tm

WORDS = {
    "ports": ("--in", "command:TimedDouble", "--in", "pose:TimedPose2D", "--out", "position:TimedDouble",
              "--out", "image:TimedOctetSeq"),
    "alone": (),
    "source": ("--out", "value:TimedLong", "--param", "gain=2.5", "--param", "name_:str=x", "--param", "on:bool=true"),
    "calls": ("--service", "gripper", "--service", "boss:required"),
    "turning": ("--flexi",),
}  # fmt: skip
"""Options by the name of what is made of them."""


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    """What a test has imported of its plugin is no package of the next one."""
    yield
    ours = {f"aiorts_{name}" for name in WORDS}
    for name in [one for one in sys.modules if one.partition(".")[0] in ours]:
        del sys.modules[name]


def made(tmp_path: Path, name: str) -> Path:
    assert run_command(["new", name, *WORDS[name], "--folder", str(tmp_path)]) == 0
    return tmp_path / name


def ran(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, timeout=100)


@pytest.mark.slow(kept_by="test_its_system_is_without_a_fault")
@pytest.mark.parametrize("name", WORDS)
def test_it_passes_its_test_and_is_clean(tmp_path: Path, name: str) -> None:
    folder = made(tmp_path, name)
    for words in (
        ("pytest", "-q", "-p", "no:cacheprovider"),
        ("mypy", "--strict", "."),
        ("ruff", "check", "--no-cache"),
    ):
        if words[0] != "pytest":
            pytest.importorskip(words[0])
        done = ran(folder, *words)
        assert done.returncode == 0, done.stdout + done.stderr
    for place in (folder, tmp_path):
        done = ran(place, "ruff", "format", "--no-cache", "--check", str(folder))
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", WORDS)
@pytest.mark.row(119)
def test_its_system_is_without_a_fault(tmp_path: Path, name: str) -> None:
    folder = made(tmp_path, name)
    assert [one for one in check(folder / "system.toml") if one.severity == "error"] == []


@pytest.mark.slow(kept_by="test_its_system_is_without_a_fault")
def test_its_system_runs_at_once(tmp_path: Path) -> None:
    folder = made(tmp_path, "ports")
    done = ran(tmp_path, "aiorts", "run", str(folder / "system.toml"), "--simulate", "--for", "1")
    assert (done.returncode, done.stderr) == (0, "")
    assert "position TimedDouble" in done.stdout
    assert "image TimedOctetSeq" in done.stdout


def test_any_type_can_be_that_of_a_port(tmp_path: Path) -> None:
    ours = {name: cls for name, cls in all_types().items() if full_name(cls).startswith("aiorts.types.")}
    named = [name for name, cls in ours.items() if not issubclass(cls, Enum) and has_tm(cls)]
    words = [f"p{number}:{name}" for number, name in enumerate(named)]
    texts = files_of(design("every", ins=words, outs=[f"out_{word}" for word in words]))
    for path, text in texts.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text)
    assert len(named) > 40
    assert [str(one) for one in check(tmp_path / "system.toml") if one.severity == "error"] == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["4x"], "that begins with a letter"),
        (["a/b"], "that begins with a letter"),
        (["x", "--in", "pose"], "expected PORT:TYPE, such as pose:TimedPose2D"),
        (["x", "--in", "on_execute:TimedLong"], "has this name already"),
        (["x", "--in", "class:TimedLong"], "has this name already"),
        (["x", "--in", "a b:TimedLong"], "letters, digits and _"),
        (["x", "--in", "a:TimedLong", "--out", "a:TimedLong"], "is given twice"),
        (["x", "--param", "a:real=1"], "expected one of bool, int, float, str"),
        (["x", "--param", "a:int=1.5"], "'1.5' is no int"),
        (["x", "--service", "a:offered"], "expected NAME:provided or NAME:required"),
        (["x", "--service", "x"], "two classes of x would have this name"),
        (["x", "--flexi", "--in", "a:TimedLong"], "leave --in, --out and --from away"),
        (["x", "--in", "self:TimedLong"], "has this name already"),
        (["x", "--in", "TimedLong:TimedLong"], "is the name of a class that is used"),
        (["x", "--param", "a:float=inf"], "'inf' is no float"),
        (["log"], "there is a package aiorts_log already"),
    ],
)
def test_a_wrong_word_is_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], says: str
) -> None:
    assert run_command(["new", *words, "--folder", str(tmp_path)]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_type_that_there_is_not_is_absent(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["new", "x", "--in", "pose:TimedPose2"]) == 6
    assert "TimedPose2D" in capsys.readouterr().err


def test_what_is_there_is_not_touched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fresh").mkdir()
    assert run_command(["new", "fresh", "--folder", str(tmp_path)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert list((tmp_path / "fresh").iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert run_command(["new", "fresh", "--folder", str(tmp_path / "file")]) == 2
    assert "cannot be written" in capsys.readouterr().err
