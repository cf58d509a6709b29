"""Recordings in lines of which hardly any is a sample: memory does not grow with what is of no use."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from aiorts_log import DamagedError, open_recording

LINE = b'a\tTimedDouble\t1700000000.000000005\t{"tm": 1700000000000000000, "data": 1.5}\n'
MIB = 2**20


@pytest.mark.slow(kept_by="test_bad_lines_are_told_in_a_bounded_number_of_places")
@pytest.mark.parametrize("filling", [b"\n", b"#\n"])
def test_lines_without_samples_between_samples_are_not_held(filling: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_bytes(LINE + filling * MIB + LINE)
    with open_recording(path) as reader:
        tracemalloc.start()
        try:
            assert sum(1 for _ in reader.samples()) == 2
            assert tracemalloc.get_traced_memory()[1] < 4 * MIB
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(("lines", "places"), [(LINE + b"x\n" * 30_000, 10_000), ((LINE + b"x\n") * 12_000, 10_000)])
def test_bad_lines_are_told_in_a_bounded_number_of_places(lines: bytes, places: int, tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_bytes(lines + LINE)
    with open_recording(tmp_path / "run.txt") as reader:
        assert len(reader.damage) == places
        assert reader.damage[-1].offset + reader.damage[-1].length == len(lines) - 1
        with pytest.raises(DamagedError, match="line 2"):
            list(reader.samples())


@pytest.mark.slow(kept_by="test_bad_lines_are_told_in_a_bounded_number_of_places")
def test_a_recording_in_lines_has_no_more_ports_than_any_other(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.write_bytes(b"".join(b"%d%s" % (number, LINE) for number in range(65_540)))
    with open_recording(path) as reader:
        assert reader.count == 65_535
        assert "at most 65535 ports" in reader.fault
