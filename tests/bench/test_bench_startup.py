"""`aiorts bench startup`, and what a light start promises: nothing heavy is loaded before it is used."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import aiorts
from aiorts.bench import child, startup
from aiorts.bench.case import Reading
from aiorts.cli.app import aiorts as command


def test_import_aiorts_loads_nothing_heavy() -> None:
    assert startup.loaded() == ()


def test_every_public_name_is_there_lazily_and_in_dir() -> None:
    code = (
        "import aiorts\n"
        "assert not [name for name in aiorts.__all__ if name not in dir(aiorts)]\n"
        "assert not [name for name in aiorts.__all__ if getattr(aiorts, name, None) is None]\n"
        "from aiorts import *\n"
        "assert Kernel is aiorts.Kernel and aiorts.types.TimedDouble is not None\n"
        "try:\n    aiorts.Kernell\nexcept AttributeError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "module 'aiorts' has no attribute 'Kernell'"


def test_the_help_of_the_command_loads_neither_kernel_nor_asyncio() -> None:
    code = (
        "import sys\nfrom aiorts.cli.app import run_command\nrun_command(['--help'])\n"
        "print('loaded', *sorted({'asyncio', 'anyio', 'numpy', 'aiorts.kernel'} & sys.modules.keys()))"
    )
    assert child.run(["-c", code], timeout=50).splitlines()[-1].strip() == "loaded"


def test_names_that_type_checkers_see_are_the_names_there_are() -> None:
    assert set(aiorts._HOME) == set(aiorts.__all__)


@pytest.mark.parametrize("name", ["python -c pass", "import aiorts", "aiorts --version", "first sample"])
def test_row_runs_and_prints_what_it_should(name: str, tmp_path: Path) -> None:
    case = {case.name: case for case in startup.cases(tmp_path)}[name]
    reading = case.run(1)
    assert isinstance(reading, Reading)
    assert reading.faults == ()
    assert 1.0 < reading.values["time"] < 20_000


def test_a_command_that_says_something_else_is_a_fault(tmp_path: Path) -> None:
    assert startup._once(["-c", "print(1)"], "2", tmp_path, 1).faults
    assert startup._once(["-c", "raise SystemExit(1)"], None, tmp_path, 1).faults


def test_children_find_compiled_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert child.run(["-c", "import sys; print(sys.dont_write_bytecode)"], timeout=50).strip() == "False"


def test_startup_as_a_user_runs_it() -> None:
    result = CliRunner().invoke(command, ["bench", "startup", "--json", "--rounds", "1", "--scale", "1"])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    aims = {row["case"]: [ratio["aim"] for ratio in row["ratios"]] for row in document["rows"]}
    assert aims["aiorts --help"] == [1.5]
    assert "import aiorts loads none of numpy" in " ".join(document["notes"])
