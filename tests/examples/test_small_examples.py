"""Every example runs by the command that it names itself."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeAlias

import pytest

ROOT = Path(__file__).parents[2]
FILES = [
    path
    for path in sorted((ROOT / "examples").rglob("*"))
    if path.suffix in (".py", ".toml", ".md") and "__pycache__" not in path.parts
]
COMMANDS = [
    found[1]
    for path in FILES
    for line in path.read_text().splitlines()[:25]
    if (found := re.match(r'[#" ]*Run: (.*?)[`"]*$', line))
]


STALLED = "the event loop does not turn for"
ISOLATED = "examples/roomba/isolated.toml"
WAITED = re.compile(r"player: misses most deadlines: .*; imu\.on_execute \(.*\) held its context for ")


def complaints(command: str, errors: str) -> list[str]:
    """The lines of standard error that are more than news of a processor that other processes have.

    Then the loop stands still. And the writer of the isolated example waits for its reader, as its system file has it:
    its ticks are late, since the reader's process was. A hook that computes for so long is a complaint.
    """
    found = [line for line in errors.splitlines() if STALLED not in line]
    return [line for line in found if not (ISOLATED in command and WAITED.search(line))]


def test_every_entry_under_examples_says_how_it_is_run() -> None:
    for entry in (ROOT / "examples").iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            assert any(f"examples/{entry.name}/" in command for command in COMMANDS), entry


def ran(command: str) -> subprocess.CompletedProcess[str]:
    program, *arguments = shlex.split(command)
    start = {"python": [sys.executable], "aiorts": [sys.executable, "-m", "aiorts"]}[program]
    path = os.pathsep.join([str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [*start, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
        env={**os.environ, "PYTHONPATH": os.environ.get("PYTHONPATH") or path},
    )


Ended: TypeAlias = Callable[[str], "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def ended(request: pytest.FixtureRequest) -> Ended:
    """How a command ended, run together with the next one that is asked for: mostly they wait for the next tick."""
    asked = [getattr(item, "callspec", None) for item in request.session.items]
    left = [one.params["command"] for one in asked if one is not None and one.params.get("command") in COMMANDS]
    done: dict[str, subprocess.CompletedProcess[str]] = {}

    def outcome(command: str) -> subprocess.CompletedProcess[str]:
        while command not in done:
            pair = left[:2]
            del left[:2]
            with ThreadPoolExecutor(2) as together:
                done.update(zip(pair, together.map(ran, pair), strict=True))
        return done[command]

    return outcome


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("command", COMMANDS)
def test_an_example_runs_by_its_own_command(command: str, ended: Ended) -> None:
    done = ended(command)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert complaints(command, done.stderr) == []


def test_a_run_without_the_processor_may_say_so_and_nothing_else() -> None:
    isolated = next(command for command in COMMANDS if ISOLATED in command)
    late = "aiorts: warning: player: misses most deadlines: 3 of 3 cycles overran in 5.7 s at 200 Hz; imu.on_execute "
    waits, computes = f"{late}(recording.py:46) held its context for 1897 ms", f"{late}held the loop for 1897 ms"
    assert complaints(isolated, f"aiorts: warning: kernel: {STALLED} 0.21 s\n{waits}\n") == []
    assert complaints(isolated, f"{computes}\nW-DROPPED\n") == [computes, "W-DROPPED"]
    assert complaints("aiorts run examples/roomba/system.toml", waits) == [waits]
