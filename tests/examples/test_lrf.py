"""Range finders that are calibrated from the tracks of one walker: in one process, in four, and on three hosts."""

from __future__ import annotations

import cmath
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.errors import GoalCancelled, ServiceFailed
from aiorts.guide.contents import FOLDER, page
from aiorts.kernel.extensions.files import load_file
from aiorts.system import build, load
from aiorts.testing import Rig, simulate, simulated
from aiorts.types import Point2D, Pose2D, TimedPoint2D
from run_parts import here

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "lrf"
POSE = re.compile(r"^(\w+) +(-?\d+\.\d+) m +(-?\d+\.\d+) m +(-?\d+\.\d+) deg: \S+ mm and \S+ deg off$", re.MULTILINE)
LOST = re.compile(r"^calibrated from 300 matches; (\d+) scans in between were lost$", re.MULTILINE)
SMOOTH = "calibrated from 300 matches; 0 scans in between were lost"


def module(name: str) -> Any:
    return load_file(EXAMPLE / f"{name}.py")


def poses(said: str) -> dict[str, tuple[float, ...]]:
    """What was printed of each range finder: metres, metres, degrees."""
    return {name: tuple(map(float, numbers)) for name, *numbers in POSE.findall(said)}


@pytest.fixture(scope="module")
def one_process() -> str:
    """What the run in one process says."""
    done = here("run", str(EXAMPLE / "system.toml"))
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def ran(*options: str) -> tuple[int, str]:
    """A run of the processes: exit status, what was said."""
    command = [sys.executable, str(EXAMPLE / "run.py"), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = process.communicate(timeout=95)
        except subprocess.TimeoutExpired:
            process.terminate()  # it ends the processes that it has started
            said = process.communicate(timeout=20)
    return process.returncode, "".join(said)


# -- the parts ---------------------------------------------------------------------------------------------------------

numbers = st.floats(-10.0, 10.0)
headings = st.floats(-3.0, 3.0)
pose = st.builds(lambda x, y, heading: Pose2D(Point2D(x, y), heading), numbers, numbers, headings)


@pytest.mark.slow
@given(first=pose, other=pose)
def test_poses_are_found_from_tracks_without_noise(first: Pose2D, other: Pose2D) -> None:
    walked = np.array([0.0, 1.0, 1.0 + 2.0j, -1.0 + 0.5j])
    seen = [
        (walked - complex(one.position.x, one.position.y)) * cmath.rect(1.0, -one.heading) for one in (first, other)
    ]
    for found, true in zip(module("calibration").poses_of(np.array(seen), first), (first, other), strict=True):
        assert math.isclose(found.position.x, true.position.x, abs_tol=1e-9)
        assert math.isclose(found.position.y, true.position.y, abs_tol=1e-9)
        assert math.isclose(found.heading, true.heading, abs_tol=1e-9)


@given(distance=st.floats(0.5, 6.0), bearing=headings)
def test_the_middle_of_the_walker_is_found_from_his_near_side(distance: float, bearing: float) -> None:
    middle = cmath.rect(distance, bearing)
    side = middle - 0.2 * cmath.rect(1.0, bearing) * np.exp(1j * np.linspace(-1.2, 1.2, 9))
    assert abs(module("tracker").middle_of(side, 0.2) - middle) < 1e-9


def test_a_ray_goes_to_the_wall_or_to_the_walker_who_stands_before_it() -> None:
    rays = np.exp(1j * np.radians([0.1, 90.1, 180.1]))
    far = module("room").distances(1.0 + 1.0j, rays, 1.0 - 2.0j)
    near = module("room").distances(1.0 + 1.0j, rays, 3.0 + 1.0j)
    assert far == pytest.approx([3.0, 2.0, 5.0], abs=1e-3)
    assert near == pytest.approx([1.8, 2.0, 5.0], abs=1e-3)


def point(tm: int, at: complex) -> TimedPoint2D:
    return TimedPoint2D(tm, Point2D(at.real, at.imag))


@simulated
async def test_tracks_of_the_same_moments_make_a_calibration_and_what_lies_between_is_counted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    calibration = module("calibration").Calibration("calibration")
    walked = {25: 0j, 50: 1 + 0j, 100: 1 + 2j, 125: 3 + 1j}
    async with Rig(calibration) as rig:
        await calibration.configure(matches=3)
        rig.feed("west", *[point(tm, at) for tm, at in walked.items()])
        goal = await rig.call("calibration.service", "calibrate", Pose2D(Point2D(1.0, 2.0), math.pi / 2))
        rig.feed("north", *[point(tm, at * 1j) for tm, at in walked.items() if tm != 50])
        rig.feed("east", *[point(tm, at - 1j) for tm, at in walked.items()])
        await rig.tick(2)
        _, north, east = await goal.result()
    assert (north.position.x, north.position.y, north.heading) == pytest.approx((1.0, 2.0, 0.0), abs=1e-9)
    assert (east.position.x, east.position.y, east.heading) == pytest.approx((0.0, 2.0, math.pi / 2), abs=1e-9)
    assert capsys.readouterr().out == "calibrated from 3 matches; 2 scans in between were lost\n"


@simulated
async def test_a_calibration_is_cancelled_and_another_one_refused_while_it_runs() -> None:
    async with Rig(module("calibration").Calibration("calibration")) as rig:
        goal = await rig.call("calibration.service", "calibrate", Pose2D())
        with pytest.raises(ServiceFailed, match="it calibrates already"):
            await rig.call("calibration.service", "calibrate", Pose2D())
        goal.cancel()
        await rig.tick(2)
        with pytest.raises(GoalCancelled):
            await goal.result()


@simulated
async def test_a_transform_is_silent_until_its_configuration_set_has_the_pose() -> None:
    transform = module("transform").Transform("transform")
    async with Rig(transform) as rig:
        rig.feed("track", point(1, 1 + 0j))
        await rig.tick()
        assert rig.received("mapped") == []
        await rig.call("transform.placing", "place", Pose2D(Point2D(1.0, 2.0), math.pi / 2))
        rig.feed("track", point(2, 1 + 0j))
        await rig.tick()
        assert transform.configuration.active == "calibrated"
        (mapped,) = rig.received("mapped")
        assert (mapped.tm, mapped.data.x, mapped.data.y) == (2, pytest.approx(1.0), pytest.approx(3.0))


# -- in one process ----------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
def test_in_one_process_every_pose_is_right(one_process: str) -> None:
    assert SMOOTH in one_process
    assert [*poses(one_process)] == ["west", "north", "east"]
    assert re.search(r"^on one map: 300 points, [1-5]\.\d+ mm from the middle of the three", one_process, re.MULTILINE)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("change", ["operator.within=0.0001", "operator.within_degrees=0.001"])
def test_a_pose_that_is_not_right_is_said_and_ends_with_status_1(change: str) -> None:
    done = here("run", str(EXAMPLE / "system.toml"), "--set", change)
    assert (done.returncode, "deg WRONG\n" in done.stdout) == (1, True), done.stdout


@pytest.mark.slow(kept_by="test_a_transform_is_silent_until_its_configuration_set_has_the_pose")
def test_a_range_finder_that_has_lost_its_pose_is_given_it_again(capsys: pytest.CaptureFixture[str]) -> None:
    async def main() -> tuple[int, str]:
        async with Kernel() as kernel:
            await build(kernel, load(EXAMPLE / "system.toml", ["map.matches=60"]))
            transform = kernel.components["north_transform"]
            while transform.configuration.active == "default":
                await kernel.sleep(0.1)
            await transform.configuration.activate("default")
            return await kernel.wait_stop_requested(), transform.configuration.active

    assert simulate(main()) == (0, "calibrated")
    assert "on one map: 60 points" in capsys.readouterr().out


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
def test_the_page_of_the_guide_has_the_picture_that_is_drawn_and_the_poses_that_are_found(one_process: str) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLE / "picture.py")], capture_output=True, text=True, timeout=60, check=True
    )
    assert (FOLDER / "howto" / "calibration.svg").read_text(encoding="utf-8") == done.stdout
    found = page("calibration")
    assert found is not None
    assert "](calibration.svg)" in found.text
    for name, numbers in poses(one_process).items():
        assert poses(found.text.partition("## When")[0])[name] == pytest.approx(numbers, abs=1e-9)


# -- in several --------------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
def test_four_processes_find_the_same_poses(one_process: str) -> None:
    status, said = ran()
    assert (status, SMOOTH in said) == (0, True), said
    for name, found in poses(one_process).items():
        assert poses(said)[name] == pytest.approx(found, abs=1e-9)


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
@pytest.mark.parametrize("killed", ["north", "station"])
def test_one_that_is_killed_in_mid_calibration_is_started_again_and_the_poses_are_right(killed: str) -> None:
    status, said = ran("--kill", killed)
    assert (status, len(poses(said))) == (0, 3), said
    assert f"{killed} is killed, and started again\n" in said
    lost = LOST.search(said)
    assert lost is not None, said
    if killed == "north":
        assert 80 < int(lost[1]) < 2000  # its tracker learns the room for 80 scans
    else:
        assert (int(lost[1]), said.count("100 matches\n")) == (0, 2)


@pytest.fixture
def namespaces() -> None:
    pytest.importorskip("zenoh")
    pytest.importorskip("cryptography")
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("not run: network namespaces need `ip` and root")
    name = f"lrf-{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False, timeout=10)
    if made.returncode:
        pytest.skip(f"not run: no network namespaces here: {made.stderr.strip()[:200]}")
    subprocess.run(["ip", "netns", "del", name], check=True, timeout=10)


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
def test_three_hosts_find_the_same_poses(one_process: str, namespaces: None) -> None:
    status, said = ran("--network")
    assert (status, SMOOTH in said) == (0, True), said
    for name, found in poses(one_process).items():
        assert poses(said)[name] == pytest.approx(found, abs=1e-9)


@pytest.mark.slow(kept_by="test_a_pose_that_is_not_right_is_said_and_ends_with_status_1")
@pytest.mark.fault("E01")
def test_one_of_three_hosts_is_killed_in_mid_calibration(namespaces: None) -> None:
    status, said = ran("--network", "--kill", "north")
    lost = LOST.search(said)
    assert (status, len(poses(said)), lost is not None) == (0, 3, True), said
    assert lost is not None
    assert int(lost[1]) > 80
