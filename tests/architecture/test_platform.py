"""Where POSIX-only modules are missing, as on Windows, the example still runs, on the plain event loop."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib

import pytest
from test_layers import ROOT, sources

BLOCKED = ("uvloop", "fcntl", "resource", "termios", "pwd", "grp", "pty", "tty", "syslog")
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


@pytest.mark.slow(kept_by="architecture/test_forbidden.py::test_no_file_needs_a_module_that_only_posix_has")
@pytest.mark.row(8)
def test_example_runs_without_posix_only_modules() -> None:
    arguments = ["run", "examples/roomba/system.toml", "--set", "imu.speed=200"]
    done = subprocess.run(
        [sys.executable, "-c", RUN_WITHOUT, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "heading verified" in done.stdout.splitlines()[-1]


@pytest.mark.slow(kept_by="architecture/test_forbidden.py::test_no_file_needs_a_module_that_only_posix_has")
@pytest.mark.row(8)
def test_every_module_can_be_imported_without_posix_only_modules() -> None:
    """Also those that no run of the example uses, such as the check of plugins and the benches."""
    modules = [
        ".".join(
            path.relative_to(ROOT if path.is_relative_to(ROOT / "aiorts") else ROOT / "plugins").with_suffix("").parts
        )
        for path in sources("aiorts", "plugins")
        if path.name != "__main__.py"
    ]
    body = "import importlib\nfor name in sys.argv[1:]: importlib.import_module(name)\n"
    code = RUN_WITHOUT[: RUN_WITHOUT.index("sys.argv[0]")].replace("import runpy, sys", "import sys") + body
    done = subprocess.run([sys.executable, "-c", code, *modules], cwd=ROOT, capture_output=True, text=True, timeout=40)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.row(8)
def test_what_is_said_of_systems_is_what_was_run() -> None:
    """README names the system that the suite was run on, and says of the others that it was not."""
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert re.search(r"runs on Linux \(x86-64\) with CPython 3\.11, 3\.12 and 3\.13\.", readme)
    assert "Not run on Windows and macOS" in readme
    with open(ROOT / "pyproject.toml", "rb") as file:
        classifiers = tomllib.load(file)["project"]["classifiers"]
    assert [one for one in classifiers if "Operating System" in one] == ["Operating System :: POSIX :: Linux"]
