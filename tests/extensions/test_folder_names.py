"""A file below a folder whose name is no UTF-8: Linux allows any bytes in a name."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts_log import RecordingReader

SYSTEM = """schema = 1
[components.q]
type = "q.py:Q"
[contexts.c]
kind = "periodic"
rate = 10.0
members = ["q"]
"""
FILE = """
from aiorts import Component, OutPort
from aiorts.types import record

@record
class Mine:
    tm: int = 0
    data: float = 0.0

class Q(Component):
    out = OutPort(Mine)

    def on_execute(self):
        self.out.write_nowait(Mine(self.clock.time_ns(), 1.0))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("what", ["q.py:Q", "s.toml"])
def test_a_component_below_a_folder_whose_name_is_no_utf_8_runs_and_is_recorded(tmp_path: Path, what: str) -> None:
    folder = tmp_path / os.fsdecode(b"old\xff")
    folder.mkdir()
    (folder / "q.py").write_text(FILE)
    (folder / "s.toml").write_text(SYSTEM)
    how = ["--rate", "10", "--quiet"] if what == "q.py:Q" else []
    arguments = [str(folder / what), "--simulate", "--for", "1", *how, "--record", "run.mcap", "--control=off"]
    command = [sys.executable, "-m", "aiorts", "run", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    with RecordingReader(tmp_path / "run.mcap") as reader:
        (port,) = reader.ports.values()
        assert port.count >= 10
        assert port.type_name == "aiorts_system.old\ufffd.q.Mine"
