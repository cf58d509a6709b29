"""Codes and levels of messages have a colour on a terminal, and nowhere else."""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.cli.console.report import has_colours, painted
from run_parts import Terminal, folder_of, here

ANSI = re.compile(r"\x1b\[[\d;]*m")
RED = "\x1b[31m\x1b[1mE-COMPONENT\x1b[0m"
FAILING = ("system.toml", "--set", "sink.limit=3", "--for", "0.3")


class Screen(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_of(tmp_path_factory.mktemp("colour"))


@pytest.mark.parametrize(
    ("env", "terminal", "elsewhere"),
    [
        ({"TERM": "xterm"}, True, False),
        ({"TERM": "xterm", "NO_COLOR": "1"}, False, False),
        ({"TERM": "xterm", "NO_COLOR": ""}, True, False),
        ({"TERM": "dumb"}, False, False),
        ({}, False, False),
        ({"FORCE_COLOR": "1"}, True, True),
        ({"FORCE_COLOR": "0", "TERM": "xterm"}, True, False),
        ({"FORCE_COLOR": "1", "NO_COLOR": "1", "TERM": "xterm"}, False, False),
    ],
    ids=str,
)
def test_there_are_colours_on_a_terminal_that_has_them_unless_they_are_not_wanted(
    monkeypatch: pytest.MonkeyPatch, env: dict[str, str], terminal: bool, elsewhere: bool
) -> None:
    for name in ("TERM", "NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    assert (has_colours(Screen()), has_colours(io.StringIO()), has_colours(None)) == (terminal, elsewhere, False)
    closed = Screen()
    closed.close()
    assert has_colours(closed) in (terminal, False)


@given(st.text(alphabet=st.sampled_from("aiorts: EWN-XY^error\x1b[31m"), max_size=40))
def test_colour_changes_nothing_else(line: str) -> None:
    assert ANSI.sub("", painted(line)) == ANSI.sub("", line)
    assert ANSI.sub("", painted(f"aiorts: E-TYPE: {line}")) == f"aiorts: E-TYPE: {ANSI.sub('', line)}"


def test_what_is_no_message_of_aiorts_stays_as_it_is() -> None:
    for line in ("", "  ", "total 3", '{"code": "E-TYPE"}', "aiorts run", "  key = 1", "x aiorts: E-TYPE: y"):
        assert painted(line) == line
    assert painted("aiorts: W-DROPPED: x") == "aiorts: \x1b[33m\x1b[1mW-DROPPED\x1b[0m: x"
    assert painted("aiorts: info: sink: ready") == "aiorts: \x1b[32m\x1b[1minfo\x1b[0m: sink: ready"
    assert painted("   ^^^") == "\x1b[32m   ^^^\x1b[0m"


@pytest.mark.slow(kept_by="test_elsewhere_only_where_it_is_asked_for_and_never_in_json")
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
@pytest.mark.parametrize("wanted", [True, False])
def test_a_failure_on_a_terminal_has_its_code_in_colour(folder: Path, wanted: bool) -> None:
    env = {"COLUMNS": "100", "NO_COLOR": "" if wanted else "1"}
    with Terminal(folder, *FAILING, "--no-status", env=env) as terminal:
        assert terminal.end() == 3
    assert (f"aiorts: {RED}: sink.on_execute: ValueError" in terminal.text) is wanted
    assert (ANSI.search(terminal.text) is not None) is wanted


@pytest.mark.parametrize(("force", "status"), [("0", 3), ("1", 3)])
def test_elsewhere_only_where_it_is_asked_for_and_never_in_json(folder: Path, force: str, status: int) -> None:
    for form in ("text", "json"):
        done = here(folder, "run", *FAILING, "--simulate", "--log-format", form, FORCE_COLOR=force, NO_COLOR="")
        assert done.returncode == status
        assert (RED in done.stderr) is (force == "1" and form == "text")
        if form == "json":
            assert ANSI.search(json.loads(done.stderr)["message"]) is None
