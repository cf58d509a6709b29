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


def start(name: str, environment: dict[str, str], *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "aiorts", "run", str(FOLDER / f"{name}.toml"), *options]
    with log(name, environment).open("ab") as file:
        return subprocess.Popen(command, env=environment, stdout=file, stderr=subprocess.STDOUT)


def log(name: str, environment: dict[str, str]) -> Path:
    return Path(environment["XDG_RUNTIME_DIR"]) / f"{name}.log"


@pytest.mark.slow(
    kept_by="links/test_kernels.py::test_what_is_written_in_one_kernel_is_read_in_the_other_in_order_and_accounted_for"
)
def test_three_processes_verify_the_heading(environment: dict[str, str]) -> None:
    said = played(environment, speed=40, killed=False)
    assert "heading verified: 1216 of 1216 within 1e-6 rad" in said["monitor"], said


@pytest.mark.slow(kept_by="links/test_kernels.py::test_a_kernel_that_is_started_anew_goes_on_with_the_loss_counted")
def test_the_middle_one_is_killed_and_started_anew_and_the_loss_is_said(environment: dict[str, str]) -> None:
    said = played(environment, speed=6, killed=True)
    pattern = r"heading verified: (\d+) of 1216 within 1e-6 rad; (\d+) rows were lost, (.*)"
    verified = re.search(pattern, said["monitor"])
    assert verified is not None, said
    rows, lost, anew = verified.groups()
    assert int(rows) + int(lost) == 1216
    assert anew == "the odometry began anew 1 time(s)"
    unknown = re.findall(r"imu.encoders-odometry.*dropped\{unknown_fate\} (\d+)", said["robot"])
    # What was on its way and had no row of its own yet is lost, with what lay unread in the process that was killed.
    assert int(lost) <= sum(map(int, unknown)) + 3 * 64, said


def played(environment: dict[str, str], *, speed: float, killed: bool) -> dict[str, str]:
    """Play the recording through three processes; returns what each has said."""
    processes = {name: start(name, environment) for name in ("monitor", "odometry")}
    processes["robot"] = start("robot", environment, "--set", f"imu.speed={speed}")
    try:
        if killed:
            until(environment, "monitor", "pose TimedPose2D 4.")
            processes["odometry"].kill()
            processes["odometry"].wait(20)
            processes["odometry"] = start("odometry", environment)
        assert processes["robot"].wait(60) == 0
        time.sleep(4.0)  # for what is on its way between the other two
        for name in ("odometry", "monitor"):
            processes[name].send_signal(signal.SIGINT)
            processes[name].wait(20)
    finally:
        for process in processes.values():
            process.kill()
            process.wait(10)
    return {name: log(name, environment).read_text() for name in processes}


def until(environment: dict[str, str], name: str, text: str) -> None:
    """Wait until a process has said that."""
    before = time.monotonic()
    while text not in log(name, environment).read_text():
        assert time.monotonic() < before + 40, f"{name} has not said {text!r}"
        time.sleep(0.02)
