"""`aiorts plugins`: what is there is listed, what is broken is named, and no plugin takes the others down."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

GOOD = "from aiorts import Component\nclass Good(Component):\n    '''A component.'''\n"
BROKEN = {
    "missing": ("import no_such_module\n", "ModuleNotFoundError: No module named 'no_such_module'"),
    "syntax": ("def broken(:\n", "SyntaxError"),
    "exits": ("raise SystemExit(3)\n", "SystemExit: 3"),
    "hangs": ("while True: pass\n", "still being imported after 5 s"),
    "crashes": ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n", "ended the interpreter by SIGSEGV"),
    "leaves": ("import os\nos._exit(7)\n", "ended the interpreter with status 7"),
    "prints": ("print('hello')\n" + GOOD, "writes to standard output or error"),
    "patches": ("import time\ntime.sleep = lambda s: None\n" + GOOD, "changes time.sleep"),
    "signals": ("import signal\nsignal.signal(signal.SIGUSR1, signal.SIG_IGN)\n" + GOOD, "takes signals"),
    "old": ("AIORTS_API = 0\n" + GOOD, "written for version 0"),
    "good": (GOOD, "ok"),
}


def aiorts(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "aiorts", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=40, env=os.environ | environment)


def write(folder: Path, module: str, text: str, name: str) -> None:
    folder.mkdir()
    (folder / f"{module}.py").write_text(text)
    groups = '[project.entry-points."aiorts.components"]'
    (folder / "pyproject.toml").write_text(f'[project]\nname = "{module}"\n{groups}\n{name} = "{module}:Good"\n')


@pytest.mark.slow(kept_by="first")
def test_what_is_installed_is_listed_and_nothing_imported() -> None:
    done = aiorts("plugins")
    assert (done.returncode, done.stderr) == (0, "")
    assert "FlexiFilter" in done.stdout
    assert "realtime" in done.stdout
    listed = json.loads(aiorts("plugins", "--json").stdout)
    assert {"kind": "contexts", "name": "event", "target": "aiorts.contexts:EventContext"}.items() <= next(
        one for one in listed["extensions"] if one["name"] == "event"
    ).items()


@pytest.mark.slow(kept_by="extensions/test_loading.py::test_a_broken_plugin_is_named_and_the_others_work")
@pytest.mark.fault("F05")
def test_each_kind_of_broken_plugin_is_named_and_all_else_works(tmp_path: Path) -> None:
    for name, (text, _) in BROKEN.items():
        write(tmp_path / name, f"plug_{name}", text, name.capitalize())
    write(tmp_path / "twice", "plug_twice", GOOD, "Good")
    done = aiorts("plugins", "--plugins", str(tmp_path), "--check", "--limit", "5", "--json")
    assert done.returncode == 1
    verdicts = {one["target"]: one["verdict"] for one in json.loads(done.stdout)["extensions"]}
    for name, (_, expected) in BROKEN.items():
        if name != "good":
            assert expected in verdicts[f"plug_{name}:Good"], name
    assert "offered 2 times" in verdicts["plug_good:Good"]
    assert verdicts["aiorts_flexi.mapping.filter:FlexiFilter"] == "ok"
    assert verdicts["aiorts.contexts:EventContext"] == "ok"


@pytest.mark.slow
@pytest.mark.fault("F05")
def test_a_folder_that_cannot_be_read_is_a_line_and_the_rest_is_listed(tmp_path: Path) -> None:
    done = aiorts("plugins", AIORTS_PLUGINS=str(tmp_path / "none"))
    assert done.returncode == 1
    assert "FlexiFilter" in done.stdout
    assert done.stderr.startswith("aiorts: E-PLUGIN: folder ")


@pytest.mark.slow(
    kept_by="system/test_check.py::test_what_keeps_a_module_from_being_imported_is_said_once_with_the_line_of_the_field"
)
def test_one_fault_of_several_extensions_is_told_once(tmp_path: Path) -> None:
    bad = "from aiorts.types import record\n@record\nclass Bad:\n    level: float | str = 0.0\n"
    write(tmp_path / "one", "plug_one", bad + GOOD, "First")
    with (tmp_path / "one" / "pyproject.toml").open("a") as file:
        file.write('Second = "plug_one:Good"\n')
    done = aiorts("plugins", "--plugins", str(tmp_path), "--check")
    assert done.returncode == 1
    assert done.stdout.count("Bad.level: float | str has more than one type") == 1
    assert "plug_one.py:4)" in done.stdout
    (line,) = (line for line in done.stdout.splitlines() if " Second " in line)
    assert line.endswith("as First above")
