"""Every example system is saved while it runs; what was saved is the same system, to the byte."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.system import build, check, load
from aiorts.testing import simulate
from aiorts.types import TimedDouble, TimedShortSeq
from aiorts_log import RecordingWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = sorted(path for path in EXAMPLES.rglob("*.toml") if path.name != "pyproject.toml")
CHANGES = {
    "manipulator/replay.toml": ("tape.path=run.csv",),
    "roomba/replay.toml": ("recorder.min_free=0", "player.speed=1000"),
}


def tape(folder: Path) -> None:
    """What replay.toml plays."""
    rows = "".join(f"{tick / 500},0,0,0,0,0,0\n" for tick in range(10))
    (folder / "run.csv").write_text(rows)


def drive(folder: Path) -> None:
    with RecordingWriter(folder / "drive.mcap") as writer:
        encoders = writer.add_port("encoders", TimedShortSeq, {"unit": "count"})
        truth = writer.add_port("truth", TimedDouble, {"unit": "rad"})
        for row in range(5):
            tm = row * 10_000_000
            writer.write(encoders, TimedShortSeq(tm, [row, row]), tm)
            writer.write(truth, TimedDouble(tm, 0.0), tm)


async def saved(file: Path, changes: Sequence[str], into: Path) -> str:
    """The system of a file, saved after it ran for a while."""
    async with Kernel() as kernel:
        await build(kernel, load(file, changes))
        await kernel.sleep(0.2)
        assert await kernel.save(into) == ()
    return await asyncio.to_thread(into.read_text)


@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_what_was_saved_is_the_same_system(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / file.parent.name
    shutil.copytree(file.parent, folder)
    monkeypatch.chdir(folder)
    changes = CHANGES.get(f"{folder.name}/{file.name}", ())
    if file.name == "replay.toml":
        (tape if folder.name == "manipulator" else drive)(folder)
    first, second = folder / "first.toml", folder / "second.toml"
    text = simulate(saved(folder / file.name, changes, first))
    assert [one for one in check(first) if one.severity == "error"] == []
    (folder / "driven.mcap").unlink(missing_ok=True)
    assert simulate(saved(first, (), second)) == text
    assert str(tmp_path) not in text
