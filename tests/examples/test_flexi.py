"""The paper's cases as examples: all examples are run elsewhere; here it is tested that these notice a wrong result."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import here

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "flexi"

pytestmark = pytest.mark.row(123)


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, timeout=40)


@pytest.mark.parametrize(
    ("name", "expected", "got"),
    [
        ("vector", "vector verified: 7 samples", "[1.5, -2.0, 0.25]"),
        ("millimetres", "millimetres verified: 5 samples", "1001"),
        ("schemas", "sum verified: 5 samples", '{"vx": 0.25, "vy": 0.0, "va": 1.0}'),
    ],
)
def test_a_system_says_what_it_verified_and_fails_on_another_result(name: str, expected: str, got: str) -> None:
    command = ["run", str(FOLDER / f"{name}.toml"), "--simulate"]
    done = here(*command)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == f"{expected}, the last one {got}"
    done = here(*command, "--set", "expect.last=7")
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1].endswith(f" not verified: expected 7, got {got}")


@pytest.mark.slow
@pytest.mark.parametrize(("old", "new"), [("text\n1001", "text\n1000"), ("sh\ntrue", "sh\nfalse")])
def test_the_commands_of_the_readme_are_compared_with_their_text(tmp_path: Path, old: str, new: str) -> None:
    text = "```sh\necho 1001\n```\n\n```text\n1001\n```\n\n```sh\ntrue\n```\n\n```text\n```\n"
    path = tmp_path / "README.md"
    path.write_text(text)
    assert run("examples/flexi/check.py", str(path)).returncode == 0
    path.write_text(text.replace(old, new))
    done = run("examples/flexi/check.py", str(path))
    assert done.returncode == 1
    assert "1 of 2 commands" in done.stdout
