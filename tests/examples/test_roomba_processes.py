"""The Roomba example in three processes: the same verified heading as in one."""

from __future__ import annotations

import os
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
    processes = {name: start(name, environment) for name in ("monitor", "odometry")}
    processes["robot"] = start("robot", environment, "--set", "imu.speed=40")
    try:
        assert processes["robot"].wait(60) == 0
        time.sleep(4.0)  # for what is on its way between the other two
        said = {}
        for name in ("odometry", "monitor"):
            processes[name].send_signal(signal.SIGINT)
            said[name], _ = processes[name].communicate(timeout=20)
    finally:
        for process in processes.values():
            process.kill()
            process.wait(10)
            if process.stdout is not None:
                process.stdout.close()
    assert "heading verified: 1216 of 1216 within 1e-6 rad" in said["monitor"], said
