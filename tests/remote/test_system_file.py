"""System files with members of composites in other kernels."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after

from aiorts import Kernel
from aiorts.errors import ApplyError
from aiorts.system import build, load, wanted
from remote.test_members import state_there
from remote_parts import left

pytestmark = [pytest.mark.anyio, pytest.mark.row(101)]
FILE = """
schema = 1
[links]
[components.source]
type = "FlexiConst"
options = ["-p", "TimedLong", "-c", "3", "--count", "3"]
[components.show]
type = "FlexiDump"
options = ["-p", "TimedLong"]
[composites.arm]
members = ["left/gripper"]
exported = ["gripper.inp", "gripper.force"]
[[connections]]
from = "source.output"
to = "arm.inp"
[[connections]]
from = "arm.force"
to = "show.input0"
[contexts.loop]
kind = "periodic"
rate = 20.0
members = ["source", "arm", "show"]
"""


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, bool]]:
    """One loop: what the process of the other kernel does is most of each test."""
    return "asyncio", {"use_uvloop": True}


def aiorts(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", *words], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_file_with_a_member_elsewhere_is_checked_runs_and_is_saved_as_it_was(tmp_path: Path) -> None:
    file = tmp_path / "right.toml"
    file.write_text(FILE)
    aiorts("check", str(file))
    async with left(tmp_path):
        printed = await asyncio.to_thread(aiorts, "run", "--name", "right", str(file))
        assert [line.rpartition(" ")[2] for line in printed.splitlines()] == ["6", "6", "6"]
        forever = tmp_path / "forever.toml"
        forever.write_text(FILE.replace(', "--count", "3"', ""))
        again = [sys.executable, "-m", "aiorts", "run", "--name", "again", str(forever)]
        with subprocess.Popen(again, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                await asyncio.to_thread(process.stdout.readline)
                saved = await asyncio.to_thread(aiorts, "save", "again")
            finally:
                process.kill()
    assert 'members = ["left/gripper"]' in saved
    assert 'to = "arm.inp"' in saved
    assert "components.gripper" not in saved


@pytest.mark.slow
async def test_a_plan_right_after_the_start_is_empty_and_one_that_changes_links_is_carried_out(tmp_path: Path) -> None:
    def of(name: str, text: str) -> Any:
        (tmp_path / name).write_text(text)
        return load(tmp_path / name)

    text = FILE.replace('"--count", "3"', '"--count", "1000000"')
    first = of("first.toml", text)
    other = of("other.toml", text.replace('to = "show.input0"', 'to = "show.input0"\nlength = 4'))
    stamped = of("stamped.toml", text.replace('to = "show.input0"', 'to = "show.input0"\nstamp = "send"'))
    less = of("less.toml", text[: text.index('[[connections]]\nfrom = "arm.force')] + text[text.index("[contexts") :])
    (tmp_path / "bad.py").write_text(
        "from aiorts import Component\n\nclass Bad(Component):\n    def on_activated(self):\n        raise ValueError\n"
    )
    bad = less.text.replace('"arm", "show"]', '"arm", "show", "bad"]').replace(
        "[composites", '[components.bad]\ntype = "bad.py:Bad"\n[composites'
    )
    async with left(tmp_path), Kernel("right") as kernel:
        await build(kernel, first)
        assert [step.text for step in (await kernel.apply(wanted(first), dry_run=True)).plan.steps] == []
        for system, steps in (
            (other, ["change arm.force -> show.input0: length default -> 4"]),
            (stamped, ["renew arm.force -> show.input0: length 4 -> default, stamp default -> send"]),
            (less, ["disconnect arm.force -> show.input0"]),
            (first, ["connect arm.force -> show.input0"]),
        ):
            assert [step.text for step in (await kernel.apply(wanted(system))).plan.steps] == steps
            assert (await kernel.apply(wanted(system), dry_run=True)).plan.empty
        with pytest.raises(ApplyError, match="all of it was taken back"):
            await kernel.apply(wanted(of("fails.toml", bad)))
        assert (await kernel.apply(wanted(first), dry_run=True)).plan.empty
        ports = {one.profile.ports for one in kernel.connectors.values()}
        assert ports == {("source.output", "gripper.inp"), ("gripper.force", "show.input0")}


@pytest.mark.slow
async def test_a_file_whose_members_are_all_elsewhere_runs(tmp_path: Path) -> None:
    file = tmp_path / "alone.toml"
    file.write_text(
        'schema = 1\n[links]\n[composites.arm]\nmembers = ["left/gripper", "left/finger"]\n'
        '[contexts.main]\nkind = "periodic"\nrate = 20.0\nmembers = ["arm"]\n'
    )
    assert "nothing" not in aiorts("check", str(file))
    async with left(tmp_path):
        words = [sys.executable, "-m", "aiorts", "run", "--name", "alone", str(file)]
        with subprocess.Popen(words) as process:
            try:
                with fail_after(20):
                    while [await state_there(name) for name in ("gripper", "finger")] != ["active", "active"]:
                        await asyncio.sleep(0.05)
                process.send_signal(signal.SIGINT)
                await asyncio.to_thread(process.wait, 20)
            finally:
                process.kill()
        assert [await state_there(name) for name in ("gripper", "finger")] == ["inactive", "inactive"]


@pytest.mark.slow
@pytest.mark.row(56)
async def test_a_kernel_that_was_killed_is_started_anew_beside_what_the_other_one_kept(tmp_path: Path) -> None:
    file = tmp_path / "right.toml"
    file.write_text(FILE.replace(', "--count", "3"', ""))
    async with left(tmp_path):
        for _ in range(3):
            words = [sys.executable, "-m", "aiorts", "run", "--name", "right", str(file)]
            with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
                assert process.stdout is not None
                try:
                    line = await asyncio.to_thread(process.stdout.readline)
                finally:
                    process.kill()
            assert line.endswith(": 6\n")
            await asyncio.sleep(1)  # the other one knows by now that its reader is gone
