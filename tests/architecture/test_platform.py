"""Where POSIX-only modules are missing, as on Windows, the example still runs, on the plain event loop."""

from __future__ import annotations

import subprocess
import sys

from test_layers import ROOT

BLOCKED = ("uvloop", "fcntl", "resource", "termios")
RUN_WITHOUT = f"""
import runpy, sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {BLOCKED!r}:
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Refuse())
for name in list(sys.modules):
    if name.split(".")[0] in {BLOCKED!r}:
        del sys.modules[name]
sys.argv[0] = "aiorts"
try:
    runpy.run_module("aiorts", run_name="__main__", alter_sys=True)
finally:
    assert not any(name.split(".")[0] in {BLOCKED!r} for name in sys.modules)
"""


def test_example_runs_without_posix_only_modules() -> None:
    arguments = ["run", "examples/roomba/system.toml", "--set", "imu.speed=200"]
    done = subprocess.run(
        [sys.executable, "-c", RUN_WITHOUT, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "heading verified" in done.stdout.splitlines()[-1]
