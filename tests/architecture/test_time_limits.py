"""No test waits without a bound: all have 120 s, longer ones run in campaigns only, and so does what they wait for."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from trees import dotted, many_objects, nodes

TESTS = Path(__file__).parents[1]
LONGEST = 120
WAITING = ("subprocess.run", "subprocess.check_output", "subprocess.check_call", "subprocess.call")


def calls(text: str) -> Iterator[tuple[ast.Call, str]]:
    """Every call that is not awaited, and what is called."""
    tree = ast.parse(text)
    awaited = {id(node.value) for node in nodes(tree) if isinstance(node, ast.Await)}
    for node in nodes(tree):
        if isinstance(node, ast.Call) and id(node) not in awaited:
            yield node, dotted(node.func)


def unbounded(text: str) -> list[str]:
    """What a test file has that may take longer, or forever."""
    found: list[str] = []
    if not re.search(r"\btimeout\b|\bsubprocess\b|\bcommunicate\b", text):
        return found
    for call, name in calls(text):
        if name == "pytest.mark.timeout":
            seconds = call.args[0]
            short = isinstance(seconds, ast.Constant) and 0 < seconds.value <= LONGEST  # type: ignore[operator]
            if not short and not ast.unparse(seconds).startswith("time_limit("):
                found.append(f"line {call.lineno}: {ast.unparse(call)}: write time_limit(...) of campaign.py")
        waits = name in WAITING or name.endswith(".communicate")
        if waits and not any(word.arg in ("timeout", None) for word in call.keywords):
            found.append(f"line {call.lineno}: {name} waits forever; give it a timeout")
    return found


def test_every_test_has_a_limit_of_two_minutes() -> None:
    project = tomllib.loads((TESTS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["tool"]["pytest"]["ini_options"]["timeout"] == LONGEST


def test_no_test_asks_for_more_or_waits_for_a_process_for_ever() -> None:
    with many_objects():
        texts = {path.relative_to(TESTS).as_posix(): path.read_text("utf-8") for path in sorted(TESTS.rglob("*.py"))}
        found = {name: unbounded(text) for name, text in texts.items()}
    assert {name: faults for name, faults in found.items() if faults} == {}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("@pytest.mark.timeout(60)\ndef test(): ...", 0),
        ("@pytest.mark.timeout(time_limit(900))\ndef test(): ...", 0),
        ("@pytest.mark.timeout(900)\ndef test(): ...", 1),
        ("@pytest.mark.timeout(0)\ndef test(): ...", 1),  # which is no limit at all
        ("pytestmark = pytest.mark.timeout(2 * MINUTE)", 1),
        ("subprocess.run(command, check=True)", 1),
        ("subprocess.run(command, timeout=10)", 0),
        ("out, err = process.communicate()", 1),
        ("out, err = process.communicate(timeout=10)", 0),
    ],
)
def test_what_has_no_bound_is_found(text: str, count: int) -> None:
    assert len(unbounded(text)) == count
