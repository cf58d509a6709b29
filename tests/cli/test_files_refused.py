"""What `check` finds wrong with a file, `run` refuses with the same status and the place; and how a run ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import here

PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedLong

class Source(Component):
    out = OutPort(TimedLong)
    n = 0
    async def on_execute(self):
        self.out.write_nowait(TimedLong(0, self.n))
        self.n += 1
        if self.n == 3:
            self.finish()

class Sink(Component):
    inp = InPort(TimedLong)
    def on_execute(self):
        for sample in self.inp.drain():
            print(sample.data, flush=True)

class Deaf(Component):
    inp = InPort(TimedLong)
"""
TWO = """schema = 1
components.src.type = "parts.py:Source"
components.snk.type = "parts.py:{sink}"
connections = [{{from = "src.out", to = "snk.inp"}}]
contexts.a = {{kind = "{kind}", rate = 100.0, members = ["src"]}}
contexts.b = {{kind = "periodic", rate = {rate}, members = ["snk"]}}
"""


def aiorts(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments], cwd=folder, capture_output=True, text=True, timeout=40
    )


@pytest.mark.skipif(sys.platform == "win32", reason="no links and pipes in the file system")
def test_what_may_have_been_meant_is_never_what_was_typed(tmp_path: Path) -> None:
    """A dead link, a folder or a pipe of that very name."""
    (tmp_path / "link.toml").symlink_to("nowhere")
    (tmp_path / "link.py").symlink_to("nowhere")
    (tmp_path / "folder.py").mkdir()
    os.mkfifo(tmp_path / "pipe.py")
    commands = [("run", "link.toml"), ("check", "link.toml"), ("run", "./link.toml"), ("types", "--type-mod", "link")]
    for name in ("link", "folder", "pipe"):
        commands += [("run", f"{name}.py:Good"), ("inspect", f"{name}.py:Good")]
        (tmp_path / f"{name}_type.toml").write_text(f'schema = 1\ncomponents.a.type = "{name}.py:Good"\n')
        commands += [("run", f"{name}_type.toml"), ("check", f"{name}_type.toml")]
    for command in commands:
        done = here(tmp_path, *command)
        assert done.returncode == (6 if command[0] == "inspect" else 2), command
        said = done.stderr + done.stdout
        typed = Path(command[-1].partition(":")[0]).name.replace("_type.toml", ".py")
        assert f"did you mean {typed!r}" not in said, (command, said)
        assert said.count("did you mean") <= 1, (command, said)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [("run", "system.toml"), ("flexiconst", "-p", "TimedLong", "-c", "1", "--count", "1")]
)
def test_modules_of_the_current_folder_do_not_take_the_place_of_pythons(
    tmp_path: Path, command: tuple[str, ...]
) -> None:
    """As with the installed script; only what Python itself loads before the first line of aiorts comes from there."""
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(TWO.format(kind="periodic", rate=100.0, sink="Sink"))
    before = subprocess.run(
        [sys.executable, "-c", "import sys, runpy, aiorts; print(*sys.modules)"],
        capture_output=True,
        text=True,
        timeout=40,
    )
    loaded = {name.partition(".")[0] for name in before.stdout.split()} | {"aiorts", "runpy", "pkgutil"}
    for name in [*sorted(sys.stdlib_module_names - loaded), "click", "numpy", "uvloop", "msgpack", "anyio"]:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a module of the current folder')\n")
    done = aiorts(tmp_path, *command)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout


@pytest.mark.parametrize(
    ("text", "said", "checked"),
    [
        (TWO.format(kind="thread", rate=100.0, sink="Sink"), "system.toml:5:", 2),
        ("schema = 1\n", "no components", 0),
        ('schema = 1\ncomponents.c.type = "parts.py:Component"\n', "Component itself", 2),
        ('schema = 1\n[contexts.c]\ntype = "periodic"\nrate = 1.0\nmembers = []\n', "write kind", 2),
    ],
    ids=["async hook in a thread", "empty", "Component", "type of a context"],
)
def test_what_is_wrong_with_a_file_is_said_at_once(tmp_path: Path, text: str, said: str, checked: int) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(text)
    run, check = here(tmp_path, "run", "system.toml"), here(tmp_path, "check", "system.toml")
    assert (run.returncode, check.returncode) == (2, checked)
    assert said in run.stderr
    assert said in (check.stdout + check.stderr)


@pytest.mark.slow(kept_by="cli/test_clock.py::test_the_clock_of_the_file_is_taken_and_the_command_line_wins")
def test_a_slow_clock_loses_no_sample_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(TWO.format(kind="periodic", rate=2.0, sink="Sink"))
    done = aiorts(tmp_path, "run", "--speed", "0.2", "system.toml")
    assert (done.returncode, done.stdout.split()) == (0, ["0", "1", "2"]), done.stderr


@pytest.mark.slow(kept_by="cli/test_exits.py::test_a_failure_in_the_last_moments_counts")
def test_samples_lost_at_the_end_are_a_failure(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(TWO.format(kind="periodic", rate=100.0, sink="Deaf"))
    done = here(tmp_path, "run", "system.toml")
    assert done.returncode == 1
    assert "E-UNREAD" in done.stderr


@pytest.mark.slow(kept_by="test_what_is_wrong_with_a_file_is_said_at_once")
def test_a_process_that_goes_on_after_a_run_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(TWO.format(kind="periodic", rate=100.0, sink="Sink"))
    program = (
        "import time\nfrom aiorts.cli.runtime import stopping\nfrom aiorts.cli.app import run_command\n"
        "stopping.LONGEST_STOP = 0.5\nstatus = run_command(['run', 'system.toml'])\n"
        "time.sleep(1.0)\nprint('goes on', status)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=40)
    assert (done.returncode, done.stdout.split()[-3:]) == (0, ["goes", "on", "0"]), done.stderr
