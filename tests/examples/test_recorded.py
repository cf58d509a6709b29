"""Every example's system with a recorder beside it: it does what it does without, and twice the same to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts_log import RecordingReader
from run_parts import here

EXAMPLES = Path(__file__).parents[2] / "examples"
NOT_ALONE = {
    "manipulator/replay.toml": "needs a recording",
    "roomba/replay.toml": "needs a recording",
    "roomba/odometry.toml": "receives from another process",
    "roomba/monitor.toml": "receives from another process",
    "lrf/desk.toml": "receives from other files",
    "lrf/station.toml": "receives from other processes",
}
SYSTEMS = [
    name
    for path in sorted(EXAMPLES.glob("*/*.toml"))
    if "schema = 1" in path.read_text() and (name := path.relative_to(EXAMPLES).as_posix()) not in NOT_ALONE
]


@pytest.mark.slow(kept_by="log/test_beside.py::test_two_runs_in_virtual_time_are_the_same_to_the_byte")
@pytest.mark.row(128)
@pytest.mark.parametrize("name", SYSTEMS)
def test_an_example_is_recorded_and_stays_what_it_is(name: str, tmp_path: Path) -> None:
    command, paths = (
        ["run", str(EXAMPLES / name), "--simulate", "--for", "3"],
        [tmp_path / "a.mcap", tmp_path / "b.mcap"],
    )
    without = here(*command)
    for path in paths:
        done = here(*command, "--record", str(path))
        assert (done.returncode, done.stdout, done.stderr) == (without.returncode, without.stdout, without.stderr)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with RecordingReader(paths[0]) as reader:
        assert (reader.clean, reader.count > 0) == (True, True)
