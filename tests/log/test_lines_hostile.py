"""JSON lines that somebody made up: refused or told, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts_log import DamagedError, RecordingError, open_recording

GOOD = '{"port": "a", "type": "TimedDouble", "tm": 7, "data": 1.5, "log_time": 5}\n'
FRONT = '{"port": "a", "type": "TimedDouble", '


@pytest.mark.parametrize(
    "line",
    [
        FRONT + '"data": x, "log_time": 5}',
        FRONT + '"tm": {"sec": "aaaa", "nsec": 1}, "data": 1.5}',
        FRONT + '"tm": {"sec": [1, 2], "nsec": 1}, "data": 1.5}',
        FRONT + '"tm": {"sec": null, "nsec": 1}, "data": 1.5, "log_time": 5}',
        FRONT + '"tm": {"sec": 1, "nsec": "b"}, "data": 1.5, "log_time":5 }',
        '{"port": "a", "type": "Unknown", "tm": 7, "none": 1.5, "log_time": 5}',
        '{"port": "a", "type": "Unknown", "data": x, "log_time": 5}',
    ],
)
def test_a_line_that_is_no_sample_is_told_as_damage(line: str, tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    path.write_text(f"{GOOD}{line}\n{GOOD}", encoding="utf-8")
    with open_recording(path) as reader:
        with pytest.raises(RecordingError) as found:
            list(reader.records())
        assert "Unknown" in line or isinstance(found.value, DamagedError)
        (gap,) = reader.check()
        assert "line 2" in gap.why
