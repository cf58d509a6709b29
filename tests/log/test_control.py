"""A recording that nobody waits for: how fast the thread hands on what waited, and tells why it has ended."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts.cli.console.report import shortened
from aiorts.types import TimedLong
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts_log.mcap.locked_file import LockedFile
from aiorts_log.recorder.control import BackgroundRecording, Notice
from log_parts import read

WAITING = 30_000
"""Samples that were written one by one before the file was there."""


class Full(LockedFile):
    """A disk with room for the first bytes of a file."""

    def put(self, parts: list[memoryview]) -> int:
        if self.size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().put(parts)


class Waiting:
    """A recording whose file is opened when `open` is set; meanwhile samples wait."""

    def __init__(self, path: Path, kind: type[LockedFile]) -> None:
        self.open = threading.Event()
        self.told: list[str] = []
        self.recording = BackgroundRecording(path, RecordingOptions(min_free=0), notify=self._note, make=self._make)
        self._kind = kind
        port = self.recording.add_port("counted", TimedLong, {})
        for number in range(WAITING):
            self.recording.write(port, (TimedLong(0, number),), number)

    def _make(self, path: Path, **how: Any) -> RecordingWriter:
        self.open.wait(30.0)
        return RecordingWriter(path, kind=self._kind, **how)

    def _note(self, notice: Notice) -> None:
        self.told.append(notice.kind)


def spin_until(condition: Callable[[], object], seconds: float) -> bool:
    """Compute until it is true, and never let the interpreter go of oneself; whether it became true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
    return False


@pytest.mark.fault("D03")
def test_that_the_disk_is_full_is_told_at_once_however_much_waits_and_whoever_computes(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path / "run.mcap", Full)
    waiting.open.set()
    in_time = spin_until(lambda: "closed" in waiting.told, 5.0)
    recording = waiting.recording
    recording.close()
    assert in_time
    assert waiting.told == ["open", "failed", "closed"]  # not that the disk is too slow
    assert "No space left on device" in str(recording.failure)
    found = recording.statistics
    assert (found.offered, found.stored, found.dropped) == (WAITING, 0, {"counted": WAITING})


@pytest.mark.slow
@pytest.mark.parametrize("ports", [1, 30])
def test_that_samples_are_dropped_is_told_whole_with_what_helps(ports: int, tmp_path: Path) -> None:
    told: list[Notice] = []
    full = threading.Event()

    def make(path: Path, options: RecordingOptions, **how: Any) -> RecordingWriter:
        full.wait(30.0)
        return RecordingWriter(path, options, **how)

    recording = BackgroundRecording(
        tmp_path / "run.mcap", RecordingOptions(min_free=0, queue=10), notify=told.append, make=make
    )
    numbers = [recording.add_port(f"a_rather_long_component_{i:02}.port", TimedLong, {}) for i in range(ports)]
    for number in numbers:
        recording.write(number, [TimedLong(0, 1)] * (7 if number else 17), 1)
    full.set()
    recording.close()
    assert recording.wait_closed(10.0)
    (text,) = [notice.text for notice in told if notice.kind == "dropped"]
    named = [f"7 of a_rather_long_component_{i:02}.port" for i in range(min(ports, 8))]
    more = " and of 22 more" if ports == 30 else ""
    helps = "the disk is too slow: record fewer ports, or use a faster disk"
    assert text == f"{tmp_path / 'run.mcap'}: samples are dropped, {', '.join(named)}{more} so far; {helps}"
    line = f"aiorts: warning: {text}"
    assert shortened(line) == line


@pytest.mark.slow(kept_by="test_that_the_disk_is_full_is_told_at_once_however_much_waits_and_whoever_computes")
def test_what_waited_one_by_one_is_handed_on_as_fast_as_in_batches_whoever_computes(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path / "run.mcap", LockedFile)
    waiting.open.set()
    waiting.recording.close()
    assert spin_until(lambda: waiting.recording.is_closed, 20.0)
    assert [record.data for _, _, record in read(tmp_path / "run.mcap")] == list(range(WAITING))
