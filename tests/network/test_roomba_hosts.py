"""The Roomba example on two hosts, one of which is killed in mid replay: the heading is right, and the loss is said."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

EXAMPLE = Path(__file__).parents[2] / "examples" / "roomba"
ROWS = 1216
UNREAD = 3 * 64
"""Samples that may lie in the buffers of the process that is killed."""


class Drive:
    """Three processes: `odometry`, in the middle, on the second host, `monitor` and `robot` on the first one."""

    def __init__(self, hosts: tuple[list[str], list[str]], folder: Path) -> None:
        here, there = hosts
        self._folder = folder
        near = ["--host", "one", "--connect", "10.77.0.2:7447", "--insecure-network"]
        far = ["--host", "two", "--listen", "10.77.0.2:7447", "--insecure-network"]
        self._on = {"odometry": (there, far), "monitor": (here, near), "robot": (here, near)}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, *options: str) -> None:
        before, network = self._on[name]
        command = [*before, sys.executable, "-m", "aiorts", "run", str(EXAMPLE / f"{name}.toml"), *network, *options]
        with (self._folder / name).open("ab") as output:
            self.processes[name] = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)

    def said(self, name: str) -> str:
        return (self._folder / name).read_text(encoding="utf-8")

    def until(self, name: str, text: str, within: float = 40.0) -> None:
        ends = time.monotonic() + within
        while not re.search(text, self.said(name)):
            assert time.monotonic() < ends, (name, text, [(one, self.said(one)[-2000:]) for one in self.processes])
            time.sleep(0.02)

    def still(self, name: str) -> None:
        """Wait until nothing new is said for a while."""
        before, since = "", time.monotonic()
        while time.monotonic() < since + 3.0:
            if (said := self.said(name)) != before:
                before, since = said, time.monotonic()
            time.sleep(0.1)

    def end(self, name: str) -> None:
        self.processes[name].terminate()
        self.processes[name].wait(20)


@pytest.mark.slow(kept_by="links/test_kernels.py::test_a_kernel_that_is_started_anew_goes_on_with_the_loss_counted")
@pytest.mark.fault("E01")
def test_the_middle_one_is_killed_in_mid_replay_and_what_was_lost_is_said(
    hosts: tuple[list[str], list[str]], tmp_path: Path
) -> None:
    drive = Drive(hosts, tmp_path)
    try:
        for name in ("odometry", "monitor"):
            drive.start(name)
        drive.start("robot", "--set", "imu.speed=6")
        drive.until("monitor", r"pose TimedPose2D ([4-9]|1\d)\.")  # as it comes to the terminal: not each second
        drive.processes["odometry"].kill()
        drive.processes["odometry"].wait(20)
        drive.start("odometry")
        assert drive.processes["robot"].wait(60) == 0, drive.said("robot")
        drive.still("monitor")
        for name in ("odometry", "monitor"):
            drive.end(name)
    finally:
        for process in drive.processes.values():
            process.kill()
            process.wait(10)
    said = drive.said("monitor")
    found = re.search(rf"heading verified: (\d+) of {ROWS} within 1e-6 rad; (\d+) rows were lost, (.*)", said)
    assert found is not None, (said, drive.said("odometry"), drive.said("robot"))
    rows, lost, anew = found.groups()
    assert (int(rows) + int(lost), anew) == (ROWS, "the odometry began anew 1 time(s)")
    counts = re.findall(r"imu.encoders-.*dropped\{unknown_fate\} (\d+)", drive.said("robot"))
    assert 0 < int(lost) <= sum(map(int, counts)) + UNREAD, (found[0], drive.said("robot"))
    print(f"{found[0]}; {counts} of unknown fate")
