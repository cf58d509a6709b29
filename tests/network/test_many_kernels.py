"""`aiorts at` with many kernels: all are listed by one question, and none that is there is left out."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from campaign import CAMPAIGN
from network.network_parts import free_port
from network.test_other_hosts import PARTS, SYSTEM, WAIT

pytestmark = pytest.mark.slow

COUNT = 1_000 if CAMPAIGN else 100


@contextmanager
def fleet(count: int, silent: int = 0) -> Iterator[str]:
    """Simulated kernels, of which the first never answer, and where they are reached."""
    where = f"127.0.0.1:{free_port()}"
    program = [sys.executable, str(Path(__file__).with_name("fleet_program.py")), where, str(count), str(silent)]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield where
        finally:
            process.kill()


def at(where: str, *words: str) -> tuple[list[str], str]:
    """The lines of a command, and its errors."""
    with tempfile.TemporaryDirectory(prefix="ai") as folder:
        command = [sys.executable, "-m", "aiorts", "at", "--insecure-network", where, *words]
        own = os.environ | {"XDG_RUNTIME_DIR": folder}
        done = subprocess.run(command, capture_output=True, text=True, timeout=3 * WAIT, env=own, check=False)
    return done.stdout.splitlines(), done.stderr


def expected(numbers: range) -> list[str]:
    """What `ls` shows of these, in order."""
    order = sorted(numbers, key=lambda number: f"host{number // 10}/robot{number}")
    return [line for number in order for line in (f"robot{number}/", f"  drive{number}")]


def test_all_are_listed_without_a_session_for_each() -> None:
    # They have no sessions at all: what is shown was answered to one question.
    with fleet(COUNT) as where:
        took = []
        for _ in range(5 if CAMPAIGN else 1):
            began = time.monotonic()
            assert at(where, "ls") == (expected(range(COUNT)), "")
            took.append(time.monotonic() - began)
        print(f"{COUNT} kernels: {statistics.median(took):.2f} s")
        assert at(where, "ls", "robot7/drive7", "--json")[0][-1] == "}"


def test_who_does_not_answer_is_shown_as_such() -> None:
    with fleet(40, silent=3) as where:
        lines, errors = at(where, "ls")
    assert lines[:-3] == expected(range(3, 40)), errors
    assert [line.partition("  ")[::2] for line in lines[-3:]] == [
        (f"robot{number}/", line.partition("  ")[2]) for number, line in enumerate(lines[-3:])
    ]
    assert all("no answer" in line for line in lines[-3:])


def test_among_many_one_is_operated_as_before(tmp_path: Path) -> None:
    (tmp_path / "system.toml").write_text(SYSTEM)
    (tmp_path / "parts.py").write_text(PARTS)
    with fleet(40) as where, tempfile.TemporaryDirectory(prefix="ai") as folder:
        run = [sys.executable, "-m", "aiorts", "run", str(tmp_path / "system.toml"), "--name", "real", "--host", "far"]
        run += ["--connect", where, "--insecure-network", "--allow-control"]
        log = (tmp_path / "log.txt").open("w")
        with log, subprocess.Popen(run, env=os.environ | {"XDG_RUNTIME_DIR": folder}, stdout=log, stderr=log) as real:
            try:
                until = time.monotonic() + WAIT
                while "  counter" not in (lines := at(where, "ls")[0]):
                    assert time.monotonic() < until, (lines, (tmp_path / "log.txt").read_text())
                assert len(lines) == 82
                assert f"real/  process {real.pid}, open" in at(where, "ls", "-l")[0][0]
                assert at(where, "conf", "counter", "step=5")[1] == ""
                assert "5" in next(line for line in at(where, "conf", "real/counter")[0] if "step" in line).split()
                assert len(at(where, "print", "counter.out", "--count", "3")[0]) == 3
            finally:
                real.kill()
