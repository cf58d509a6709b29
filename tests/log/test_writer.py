"""A recorder that is killed, a disk that is full, a machine that loses its power: what was written stays readable."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts.types import TimedLong, TimedOctetSeq
from aiorts_log import RecordingError, RecordingOptions, RecordingReader, RecordingWriter, salvage
from aiorts_log.mcap.locked_file import LockedFile
from campaign import CAMPAIGN, cases, time_limit
from log_parts import BEGIN, make, read

RECORDER = """
import sys, time
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts.types import TimedLong
writer = RecordingWriter(sys.argv[1], RecordingOptions(min_free=0, sync=sys.argv[3]))
port = writer.add_port("n", TimedLong)
hz = int(sys.argv[2])
begin = time.monotonic_ns()
number = 0
print("begun", flush=True)
said = 0
while True:
    due = (time.monotonic_ns() - begin) * hz // 10**9
    while number < due:
        writer.write(port, TimedLong(time.monotonic_ns(), number), time.monotonic_ns())
        number += 1
    if sys.argv[3] == "record" and (done := writer.statistics.durable) != said:
        said = done
        print(said, flush=True)
    time.sleep(0.001)
"""


def killed(path: Path, seconds: float, hz: int, sync: str = "never") -> tuple[int, list[str]]:
    """Record in a process of its own and kill it; the time of that on the monotonic clock, and what it had said."""
    command = [sys.executable, "-c", RECORDER, str(path), str(hz), sync]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        time.sleep(seconds)
    finally:
        at = time.monotonic_ns()
        process.kill()
        said, _ = process.communicate(timeout=40)
    assert process.returncode == -signal.SIGKILL
    return at, said.split()


@pytest.mark.slow(kept_by="test_what_was_said_to_be_on_the_disk_is_there_after_a_kill")
@pytest.mark.fault("D01")
@pytest.mark.timeout(time_limit(900))
@pytest.mark.parametrize("hz", [10_000, 200])
def test_a_killed_recorder_leaves_an_exact_prefix_that_opens_as_it_is(tmp_path: Path, hz: int) -> None:
    """At 10 kHz a chunk is 64 KiB in 0.1 s; at 200 Hz only its age closes it."""
    chance = random.Random(hz)
    late = []
    for number in range(max(4, cases(50))):
        path = tmp_path / f"{number}.mcap"
        at, _ = killed(path, chance.uniform(0.25, 0.9), hz)
        with RecordingReader(path) as reader:
            assert not reader.clean
            assert reader.fault == ""
            found = [(log_time, record) for _, log_time, record in reader.records()]
            assert reader.count == len(found)
        assert [record.data for _, record in found] == list(range(len(found)))
        late.append((at - found[-1][0]) / 1e9)
    # What was written is at most 0.2 s old; the rest is what a busy machine made the process wait.
    assert sorted(late)[len(late) // 2] <= 0.2
    assert max(late) <= 2.0


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("D02")
def test_what_was_said_to_be_on_the_disk_is_there_after_a_kill(tmp_path: Path) -> None:
    for number in range(max(2, cases(20))):
        path = tmp_path / f"{number}.mcap"
        _, said = killed(path, 0.3, 500, "record")
        found = read(path)
        assert said
        assert len(found) >= int(said[-1]) > 0
        assert [record.data for _, _, record in found] == list(range(len(found)))


@pytest.mark.slow(kept_by="test_what_is_whole_of_a_torn_recording_becomes_a_whole_one")
@pytest.mark.fault("D02")
@pytest.mark.parametrize("tail", ["cut", "zeros", "noise"])
def test_power_lost_at_any_byte_of_the_tail_leaves_a_prefix(tmp_path: Path, tail: str) -> None:
    path, torn = tmp_path / "whole.mcap", tmp_path / "torn.mcap"
    count = 60 if CAMPAIGN else 600  # in a campaign each byte of it, else some bytes of its end
    make(path, count, chunk=2048 if count > 60 else 700)
    whole = path.read_bytes()
    with RecordingReader(path) as reader:
        expected = [sample[1:] for sample in reader.samples()]
        end = reader.pieces[-1].offset + reader.pieces[-1].length
        begin, pieces = reader.pieces[0].offset, reader.pieces
    chance = random.Random(7)
    lowest = max(begin, end - 65_536)
    offsets = range(lowest, end) if CAMPAIGN else sorted(chance.sample(range(lowest, end), 60))
    for offset in offsets:
        rest = {"cut": b"", "zeros": b"\0" * (end - offset), "noise": chance.randbytes(end - offset)}[tail]
        torn.write_bytes(whole[:offset] + rest)
        with RecordingReader(torn) as reader:
            assert not reader.clean
            found = [sample[1:] for sample in reader.samples()]
            raw = torn.read_bytes()
            same = [raw[p.offset : p.offset + p.length] == whole[p.offset : p.offset + p.length] for p in pieces]
            assert len(reader.pieces) == (same.index(False) if False in same else len(same))
            assert reader.damage == ()
        assert found == expected[: len(found)]
        assert len(found) >= 3 * count * (offset - begin) // (end - begin) * 0.9 - 60


class Failing(LockedFile):
    """A disk that takes so many bytes and no more."""

    left = 20_000

    def put(self, parts: list[memoryview]) -> int:
        if self.left <= 0:
            raise OSError(5, os.strerror(5))
        taken = super().put([parts[0][: self.left]])
        self.left -= taken
        return taken


def fill(writer: RecordingWriter, count: int = 3000) -> list[TimedLong]:
    port = writer.add_port("n", TimedLong)
    records = [TimedLong(BEGIN + i, i) for i in range(count)]
    for i, record in enumerate(records):
        writer.write(port, record, BEGIN + i)
    return records


@pytest.mark.fault("D03")
@pytest.mark.fault("D04")
def test_a_disk_that_fails_ends_the_recording_and_leaves_it_valid(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, RecordingOptions(min_free=0, chunk=4096), kind=Failing)
    records = fill(writer)
    found = writer.close()
    assert isinstance(writer.failure, RecordingError)
    assert "Input/output error" in str(writer.failure)
    assert found.waiting == 0
    assert found.stored + sum(found.dropped.values()) == found.offered == 3000
    assert 0 < found.stored < 3000
    assert [record for _, _, record in read(path)] == records[: found.stored]
    assert path.stat().st_size <= 20_000


FULL = """
import resource, signal, sys
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts.types import TimedLong
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
writer = RecordingWriter(sys.argv[1], RecordingOptions(min_free=0, chunk=4096))
port = writer.add_port("n", TimedLong)
for i in range(3000):
    writer.write(port, TimedLong(i, i), i)
found = writer.close()
print(found.stored, writer.failure)
"""


@pytest.mark.slow(kept_by="test_a_disk_that_fails_ends_the_recording_and_leaves_it_valid")
@pytest.mark.fault("D03")
def test_a_file_that_may_not_grow_ends_the_recording_wherever_that_happens(tmp_path: Path) -> None:
    for limit in (1, 500, 30_000, 33_333, *((range(40_000, 48_200, 100)) if CAMPAIGN else ())):
        path = tmp_path / f"{limit}.mcap"
        done = subprocess.run(
            # -B: bytecode that may not grow would be half a file, which the next one reads.
            [sys.executable, "-B", "-c", FULL, str(path), str(limit)],
            capture_output=True,
            text=True,
            check=False,
            timeout=100,
        )
        if limit < 100:
            assert "cannot be written" in done.stderr
            continue
        stored, _, why = done.stdout.partition(" ")
        assert "File too large" in why
        assert [record.data for _, _, record in read(path)] == list(range(int(stored)))
        with RecordingReader(path) as reader:
            assert reader.fault == ""


@pytest.mark.fault("D03")
def test_space_that_is_to_stay_free_stays_free(tmp_path: Path) -> None:
    free = os.statvfs(tmp_path)
    path = tmp_path / "run.mcap"
    options = RecordingOptions(min_free=free.f_bavail * free.f_frsize + 2**33)
    with pytest.raises(RecordingError, match="are to stay so"):
        RecordingWriter(path, options)


class Sudden(LockedFile):
    """A disk on which others take the space."""

    def _check_room(self, size: int) -> None:
        if self._min_free and self.size > 9000:
            self._min_free = 2**60
        super()._check_room(size)


@pytest.mark.fault("D03")
def test_a_recording_ends_cleanly_before_the_disk_is_full(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, RecordingOptions(min_free=1, chunk=4096), kind=Sudden)
    records = fill(writer)
    stored = writer.close().stored
    assert "--min-free" in str(writer.failure)
    with RecordingReader(path) as reader:
        assert reader.clean  # there was room enough for its index
        assert "--min-free" in reader.endings[-1]["why"]
        assert [record for _, _, record in reader.records()] == records[:stored]


class Unsynced(LockedFile):
    """A disk that cannot promise anything."""

    def sync(self) -> None:
        if self.size > 9000:
            raise OSError(5, os.strerror(5))
        super().sync()


@pytest.mark.fault("D04")
def test_a_disk_that_cannot_promise_is_believed_no_more(tmp_path: Path) -> None:
    writer = RecordingWriter(
        tmp_path / "run.mcap", RecordingOptions(min_free=0, chunk=4096, sync="chunk"), kind=Unsynced
    )
    fill(writer)
    found = writer.close()
    assert writer.failure is not None
    assert found.durable < found.stored < 3000


class Slow(LockedFile):
    """A disk that takes half a second for each piece."""

    def put(self, parts: list[memoryview]) -> int:
        if self.size > 2000:
            time.sleep(0.5)
        return super().put(parts)


@pytest.mark.slow
@pytest.mark.fault("D05")
def test_a_slow_disk_holds_nobody_up_and_what_finds_no_room_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    options = RecordingOptions(min_free=0, queue=1000, queue_bytes=2**40, chunk=2**18)
    writer = RecordingWriter(path, options, kind=Slow)
    port = writer.add_port("n", TimedOctetSeq)
    record = TimedOctetSeq(BEGIN, b"x" * 1000)
    taken, longest = 0, 0.0
    for i in range(2500):
        began = time.perf_counter()
        taken += writer.write(port, record, BEGIN + i)
        longest = max(longest, time.perf_counter() - began)
    waiting = writer.statistics.waiting
    found = writer.close()
    assert longest < 0.25  # a write to this disk takes twice as long; generous, for a machine that is busy
    assert waiting <= 1000 + 2 * 260  # the queue, and what the thread has in its hands
    assert found.stored == taken
    assert found.dropped == {"n": 2500 - taken}
    assert taken < 2500
    with RecordingReader(path) as reader:
        assert reader.endings[-1]["dropped"] == {"n": 2500 - taken}
        assert reader.count == taken


@pytest.mark.slow
@pytest.mark.fault("D05")
def test_the_queue_is_bounded_in_bytes_as_well(tmp_path: Path) -> None:
    options = RecordingOptions(min_free=0, queue_bytes=100_000)
    writer = RecordingWriter(tmp_path / "run.mcap", options, kind=Slow)
    port = writer.add_port("n", TimedOctetSeq)
    record: Any = TimedOctetSeq(BEGIN, b"x" * 40_000)
    taken = [writer.write(port, record, BEGIN + i) for i in range(20)]
    assert writer.close().stored == sum(taken) <= 8


def test_what_is_whole_of_a_torn_recording_becomes_a_whole_one(tmp_path: Path) -> None:
    path, new = tmp_path / "run.mcap", tmp_path / "new.mcap"
    expected = make(path, 300, chunk=2048)
    with path.open("rb+") as file:
        file.truncate(path.stat().st_size * 2 // 3)
    report = salvage(path, new)
    found = read(new)
    assert found == read(path) == expected[: len(found)]
    assert sum(report.samples.values()) == len(found) > 400
    assert not report.closed
    assert report.attachments == ("metadata.json",)
    with RecordingReader(new) as reader:
        assert reader.clean
        assert reader.check() == ()
