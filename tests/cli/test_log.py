"""The log of a run: levels by component, a file that one process has, lines for programs, a disk that is full."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any

import click
import pytest

from aiorts.cli.runtime.logfile import LogFile
from aiorts.cli.runtime.options import Options, levels_of
from run_parts import aiorts, begun, folder_of, here, started

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX locks and devices")
SIMULATED = ("system.toml", "--simulate", "--for", "0.3")
TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return folder_of(tmp_path)


@pytest.mark.parametrize(
    ("options", "default", "components"),
    [
        ({}, "WARNING", {}),
        ({"verbose": True}, "INFO", {}),
        ({"debug": True}, "DEBUG", {}),
        ({"log_level": "error", "verbose": True}, "ERROR", {}),
        ({"log_level": " Info , a = debug,b=critical "}, "INFO", {"a": "DEBUG", "b": "CRITICAL"}),
        ({"log_level": "a=debug"}, "WARNING", {"a": "DEBUG"}),
    ],
)
def test_levels_are_one_for_all_and_others_by_component(
    options: dict[str, Any], default: str, components: dict[str, str]
) -> None:
    levels = levels_of(Options(**options))
    assert logging.getLevelName(levels.default) == default
    assert {name: logging.getLevelName(level) for name, level in levels.components.items()} == components


@pytest.mark.parametrize("text", ["loud", "a=loud", "=debug", "a=info,a=debug", "info,error", "a=b=debug=", "a="])
def test_any_other_level_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        levels_of(Options(log_level=text))


@pytest.mark.slow
def test_a_component_says_what_its_own_level_admits(folder: Path) -> None:
    done = here(folder, "run", *SIMULATED, "--log-level", "error,sink=info")
    assert done.stderr == "aiorts: info: sink: ready\n"
    done = here(folder, "run", *SIMULATED, "--log-level", "info,sink=error")
    assert done.stderr == ""
    done = here(folder, "run", *SIMULATED, "-v")
    assert done.stderr == "aiorts: info: sink: ready\n"


def test_json_is_an_object_in_a_line_with_where_and_what(folder: Path) -> None:
    arguments = (*SIMULATED, "--set", "sink.limit=3", "--log-format", "json", "-v")
    done = here(folder, "run", *arguments)
    ready, failed, lost = map(json.loads, done.stderr.splitlines())
    assert re.fullmatch(TIME, ready.pop("time"))
    assert re.fullmatch(TIME, failed.pop("time"))
    ours = {"component": "sink", "context": "slow"}
    assert ready == {**ours, "level": "info", "hook": "on_activated", "code": None, "message": "ready"}
    assert failed == {
        **ours,
        "level": "error",
        "hook": "on_execute",
        "code": "E-COMPONENT",
        "message": "ValueError: too much (parts.py:31)",
    }
    assert lost["code"] == "W-DROPPED"
    assert "inactive: unread when the reader ended" in lost["message"]
    last = here(folder, "run", *arguments, "--debug").stderr.splitlines()
    traces = [line["traceback"] for line in map(json.loads, last) if "traceback" in line]
    assert len(traces) == 1
    assert traces[0].endswith("ValueError: too much")


@pytest.mark.fault("F18")
@pytest.mark.parametrize("arguments", [["nix.toml"], ["parts.py:Conter"], ["system.toml", "--set", "sink.limit=x"]])
def test_a_run_that_fails_before_it_begins_is_json_too(folder: Path, arguments: list[str]) -> None:
    done = here(folder, "run", *arguments, "--log-format", "json")
    assert done.returncode == 2
    (line,) = map(json.loads, done.stderr.splitlines())
    assert line["code"].startswith("E-")


@pytest.mark.slow(kept_by="test_the_file_has_every_line_and_standard_error_what_is_wrong")
def test_in_virtual_time_two_logs_are_the_same_bytes(folder: Path) -> None:
    logs = []
    for name in ("a.log", "b.log"):
        arguments = ("--simulate", "--for", "30", "--log-level", "counter=debug", "--log-file", name)
        assert aiorts(folder, "run", "system.toml", *arguments).returncode == 0
        logs.append((folder / name).read_bytes())
    assert logs[0] == logs[1]
    assert len(logs[0].splitlines()) > 20


def test_the_file_has_every_line_and_standard_error_what_is_wrong(folder: Path) -> None:
    for _ in range(2):
        arguments = (*SIMULATED, "--set", "sink.limit=3", "--log-file", "run.log", "-v")
        done = here(folder, "run", *arguments)
        assert done.stderr.startswith("aiorts: E-COMPONENT: sink.on_execute: ValueError: too much (parts.py:31);")
        assert [line[:17] for line in done.stderr.splitlines()[1:]] == ["aiorts: W-DROPPED"]
    lines = [re.sub(f"^{TIME} ", "", line) for line in (folder / "run.log").read_text().splitlines()]
    told = ["info sink: ready", "error E-COMPONENT: sink.on_execute: ValueError: too much (parts.py:31)"]
    assert [line for line in lines if "W-DROPPED" not in line] == told * 2
    assert len(lines) == 6


@pytest.mark.slow(kept_by="test_a_file_that_somebody_else_has_locked_without_a_name_is_refused_all_the_same")
@pytest.mark.fault("F15")
def test_the_second_run_on_a_log_file_says_which_process_has_it(folder: Path) -> None:
    arguments = ("system.toml", "--log-file", "run.log")
    first = started(folder, *arguments)
    try:
        second = aiorts(folder, "run", *arguments)
        assert second.returncode == 2
        assert second.stderr == (
            f"aiorts: E-CONFIG: --log-file run.log: process {first.pid} writes to it; "
            "name another file, or end that process\n"
        )
    finally:
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=10)
    assert aiorts(folder, "run", *arguments, "--for", "0.1").returncode == 0


@pytest.mark.slow(kept_by="test_a_file_that_somebody_else_has_locked_without_a_name_is_refused_all_the_same")
@pytest.mark.fault("F15")
def test_many_who_begin_at_once_leave_one_with_the_file(folder: Path) -> None:
    processes = [begun(folder, "system.toml", "--log-file", "run.log", "--for", "1.5") for _ in range(3)]
    ended = [process.communicate(timeout=30)[1] for process in processes]
    assert sorted(process.returncode for process in processes) == [0, 2, 2]
    holder = next(process for process in processes if process.returncode == 0)
    assert sum(f"process {holder.pid} writes to it" in errors for errors in ended) == 2


@pytest.mark.slow(kept_by="test_lines_that_were_lost_are_counted_once_there_is_room")
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_said_once_and_the_run_goes_on(folder: Path) -> None:
    done = here(folder, "run", "parts.py:Talker", "--rate", "50", "--for", "0.5", "--log-file", "/dev/full")
    assert done.returncode == 0
    full = [line for line in done.stderr.splitlines() if "E-LOG" in line]
    assert len(full) == 1
    assert "/dev/full: No space left on device" in full[0]
    assert done.stderr.count("aiorts: warning: talker: line") > 5


def test_lines_that_were_lost_are_counted_once_there_is_room(tmp_path: Path) -> None:
    said: list[str] = []
    path = tmp_path / "run.log"
    file = LogFile(path, said.append, lambda count: f"{count} lost")
    file.write("one")
    full = os.open("/dev/full", os.O_WRONLY)
    kept = os.dup(file._descriptor)
    os.dup2(full, file._descriptor)
    file.write("two")
    file.write("three")
    os.dup2(kept, file._descriptor)
    file.write("four")
    file.close()
    file.close()
    for descriptor in (full, kept):
        os.close(descriptor)
    assert path.read_text() == "one\n2 lost\nfour\n"
    assert len(said) == 1


def test_a_file_that_somebody_else_has_locked_without_a_name_is_refused_all_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aiorts.cli.runtime.logfile._LOCKS", folder / "nowhere")
    with open(folder / "run.log", "w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(ValueError, match="another process writes to it"):
            LogFile(folder / "run.log", print, str)


def test_nobody_is_kept_from_a_device_or_waits_for_a_pipe(folder: Path) -> None:
    first, second = (LogFile(Path(os.devnull), print, str) for _ in range(2))
    first.close()
    second.close()
    os.mkfifo(folder / "pipe")
    done = here(folder, "run", "parts.py:Counter", "--log-file", "pipe")
    assert done.returncode == 2
    assert "a pipe without a reader" in done.stderr


@pytest.mark.slow
def test_a_component_in_error_is_named_again_at_the_end_when_that_was_long_ago(folder: Path) -> None:
    arguments = ("system.toml", "--set", "sink.limit=3", "--simulate", "--for")
    soon = here(folder, "run", *arguments, "0.5").stderr.splitlines()
    late = here(folder, "run", *arguments, "50").stderr.splitlines()
    assert len(soon) == 1
    assert late == [
        *soon,
        "aiorts: E-COMPONENT: sink: ended in error: ValueError: too much (parts.py:31); --debug shows the traceback",
    ]


def test_the_log_leaves_logging_as_it_was() -> None:
    from aiorts.cli.runtime.session import log_of
    from aiorts.cli.runtime.stopping import Stopper

    def found() -> list[object]:
        loggers = [logging.getLogger(), logging.getLogger("aiorts.component")]
        return [(list(logger.handlers), logger.level) for logger in loggers]

    before = found()
    with log_of(Options(log_level="debug,a=critical"), Stopper()):
        assert found() != before
    assert found() == before
