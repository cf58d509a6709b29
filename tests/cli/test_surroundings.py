"""Commands in surroundings that are poor or broken: locale, home, current folder, temporary files, umask."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from run_parts import aiorts, folder_of, here

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")

COMMANDS = {
    "run": ("run", "{folder}/system.toml", "--for", "0.1", "--log-file", "{folder}/run.log"),
    "filter": ("flexiconst", "-p", "TimedLong", "-c", "1", "-r", "50", "--count", "1"),
    "plugins": ("plugins", "--check", "--plugins", "{folder}"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return folder_of(tmp_path)


@pytest.mark.slow
@pytest.mark.fault("F16")
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("home", "env"),
    [
        ("umask 000", {"HOME": None}),
        ("umask 000", {"HOME": "/nowhere", "TMPDIR": "/nowhere"}),
        ("umask 000", {"HOME": "/proc", "TMPDIR": "/proc"}),  # nobody writes there
        ("umask 777", {}),
        ('mkdir "$0.gone" && cd "$0.gone" && rmdir "$0.gone"', {}),
    ],
    ids=["no-home", "missing", "read-only", "umask", "deleted-cwd"],
)
def test_it_works_or_says_in_a_line_why_not(folder: Path, command: str, home: str, env: dict[str, str | None]) -> None:
    if command == "plugins" and os.environ.get("AIORTS_CAMPAIGN") != "1":
        pytest.skip("imports every plugin each time: in the campaign")
    arguments = [part.format(folder=folder) for part in COMMANDS[command]]
    surroundings = {**os.environ, **{name: value for name, value in env.items() if value is not None}}
    for name, value in env.items():
        if value is None:
            surroundings.pop(name, None)
    done = subprocess.run(
        ["sh", "-c", f'{home} && exec "$@"', str(folder / "x"), sys.executable, "-m", "aiorts", *arguments],
        env=surroundings,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


@pytest.mark.slow(kept_by="test_arguments_that_are_no_text_are_one_line")
@pytest.mark.fault("F16")
def test_a_component_by_file_from_a_deleted_folder_is_one_line(folder: Path) -> None:
    gone = folder / "gone"
    gone.mkdir()
    for target in ("parts.py:Counter", "nix"):
        done = subprocess.run(
            ["sh", "-c", 'cd gone && rmdir ../gone && exec "$@"', "sh", sys.executable, "-m", "aiorts", "run", target],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=40,
            check=False,
        )
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1, done.stderr
        gone.mkdir()


@pytest.mark.slow(kept_by="cli/test_quote.py::test_what_the_stream_cannot_write_is_measured_as_it_is_shown")
@pytest.mark.fault("F14")
@pytest.mark.parametrize(
    "env",
    [
        {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONIOENCODING": "ascii"},
        {"TERM": "dumb", "COLUMNS": "1", "NO_COLOR": "1"},
        {"TERM": "", "COLUMNS": "x", "LINES": "-1"},
    ],
)
def test_what_cannot_be_shown_is_escaped(folder: Path, env: dict[str, str]) -> None:
    surroundings: Any = {**os.environ, **env}
    (folder / "size.py").write_text(
        "from aiorts import Component\nclass Size(Component):\n"
        "    def on_execute(self):\n        self.log.warning('grün \\x1b[31m \\udcff')\n",
        encoding="utf-8",
    )
    for form in ("text", "json"):
        arguments = ("--for", "0.1", "--log-format", form, "--log-file", f"log.{form}")
        done = aiorts(folder, "run", "size.py:Size", *arguments, env=surroundings, encoding="utf-8")
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        assert "\x1b" not in done.stderr
        assert "r\\xfcn" in done.stderr or "rün" in done.stderr or "r\\u00fcn" in done.stderr
        (folder / f"log.{form}").read_bytes().decode("utf-8")
    help_text = aiorts(folder, "run", "--help", env=surroundings)
    assert help_text.returncode == 0


@pytest.mark.slow(kept_by="test_arguments_that_are_no_text_are_one_line")
@pytest.mark.fault("F14")
def test_an_argument_of_a_process_that_is_no_text_is_one_line(folder: Path) -> None:
    done = subprocess.run(
        [os.fsencode(sys.executable), b"-m", b"aiorts", b"run", b"\xff\xfe.toml"],
        cwd=folder,
        capture_output=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(b"aiorts: E-")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.fault("F14")
@pytest.mark.parametrize("argument", [b"\xff:\xfe", b"parts.py:\xff", b"--\xff", b"--set=\xff=1"])
def test_arguments_that_are_no_text_are_one_line(folder: Path, argument: bytes) -> None:
    target = ["parts.py:Counter"] if argument.startswith(b"--") else []
    done = here(folder, "run", os.fsdecode(argument), *target, stdin=b"")
    assert done.returncode == 2
    assert done.stderr.startswith(b"aiorts: E-")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.slow
@pytest.mark.fault("G01")
@pytest.mark.parametrize("limit", [6, 12, 20, 26, 30, 64])
@pytest.mark.parametrize("command", ["run", "filter"])
def test_too_few_descriptors_are_one_line_and_enough_are_enough(folder: Path, command: str, limit: int) -> None:
    arguments = [part.format(folder=folder) for part in COMMANDS[command]]
    done = subprocess.run(
        ["sh", "-c", f'ulimit -n {limit} && exec "$@"', "sh", sys.executable, "-m", "aiorts", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    if limit >= 30:
        assert (done.returncode, done.stderr) == (0, "")
        return
    assert done.returncode == 2
    assert done.stderr == (
        f"aiorts: E-FDS: Too many open files: the limit that is set is {limit}; raise it with ulimit -n 4096\n"
    )


OPENS = """
from aiorts import Component
import os
class Counter(Component):
    def __init__(self, name=""):
        super().__init__(name)
        kept = [open(os.devnull) for _ in range(1000)]
"""


@pytest.mark.slow
@pytest.mark.fault("G01")
def test_a_component_that_opens_too_much_is_told_and_named(folder: Path) -> None:
    (folder / "opens.py").write_text(OPENS)
    command = ["sh", "-c", 'ulimit -n 64 && exec "$@"', "sh", sys.executable, "-m", "aiorts", "run", "opens.py:Counter"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=40, check=False)
    assert done.returncode not in (0, None)
    assert "Traceback" not in done.stderr
    assert "Too many open files" in done.stderr
