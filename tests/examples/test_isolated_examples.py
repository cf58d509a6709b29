"""Examples with a component in a process of its own: the manipulator's plant; the Roomba's odometry, killed, too."""

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

from process_parts import MARK, all_gone, marked, there

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"
TRIES = 3
"""Whatever else runs on this machine makes ticks late, and never less so."""


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with TemporaryDirectory(prefix="al") as folder:
        with marked() as mark:
            yield {**os.environ, "XDG_RUNTIME_DIR": folder}
            assert all_gone(mark) == {}
        assert [path.name for path in Path(folder).rglob("*") if not path.is_dir()] in ([], ["log"])


def settled(file: str, environment: dict[str, str]) -> tuple[int, int | None, str]:
    """Run the manipulator: exit status, milliseconds until it had settled, what it printed."""
    command = [sys.executable, "-m", "aiorts", "run", str(EXAMPLES / "manipulator" / file)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=40, check=False)
    found = re.search(r"N s/m +\d+ ms +(\d+) ms", done.stdout)
    return done.returncode, int(found[1]) if found else None, done.stdout + done.stderr


@pytest.mark.row(51)
def test_the_manipulator_settles_alike_with_its_plant_in_a_process_of_its_own(environment: dict[str, str]) -> None:
    status, here, said = settled("sim.toml", environment)
    assert (status, here is not None) == (0, True), said
    for _ in range(TRIES):
        status, apart, said = settled("plant.toml", environment)
        print(f"settled after {here} ms in the simulator, {apart} ms with the plant in a process of its own\n{said}")
        if status == 0:
            break
    assert status == 0, said
    assert here is not None
    assert apart is not None
    assert abs(apart - here) <= 100


def the_process(environment: dict[str, str]) -> int:
    """The process of the one isolated component of what this test runs."""
    before = time.monotonic()
    while time.monotonic() < before + 40:
        for pid in there(environment[MARK]):
            try:
                words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if b"kernel" in words:
                return pid
        time.sleep(0.02)
    raise AssertionError("there is no such process")


def played(environment: dict[str, str], speed: float, *, killed: bool) -> tuple[int, str]:
    """Play the Roomba's recording, the odometry apart: exit status, what was printed."""
    log = Path(environment["XDG_RUNTIME_DIR"]) / "log"
    command = [sys.executable, "-m", "aiorts", "run", str(EXAMPLES / "roomba/isolated.toml"), "--set"]
    with log.open("wb") as file:
        process = subprocess.Popen(
            [*command, f"imu.speed={speed}"], env=environment, stdout=file, stderr=subprocess.STDOUT
        )
    try:
        if killed:
            before = time.monotonic()
            while "pose TimedPose2D 4." not in log.read_text():
                assert time.monotonic() < before + 40, log.read_text()
                time.sleep(0.02)
            os.kill(the_process(environment), signal.SIGKILL)
        return process.wait(60), log.read_text()
    finally:
        process.kill()
        process.wait(10)


def test_the_roomba_verifies_its_heading_with_the_odometry_in_a_process_of_its_own(environment: dict[str, str]) -> None:
    status, said = played(environment, 40, killed=False)
    assert status == 0, said
    assert "heading verified: 1216 of 1216 within 1e-6 rad\n" in said, said


@pytest.mark.fault("A13")
def test_the_odometry_is_killed_in_the_midst_of_a_replay_and_comes_back_with_the_loss_said(
    environment: dict[str, str],
) -> None:
    status, said = played(environment, 6, killed=True)
    pattern = r"heading verified: (\d+) of 1216 within 1e-6 rad; (\d+) rows were lost, the odometry began anew 1 time"
    verified = re.search(pattern, said)
    assert verified is not None, said
    rows, lost = map(int, verified.groups())
    print(verified[0], *re.findall(r"W-LINK.*", said), sep="\n")
    assert (status, rows + lost) == (1, 1216), said
    assert lost < 200
