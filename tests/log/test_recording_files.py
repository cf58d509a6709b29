"""RecordingWriter: what a failed wait for the disk is worth, and files that are there when it wants to begin them."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest

from aiorts.types import Array, TimedLong, record, u8
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts_log.mcap.locked_file import LockedFile
from log_parts import BEGIN, read


class _FailsOnce(LockedFile):
    """The system tells once that it could not write; the next `fsync` is fine again, and means nothing."""

    left = 4

    def sync(self) -> None:
        self.left -= 1
        if self.left == 0:
            raise OSError(errno.EIO, "Input/output error")
        super().sync()


@pytest.mark.fault("D04")
def test_after_a_failed_wait_for_the_disk_no_later_one_claims_what_it_lost(tmp_path: Path) -> None:
    options = RecordingOptions(sync="record", min_free=0)
    writer = RecordingWriter(tmp_path / "run.mcap", options, kind=_FailsOnce)
    port = writer.add_port("a", TimedLong)
    for number in range(10):
        writer.write(port, TimedLong(0, number), BEGIN + number)
    found = writer.close()
    assert writer.failure is not None
    assert (found.stored, found.durable) == (3, 2)
    assert len(read(tmp_path / "run.mcap")) == 3


@record
class _Image:
    """Refuses pixels that are not as many as it says."""

    tm: int = 0
    size: int = 0
    pixels: Array[u8] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if len(self.pixels) != self.size:
            raise ValueError(f"{self.size} pixels expected")


def test_a_large_record_that_looks_at_its_fields_together_is_recorded(tmp_path: Path) -> None:
    sample = _Image(1, 100_000, np.arange(100_000, dtype=np.uint8))
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        writer.write(writer.add_port("a", _Image), sample, BEGIN)
    assert writer.failure is None
    assert [one for _, _, one in read(tmp_path / "run.mcap")] == [sample]
