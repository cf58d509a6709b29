"""The README's first component and system file are the example's, word for word, and they do what it says."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PID = ROOT / "examples" / "pid"
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(kind: str, begins: str) -> str:
    """The fenced block of the README that begins so."""
    found = re.search(rf"```{kind}\n({re.escape(begins)}.*?)```", README, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_component_is_the_readmes() -> None:
    shown = ast.parse(block("python", "from aiorts import Component, InPort, OutPort, Param\n"))
    written = ast.parse((PID / "pid.py").read_text(encoding="utf-8"))
    assert [ast.dump(node) for node in written.body[2:]] == [ast.dump(node) for node in shown.body]


def test_the_system_file_is_the_readmes() -> None:
    shown = tomllib.loads(block("toml", "schema = 1\n"))
    assert tomllib.loads((PID / "system.toml").read_text(encoding="utf-8")) == shown


def test_the_cart_comes_to_the_set_point() -> None:
    command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--simulate", "--for", "5"]
    done = subprocess.run(command, cwd=PID, capture_output=True, text=True, timeout=40, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "plant0 is at 0.000 m\n", "")
