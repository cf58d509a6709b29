"""`aiorts doctor` measures what it says, and says what to do."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


def doctor(*arguments: str, prepare: Any = None, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", "doctor", *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=40,
        preexec_fn=prepare,
    )


def by_name(done: subprocess.CompletedProcess[str]) -> dict[str, dict[str, str]]:
    found: list[dict[str, str]] = json.loads(done.stdout)["findings"]
    assert all(one["verdict"] in ("ok", "note", "problem") for one in found)
    assert all(one["remedy"] or one["verdict"] == "ok" for one in found), "whatever is not ok says what to do"
    return {one["what"]: one for one in found}


@pytest.mark.slow(kept_by="first")
def test_it_looks_at_everything_and_measures_the_timer() -> None:
    done = doctor()
    assert (done.returncode, done.stderr) == (0, "")
    found = by_name(doctor("--json"))
    for what in ("Python", "system", "numpy", "event loop", "kernel", "timers", "terminal", "files", "temp folder"):
        assert what in found
        assert what in done.stdout
    assert found["Python"]["found"].endswith(".".join(map(str, sys.version_info[:3])))
    assert "100 sleeps of 2 ms ended" in found["timers"]["found"]
    assert {"real time", "memory lock"} <= found.keys()
    assert "extra bench" in found
    if found["extra bench"]["verdict"] == "note":
        assert 'pip install "aiorts[bench]"' in found["extra bench"]["remedy"]


@pytest.mark.slow(kept_by="test_it_looks_at_everything_and_measures_the_timer")
def test_privileges_that_are_denied_say_how_to_get_them() -> None:
    libc = ctypes.CDLL(None)

    def drop() -> None:
        resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
        for capability in (14, 23):  # CAP_IPC_LOCK, CAP_SYS_NICE: a program started by root has neither then
            libc.prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP

    done = doctor("--json", prepare=drop)
    assert done.returncode == 0, done.stderr  # all works, only less exactly
    found = by_name(done)
    assert found["real time"]["verdict"] == "note"
    assert "ulimit -r" in found["real time"]["remedy"]
    assert found["memory lock"]["verdict"] == "note"
    assert found["files"]["verdict"] == "note"


@pytest.mark.slow(kept_by="test_it_looks_at_everything_and_measures_the_timer")
@pytest.mark.fault("F16")
def test_problems_make_the_exit_status_1(tmp_path: Path) -> None:
    broken = tmp_path / "plugin"
    broken.mkdir()
    (broken / "pyproject.toml").write_text("[project\n")
    done = doctor("--json", "--plugins", str(broken))
    assert done.returncode == 1
    problems = [one for one in json.loads(done.stdout)["findings"] if one["verdict"] == "problem"]
    assert len(problems) == json.loads(done.stdout)["problems"] == 1
    assert str(broken) in problems[0]["found"]
    told = doctor("--plugins", str(broken))
    assert told.returncode == 1
    assert "1 problem, " in told.stdout


@pytest.mark.slow(kept_by="test_it_looks_at_everything_and_measures_the_timer")
@pytest.mark.fault("F14")
def test_an_encoding_without_other_letters_is_a_note() -> None:
    """On a terminal: what is piped is UTF-8 whatever the encoding is."""
    narrow = {"PYTHONIOENCODING": "ascii", "LANG": "C", "TERM": "dumb", "COLUMNS": "1"}
    ours, its = os.openpty()
    done = subprocess.Popen([sys.executable, "-m", "aiorts", "doctor"], stdout=its, env={**os.environ, **narrow})
    os.close(its)
    text = b""
    with contextlib.suppress(OSError):  # the end of a terminal
        while part := os.read(ours, 4096):
            text += part
    os.close(ours)
    assert done.wait(60) == 0
    assert b"PYTHONUTF8=1" in text
    assert by_name(doctor("--json", **narrow))["terminal"]["verdict"] != "note"
