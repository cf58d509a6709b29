"""A run on a terminal: a status line that never mixes with other lines, and the debugger where a component failed."""

from __future__ import annotations

import re
import signal
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.cli.runtime.status import Figures, fitted, text_of
from run_parts import Terminal, folder_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")

STATUS = re.compile(r"\r(\d+:\d\d:\d\d  [^\x1b]*)\x1b\[K")
QUIET = {"COLUMNS": "100"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_of(tmp_path_factory.mktemp("terminal"))


def shown(text: str) -> list[str]:
    """The lines that stand on a terminal in the end, as far as these few commands go."""
    lines, line, at = [], "", 0
    for part in re.findall(r"\x1b\[K|\r\n|\r|[^\r\x1b]+", text):
        if part == "\r\n":
            lines.append(line)
            line, at = "", 0
        elif part == "\r":
            at = 0
        elif part == "\x1b[K":
            line = line[:at]
        else:
            line = line[:at] + part + line[at + len(part) :]
            at += len(part)
    return [*lines, line]


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_the_line_tells_how_it_goes_and_is_gone_in_the_end(folder: Path) -> None:
    with Terminal(folder, "system.toml", env=QUIET) as terminal:
        terminal.wait_for("2 active")
        terminal.wait_for("0:00:01")
        terminal.send(signal.SIGINT)
        assert terminal.end() == 130
    (last,) = re.findall(r"wrote \d+ in periodic 100.0", terminal.text)
    assert shown(terminal.text) == ["ready", last, "stopped in event", ""]  # who writes ends before who reads
    lines = STATUS.findall(terminal.text)
    running = [line for line in lines if "  2 active  " in line]  # on a busy machine, not at 0:00:01 yet, or once more
    form = r"0:00:0[1-9]  2 active  \d+ samples/s  0 dropped  late \d+\.\d ms at worst  \d+ overruns"
    assert re.fullmatch(form, running[-1])
    assert all(len(line) < 100 for line in lines)


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_lines_of_the_log_and_of_components_stand_alone(folder: Path) -> None:
    arguments = ("system.toml", "--set", "sink.limit=20", "--for", "3")
    with Terminal(folder, *arguments, env=QUIET) as terminal:
        assert terminal.end() == 3
    assert "1 in error" in terminal.text
    assert shown(terminal.text)[:3] == [
        "ready",
        "aiorts: E-COMPONENT: sink.on_execute: ValueError: too much (parts.py:31); --debug shows the traceback",
        "stopped in event",
    ]


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_it_says_that_the_loop_is_held_up(folder: Path) -> None:
    with Terminal(folder, "parts.py:Blocked", "--quiet", env=QUIET) as terminal:
        terminal.wait_for("loop held up for 1 s")
        terminal.send(signal.SIGINT)
        terminal.send(signal.SIGTERM)
        assert terminal.end() in (130, 143)
    assert shown(terminal.text)[-1] == ""


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
@pytest.mark.fault("F14")
@pytest.mark.parametrize(
    ("env", "arguments"),
    [
        ({"TERM": "dumb"}, ()),
        ({"TERM": ""}, ()),
        ({"TERM": "unknown"}, ()),
        ({"COLUMNS": "1"}, ()),
        ({}, ("--no-status",)),
        ({}, ("--simulate",)),
    ],
)
def test_no_line_where_it_cannot_be_or_is_not_wanted(
    folder: Path, env: dict[str, str], arguments: tuple[str, ...]
) -> None:
    with Terminal(folder, "parts.py:Sink", "--for", "0.6", *arguments, env=env) as terminal:
        assert terminal.end() == 0
    assert terminal.text == "ready\r\nstopped in event\r\n"


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
@pytest.mark.fault("F14")
def test_no_color_has_the_line_too_for_it_has_none(folder: Path) -> None:
    with Terminal(folder, "parts.py:Sink", "--for", "0.6", env={"NO_COLOR": "1", "COLUMNS": "20"}) as terminal:
        assert terminal.end() == 0
    assert STATUS.findall(terminal.text)
    assert set(re.findall(r"\x1b.{2}", terminal.text)) == {"\x1b[K"}


@given(
    st.integers(0, 300),
    st.floats(0, 1e7),
    st.builds(Figures, *[st.integers(0, 10**9)] * 4, st.none() | st.integers(0, 10**12), *[st.integers(0, 10**9)] * 2),
    st.none() | st.floats(0, 1e9),
    st.floats(0, 1e4),
)
def test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits(
    columns: int, elapsed_s: float, figures: Figures, rate: float | None, held_s: float
) -> None:
    parts = text_of(elapsed_s, figures, rate, held_s)
    line = fitted(parts, columns)
    assert len(line) <= max(0, columns - 1)
    assert "  ".join(parts).startswith(line)
    if len("  ".join(parts)) < columns:
        assert line == "  ".join(parts)


@pytest.mark.slow(kept_by="cli/test_run.py::test_debug_shows_the_traceback")
def test_debug_opens_the_debugger_where_a_component_failed_and_the_run_goes_on(folder: Path) -> None:
    arguments = ("system.toml", "--set", "sink.limit=3", "--debug", "--log-level", "warning", "--for", "3")
    with Terminal(folder, *arguments, stdin=True, env=QUIET) as terminal:
        terminal.wait_for("(Pdb) ")
        assert "post-mortem of sink; q goes on with the run" in terminal.text
        assert 'raise ValueError("too much")' in terminal.text
        terminal.write("p 'it is', sample.data\n")
        terminal.wait_for("('it is', 3)")
        terminal.write("\x03")  # the debugger's own
        terminal.write("p 'and', self.limit\n")
        terminal.wait_for("('and', 3)")
        terminal.write("q\n")
        assert terminal.end() == 3
    assert "wrote" in terminal.text  # the counter went on and was deactivated


@pytest.mark.slow(kept_by="cli/test_run.py::test_debug_shows_the_traceback")
def test_the_debugger_is_for_components_that_cannot_be_made_too(folder: Path) -> None:
    (folder / "unmade.py").write_text(
        "from aiorts import Component\nclass Unmade(Component):\n    def on_initialize(self):\n        1 / 0\n"
    )
    with Terminal(folder, "unmade.py:Unmade", "--debug", stdin=True, env=QUIET) as terminal:
        terminal.wait_for("(Pdb) ")
        terminal.write("q\n")
        assert terminal.end() == 1
    with Terminal(folder, "unmade.py:Unmade", "--debug", env=QUIET) as terminal:  # nobody sits there
        assert terminal.end() == 1
    assert "Traceback" in terminal.text
    assert "(Pdb)" not in terminal.text


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_a_process_ended_in_the_debugger_gives_the_terminal_back(folder: Path) -> None:
    import termios

    arguments = ("system.toml", "--set", "sink.limit=3", "--debug", "--log-level", "error")
    with Terminal(folder, *arguments, stdin=True, env=QUIET) as terminal:
        before = termios.tcgetattr(terminal._ours)
        terminal.wait_for("(Pdb) ")
        for number in (signal.SIGTERM, signal.SIGHUP):
            time.sleep(0.3)  # a signal in the moment in which readline begins to wait is seen with the next one
            terminal.send(number)
        assert terminal.end() in (129, 143)
        assert termios.tcgetattr(terminal._ours)[:4] == before[:4]


@pytest.mark.slow(kept_by="test_the_line_leaves_room_for_the_cursor_and_tells_as_much_as_fits")
def test_a_terminal_that_was_stopped_holds_up_nothing(folder: Path) -> None:
    with Terminal(folder, "system.toml", env=QUIET) as terminal:
        terminal.wait_for("2 active")
        terminal.write("\x13")  # Ctrl-S
        terminal.send(signal.SIGINT)
        time.sleep(0.3)
        terminal.send(signal.SIGINT)
        assert terminal.process.wait(timeout=10) == 130
