"""Every example runs by the command that it names itself."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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


@pytest.fixture(scope="module")
def ended(request: pytest.FixtureRequest) -> dict[str, subprocess.CompletedProcess[str]]:
    """How the commands ended that are asked for: two at a time, since they mostly wait for the next tick."""
    asked = [getattr(item, "callspec", None) for item in request.session.items]
    commands = [one.params["command"] for one in asked if one is not None and one.params.get("command") in COMMANDS]
    with ThreadPoolExecutor(2) as together:
        return dict(zip(commands, together.map(ran, commands), strict=True))


@pytest.mark.timeout(300)
@pytest.mark.parametrize("command", COMMANDS)
def test_an_example_runs_by_its_own_command(command: str, ended: dict[str, subprocess.CompletedProcess[str]]) -> None:
    done = ended[command]
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert done.stderr == ""
