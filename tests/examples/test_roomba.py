"""The recording of a real robot against its own ground truth, and every way in which that must not pass."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts import Kernel, run
from aiorts.system import build, load, wait_finished
from campaign import CAMPAIGN
from run_parts import here

ROOT = Path(__file__).parents[2]
SYSTEM = ROOT / "examples" / "roomba" / "system.toml"
ROWS = (ROOT / "examples" / "roomba" / "imu.txt").read_text().splitlines()
LEFT, RIGHT = 12, 13
ROWS_CHANGED = [0, 1, 600, 1215, *([2, 1214, *random.Random(7).sample(range(1216), 30)] if CAMPAIGN else [])]


def played(path: Path, capsys: pytest.CaptureFixture[str], speed: float = 1e6) -> tuple[int, str]:
    """Play a recording: the exit status it would have, and the last line it printed."""

    async def main() -> int:
        async with Kernel() as kernel:
            await build(kernel, load(SYSTEM, [f"imu.path={path}", f"imu.speed={speed}"]))
            assert await wait_finished(kernel) == ()
        return kernel.exit_status

    status = run(main)
    return status, capsys.readouterr().out.splitlines()[-1]


def recording(folder: Path, rows: list[str]) -> Path:
    path = folder / "other.txt"
    path.write_text("\n".join(rows) + "\n")
    return path


def changed(row: str, column: int, value: object) -> str:
    cells = row.split(",")
    cells[column] = f" {value}"
    return ",".join(cells)


def count(row: str, column: int) -> int:
    return int(row.split(",")[column])


def wrapped(value: int) -> int:
    return (value + 2**15) % 2**16 - 2**15


def test_the_recording_is_the_one_of_the_notice() -> None:
    assert len(ROWS) == 1216
    assert all(len(row.split(",")) == 15 for row in ROWS)
    assert "12997a8" in (SYSTEM.parent / "NOTICE").read_text()


@pytest.mark.slow(kept_by="test_the_command_of_the_readme_runs_with_nothing_else_running")
def test_every_heading_is_verified(capsys: pytest.CaptureFixture[str]) -> None:
    status, said = played(SYSTEM.parent / "imu.txt", capsys)
    assert (status, said) == (0, "heading verified: 1216 of 1216 within 1e-6 rad")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_counters_that_wrap_give_the_same_heading(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    chance = random.Random(seed)
    # Each column by so much that it passes the end of its 16 bits at some row of its own.
    rows = ROWS
    for column in (LEFT, RIGHT):
        straight = [count(line, column) for line in ROWS]
        shift = 2**15 - chance.randint(min(straight) + 1, max(straight))
        rows = [changed(line, column, wrapped(count(line, column) + shift)) for line in rows]
        counts = [count(line, column) for line in rows]
        assert max(abs(new - old) for old, new in itertools.pairwise(counts)) > 60_000
    status, said = played(recording(tmp_path, rows), capsys)
    assert (status, said) == (0, "heading verified: 1216 of 1216 within 1e-6 rad")


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS_CHANGED)
@pytest.mark.parametrize("column", [LEFT, RIGHT])
def test_one_count_changed_anywhere_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], row: int, column: int
) -> None:
    rows = list(ROWS)
    step = 1 if row % 2 else -1
    rows[row] = changed(rows[row], column, wrapped(count(rows[row], column) + step))
    status, said = played(recording(tmp_path, rows), capsys)
    # The heading is a sum of differences: what the first row says only shows in the second.
    assert status == 1
    assert said.startswith(f"heading not verified: row {row or 1} is wrong: got ")
    assert "rad, expected " in said


@pytest.mark.slow
def test_a_heading_changed_in_the_truth_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(ROWS)
    rows[700] = changed(rows[700], 14, float(rows[700].split(",")[14]) + 2e-6)
    status, said = played(recording(tmp_path, rows), capsys)
    assert (status, said.partition(" is")[0]) == (1, "heading not verified: row 700")


def test_no_rows_are_not_all_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "empty.txt"
    path.write_text("")
    assert played(path, capsys) == (1, "heading not verified: 0 of 0 rows arrived")


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", "run", str(SYSTEM), *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(4)
def test_the_command_of_the_readme_runs_with_nothing_else_running() -> None:
    done = command("--set", "imu.speed=200")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "heading verified: 1216 of 1216 within 1e-6 rad"
    assert any(line.startswith("pose TimedPose2D 2.0") for line in done.stdout.splitlines())
    assert done.stderr == ""


@pytest.mark.slow(kept_by="test_the_command_of_the_readme_runs_with_nothing_else_running")
def test_it_gives_the_same_bytes_in_virtual_time() -> None:
    first, second = command("--simulate"), command("--simulate")
    assert first.returncode == second.returncode == 0
    assert first.stdout == second.stdout
    assert first.stdout.splitlines()[-1] == "heading verified: 1216 of 1216 within 1e-6 rad"


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        (3, "seven", "could not convert"),
        (LEFT, "1.5", "invalid literal"),
        (RIGHT, "32768", "-32768..32767"),
        (14, "1, 2", "expected 15 columns, got 16"),
    ],
)
def test_a_bad_row_is_named_with_file_and_line(tmp_path: Path, column: int, value: str, said: str) -> None:
    rows = list(ROWS)
    rows[41] = changed(rows[41], column, value)
    done = here("run", SYSTEM, "--set", f"imu.path={recording(tmp_path, rows)}")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert f"{tmp_path / 'other.txt'}:42: " in done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
