"""The deployed example: its unit file is one, its container file starts it, and it does what both rely on."""

from __future__ import annotations

import configparser
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from run_parts import limited

DEPLOY = Path(__file__).parents[2] / "examples" / "deploy"
ROOT = DEPLOY.parents[1]


def test_the_unit_file_is_one() -> None:
    unit = configparser.ConfigParser(strict=True)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / "robot.service")
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["Restart"] == "on-failure"
    assert float(service["WatchdogSec"]) > 5.0  # the loop's own limit comes first and says more
    assert float(service["TimeoutStopSec"]) > 5.0
    assert (DEPLOY / Path(service["ExecStart"].split()[-1]).name).exists()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_takes_the_unit_file() -> None:
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(DEPLOY / "robot.service")],
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    complaints = [line for line in (done.stdout + done.stderr).splitlines() if "robot.service" in line]
    assert complaints == []


def test_the_container_file_copies_what_there_is_and_lets_signals_through() -> None:
    lines = [line for line in (DEPLOY / "Containerfile").read_text().splitlines() if line and not line.startswith("#")]
    assert lines[0].startswith("FROM ")
    copied = [line.split()[1] for line in lines if line.startswith("COPY ")]
    assert "robot.py" in copied
    entry = next(line for line in lines if line.startswith("ENTRYPOINT "))
    assert entry.startswith("ENTRYPOINT [")  # the shell form would keep SIGTERM from it
    assert entry.endswith('/robot.py"]')
    assert any(line.startswith("USER ") for line in lines)


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("G12")
def test_it_is_ready_answers_the_watchdog_and_stops_at_sigterm(tmp_path: Path) -> None:
    address = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(address))
        systemd.settimeout(20.0)
        environ = {**os.environ, "NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "1000000"}
        environ["PYTHONPATH"] = os.environ.get("PYTHONPATH") or str(ROOT)
        environ.pop("WATCHDOG_PID", None)
        with subprocess.Popen(
            [sys.executable, str(DEPLOY / "robot.py")],
            env=environ,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as robot:
            said: list[str] = []
            with limited(robot):
                while "READY=1" not in said:
                    said += systemd.recv(4096).decode().split("\n")
                said.clear()
                while "WATCHDOG=1" not in said:
                    said += systemd.recv(4096).decode().split("\n")
                robot.send_signal(signal.SIGTERM)
                while "STOPPING=1" not in said:
                    said += systemd.recv(4096).decode().split("\n")
                out, errors = robot.communicate(timeout=20)
    assert robot.returncode == 0, errors
    assert "robot is ready" in out
    assert "after some samples" in out
    # A busy machine that has no bytecode yet imports for longer than the 0.2 s above which the loop's monitor warns.
    assert [line for line in errors.splitlines() if "the event loop does not turn" not in line] == []
