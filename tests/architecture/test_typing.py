"""The public interface is typed: two checkers agree on what it gives and on what it refuses."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
API = ROOT / "tests" / "typing" / "api.py"
LINES = API.read_text().splitlines()
EXPECTED = [number for number, line in enumerate(LINES, 1) if "# error:" in line]


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.slow(kept_by="test_package_says_that_it_is_typed")
@pytest.mark.row(6)
@pytest.mark.skipif(importlib.util.find_spec("mypy") is None, reason="mypy is not installed")
def test_mypy_strict_accepts_the_interface_and_flags_exactly_its_misuses() -> None:
    done = run(sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--cache-dir=/dev/null", str(API))
    flagged = [int(number) for number in re.findall(r"tests/typing/api\.py:(\d+): error:", done.stdout)]
    assert sorted(set(flagged)) == EXPECTED, done.stdout + done.stderr
    assert done.stdout.count("error:") == len(flagged), done.stdout  # none elsewhere
    variants = [int(number) for number in re.findall(r"tests/typing/api\.py:(\d+): note:     def ", done.stdout)]
    told = {number: variants.count(number) for number in EXPECTED if "kernel.connect(" in LINES[number - 1]}
    assert set(told.values()) == {2}, told  # for two ports, and for more: no variant for each kind of port


@pytest.mark.slow(kept_by="test_package_says_that_it_is_typed")
@pytest.mark.row(6)
@pytest.mark.skipif(importlib.util.find_spec("pyright") is None, reason="pyright is not installed")
def test_pyright_accepts_the_interface_and_flags_exactly_its_misuses() -> None:
    done = run(sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, str(API))
    if not done.stdout.startswith("{"):
        pytest.skip(f"pyright does not run here: {done.stderr[:200]}")
    reports = [report for report in json.loads(done.stdout)["generalDiagnostics"] if report["severity"] == "error"]
    assert sorted({report["range"]["start"]["line"] + 1 for report in reports}) == EXPECTED, reports


@pytest.mark.row(6)
def test_package_says_that_it_is_typed() -> None:
    assert (ROOT / "aiorts" / "py.typed").is_file()
