"""`aiorts demo` runs anywhere, ends by itself, tells the truth, and what it saves works."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.cli.demo.chart import Strip
from run_parts import here

HOSTILE = {"LANG": "C", "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "TERM": "dumb", "COLUMNS": "1", "NO_COLOR": "1"}


def aiorts(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "aiorts", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=40)


def start(environment: dict[str, str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "aiorts", "demo"],
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow(kept_by="test_the_chart_shows_both_and_stays_within_its_width")
@pytest.mark.fault("F14")
def test_it_runs_without_a_terminal_and_in_any_surroundings(tmp_path: Path) -> None:
    began = time.monotonic()
    runs = [start({}), start({**HOSTILE, "HOME": str(tmp_path / "none")})]
    for process in runs:
        out, err = process.communicate(timeout=40)
        assert (process.returncode, err) == (0, "")
        assert out.isascii()
        assert "\x1b" not in out
        written, delivered, dropped, waiting = map(
            int,
            re.search(r"(\d+) samples were written: (\d+) .* \+ (\d+) dropped \+ (\d+) waiting = all", out).groups(),  # type: ignore[union-attr]
        )
        assert written == delivered + dropped + waiting > 1000
        assert "gave the same 301 values" in out
        assert len([line for line in out.splitlines() if re.match(r" \d\.\d ", line)]) == 30
        for command in (
            "aiorts demo --save motor",
            "aiorts run motor/system.toml",
            "aiorts inspect motor/motor.py:Control",
        ):
            assert command in out
    assert time.monotonic() - began < 40  # it ends within 5 s on a machine of its own


@pytest.mark.slow(kept_by="test_the_chart_shows_both_and_stays_within_its_width")
def test_its_source_is_a_program_that_runs(tmp_path: Path) -> None:
    source = here("demo", "--source")
    assert (source.returncode, source.stderr) == (0, "")
    (tmp_path / "motor.py").write_text(source.stdout)
    done = subprocess.run([sys.executable, "motor.py"], cwd=tmp_path, capture_output=True, text=True, timeout=40)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) >= 10


@pytest.mark.slow(kept_by="test_nothing_is_overwritten")
def test_what_it_saves_runs_and_passes_its_tests(tmp_path: Path) -> None:
    saved = here(tmp_path, "demo", "--save", "my motor/first")
    assert (saved.returncode, saved.stderr) == (0, "")
    folder = tmp_path / "my motor" / "first"
    assert sorted(path.name for path in folder.iterdir()) == ["motor.py", "system.toml", "test_motor.py"]
    done = aiorts("run", str(folder / "system.toml"), "--simulate")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert len(lines) >= 25
    assert abs(int(lines[-1].rpartition(" ")[2]) - 50 * 9.5493) < 50
    assert here("run", str(folder / "system.toml"), "--simulate", "--set", "motor.load=2").stdout != done.stdout
    assert here("inspect", f"{folder / 'motor.py'}:Control").returncode == 0
    tested = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=40,
    )
    assert tested.returncode == 0, tested.stdout
    assert "2 passed" in tested.stdout


@pytest.mark.parametrize("name", ["motor.py", "system.toml", "test_motor.py"])
def test_nothing_is_overwritten(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_text("mine")
    assert run_command(["demo", "--save", str(tmp_path)]) == 2
    assert f"has {name} already; nothing was written" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_a_link_that_leads_nowhere_is_not_followed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "motor.py").symlink_to(tmp_path / "elsewhere")
    assert run_command(["demo", "--save", str(tmp_path)]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.fault("F16")
@pytest.mark.parametrize("where", ["a file", "/proc/no/such", "nul\0"])
def test_where_nothing_can_be_written_is_one_line(
    where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a file").write_text("")
    assert run_command(["demo", "--save", str(tmp_path / where)]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert said.startswith("aiorts: E-")


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("F11")
def test_a_reader_that_has_seen_enough_ends_it_quietly() -> None:
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m aiorts demo | head -3"], capture_output=True, text=True, timeout=40
    )
    assert (len(done.stdout.splitlines()), done.stderr) == (3, "")


def test_the_chart_shows_both_and_stays_within_its_width() -> None:
    strip = Strip(100.0, 11)
    assert strip.line(50.0, 100.0) == "     *    :"
    assert strip.line(50.0, 50.0) == "     #"
    assert strip.line(-5.0, 500.0) == "*         :"
    assert len(Strip(100.0, -5).line(100.0, 0.0)) == 10
