"""Every example system is saved while it runs; what was saved is the same system, to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.planning import Planning
from aiorts.system import SystemFile, build, check_text, load, parse
from aiorts.testing import simulate
from aiorts.types import TimedDouble, TimedShortSeq
from aiorts_log import RecordingWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
FILES = sorted(path for path in EXAMPLES.rglob("*.toml") if path.name != "pyproject.toml")
CHANGES = {
    "manipulator": ("tape.path={}/run.csv",),
    "roomba": (
        *("recorder.min_free=0", "player.speed=1000", "player.logfile={}/drive.mcap"),
        "recorder.logfile={}/driven.mcap",
    ),
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


async def saved(system: SystemFile) -> str:
    """The system of a file, as the text of one beside it, after it ran for a while."""
    async with Kernel() as kernel:
        await build(kernel, system)
        await kernel.sleep(0.2)
        found = kernel.service(Planning).text(system.path.parent)
    assert found.notes == ()
    return found.text


@pytest.mark.slow(kept_by="planning/test_save.py::test_what_a_program_made_is_saved_without_what_is_so_by_default")
@pytest.mark.parametrize("file", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_what_was_saved_is_the_same_system(file: Path, tmp_path: Path) -> None:
    changes: tuple[str, ...] = ()
    if file.name == "replay.toml":
        (tape if file.parent.name == "manipulator" else drive)(tmp_path)
        changes = tuple(change.format(tmp_path) for change in CHANGES[file.parent.name])
    text = simulate(saved(load(file, changes)))
    for path in tmp_path.glob("driven*"):
        path.unlink()
    assert str(file.parent) not in text
    again = file.with_name("saved.toml")
    assert [one for one in check_text(text, again) if one.severity == "error"] == []
    assert simulate(saved(parse(text, again))) == text
