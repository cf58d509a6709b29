"""Short-lived commands are light: whoever looks from a terminal waits for Python and for little more."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from aiorts.cli.app import aiorts
from control_parts import WAIT, running

pytestmark = pytest.mark.slow

LIVE = tuple(name for name, (target, _) in aiorts.own.items() if target.startswith("aiorts.cli.commands.live."))
HEAVY = ("asyncio", "numpy", "uvloop", "anyio", "aiorts.kernel.microkernel", "aiorts.system", "aiorts.types")
SYSTEM = Path(__file__).parents[2] / "examples" / "pid" / "system.toml"
MOST = 190
"""Modules besides those of a bare interpreter."""


def after(commands: Sequence[Sequence[str]]) -> tuple[dict[str, list[str]], int, str]:
    """What of `HEAVY` a process has after each of these commands, how many modules in the end, and what it printed."""
    code = f"""
import sys
before = len(sys.modules)
from aiorts.cli.app import run_command
for one in {[list(words) for words in commands]!r}:
    run_command(one)
    print("AFTER", one[0], *[name for name in {HEAVY!r} if name in sys.modules])
print("AFTER", len(sys.modules) - before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=3 * WAIT, check=True)
    marks = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("AFTER ")]
    return {name: heavy for name, *heavy in marks[:-1]}, int(marks[-1][0]), done.stdout + done.stderr


def test_a_live_command_imports_no_event_loop_no_numpy_no_kernel() -> None:
    heavy, _, said = after([(name, "--help") for name in LIVE])
    assert heavy == {name: [] for name in LIVE}
    assert len(LIVE) >= 18
    assert all(f"Usage: aiorts {name}" in said for name in LIVE)


def test_nor_does_one_that_does_its_work_and_it_imports_few_modules() -> None:
    words = (
        *(["ls", "-l", "-R"], ["cat", "-l", "pid0"], ["find", "--type", "Pid"], ["conf", "pid0", "gain=3"]),
        *(["deactivate", "pid0"], ["activate", "pid0"], ["connect"], ["vlog", "--levels"], ["stop", "light"]),
    )
    with running("light", str(SYSTEM)):
        heavy, count, said = after(words)
    assert "aiorts: E-" not in said
    assert heavy == {one[0]: [] for one in words}
    assert count <= MOST
