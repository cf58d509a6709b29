"""The example of a controller and its plant does what it says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PID = Path(__file__).parents[2] / "examples" / "pid"


@pytest.mark.slow(kept_by="first")
def test_the_cart_comes_to_the_set_point() -> None:
    command = [sys.executable, "-m", "aiorts", "run", "system.toml", "--simulate", "--for", "5"]
    done = subprocess.run(command, cwd=PID, capture_output=True, text=True, timeout=40, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "plant0 is at 0.000 m\n", "")
