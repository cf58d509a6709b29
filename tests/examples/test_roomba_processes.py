"""The Roomba example in three processes: the same verified heading as in one."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

FOLDER = Path(__file__).parents[2] / "examples/roomba"


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with TemporaryDirectory(prefix="al") as folder:
        yield {**os.environ, "XDG_RUNTIME_DIR": folder}


def start(name: str, environment: dict[str, str], *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "aiorts", "run", str(FOLDER / f"{name}.toml"), *options]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_three_processes_verify_the_heading(environment: dict[str, str]) -> None:
    said = played(environment, speed=40, killed_after=0.0)
    assert "heading verified: 1216 of 1216 within 1e-6 rad" in said["monitor"], said


def test_the_middle_one_is_killed_and_started_anew_and_the_loss_is_said(environment: dict[str, str]) -> None:
    said = played(environment, speed=6, killed_after=1.0)
    pattern = r"heading verified: (\d+) of 1216 within 1e-6 rad; (\d+) rows were lost, (.*)"
    verified = re.search(pattern, said["monitor"])
    assert verified is not None, said
    rows, lost, anew = verified.groups()
    assert int(rows) + int(lost) == 1216
    assert anew == "the odometry began anew 1 time(s)"
    unknown = re.findall(r"imu.encoders-odometry.*dropped\{unknown_fate\} (\d+)", said["robot"])
    # What was on its way and had no row of its own yet is lost, with what lay unread in the process that was killed.
    assert int(lost) <= sum(map(int, unknown)) + 3 * 64, said


def played(environment: dict[str, str], *, speed: float, killed_after: float) -> dict[str, str]:
    """Play the recording through three processes; returns what each has said."""
    processes = {name: start(name, environment) for name in ("monitor", "odometry")}
    said: dict[str, str] = {}
    try:
        if killed_after:
            _until_there(processes["odometry"], environment)
        processes["robot"] = start("robot", environment, "--set", f"imu.speed={speed}")
        if killed_after:
            _until_there(processes["robot"], environment)
            time.sleep(killed_after)
            processes["odometry"].kill()
            processes["odometry"].communicate(timeout=20)
            processes["odometry"] = start("odometry", environment)
        said["robot"], _ = processes["robot"].communicate(timeout=60)
        assert processes["robot"].returncode == 0, said
        time.sleep(4.0)  # for what is on its way between the other two
        for name in ("odometry", "monitor"):
            processes[name].send_signal(signal.SIGINT)
            said[name], _ = processes[name].communicate(timeout=20)
    finally:
        for process in processes.values():
            process.kill()
            process.wait(10)
            if process.stdout is not None:
                process.stdout.close()
    return said


def _until_there(process: subprocess.Popen[str], environment: dict[str, str]) -> None:
    """Wait until its kernel listens for others."""
    folder = Path(environment["XDG_RUNTIME_DIR"]) / "aiorts"
    before, until = len(list(folder.glob("*.link"))), time.monotonic() + 20
    while len(list(folder.glob("*.link"))) <= before and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
