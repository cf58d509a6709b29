"""A large recording: opened, told of and sought in at once, read in memory that does not grow with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from campaign import CAMPAIGN, time_limit

MEASURE = """
import resource, sys, time
from aiorts_log import RecordingReader, info_of
def rss():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmHWM"))
path, count = sys.argv[1], int(sys.argv[2])
before = rss()
clock = time.process_time
began = clock()
with RecordingReader(path) as reader:
    found = info_of(reader)
    print("info", clock() - began)
    assert found.count == count, found
    worst = 0.0
    for i in range(1, 20):
        began = clock()
        samples = reader.samples(start=reader.start + (reader.end - reader.start) * i // 20)
        first = next(samples)
        worst = max(worst, clock() - began)
        samples.close()
        assert abs(first.log_time - (reader.start + (reader.end - reader.start) * i // 20)) < 10**6
    print("seek", worst)
    total = sum(1 for sample in reader.samples())
    assert total == count
print("memory", (rss() - before) / 1024)
"""
RECORD = """
import sys, time
from aiorts_log import RecordingOptions, RecordingWriter
from aiorts.types import TimedDouble
path, count = sys.argv[1], int(sys.argv[2])
with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
    ports = [writer.add_port(f"port{i}", TimedDouble) for i in range(4)]
    for i in range(count):
        while not writer.write(ports[i % 4], TimedDouble(i, i), i * 100_000):
            time.sleep(0.01)
if len(sys.argv) > 3:
    with open(path, "rb+") as file:
        file.truncate(file.seek(0, 2) - 20)
"""


@pytest.mark.slow
@pytest.mark.fault("D13")
@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="the peak of memory is read from /proc")
@pytest.mark.timeout(time_limit(600))
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "not closed"])
def test_a_large_recording_is_opened_and_sought_at_once_in_little_memory(tmp_path: Path, closed: bool) -> None:
    count = (10_000_000 if closed else 1_000_000) if CAMPAIGN else 50_000
    path = tmp_path / "run.mcap"
    subprocess.run(
        [sys.executable, "-c", RECORD, str(path), str(count), *([] if closed else ["cut"])],
        check=True,
        timeout=time_limit(600) / 2,
    )
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, str(path), str(count)],
        capture_output=True,
        text=True,
        check=False,
        timeout=time_limit(600) / 2 - 10,
    )
    assert done.returncode == 0, done.stderr
    found = {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}
    assert found["memory"] <= 64.0
    assert found["seek"] <= 0.1
    # A recording that was not closed has no index: all of it is read, and checked.
    assert found["info"] <= (0.5 if closed else 2.0)
    print(found)
