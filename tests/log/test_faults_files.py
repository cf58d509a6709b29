"""Disks that are full at any write, little memory, types that are unknown: what a recorder and a reader do then."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from aiorts_log import RecordingReader
from campaign import cases, time_limit
from log_parts import make

TMPFS = """
import json, os, subprocess, sys
from pathlib import Path
from aiorts.types import TimedDoubleSeq
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter

folder, count = Path(sys.argv[1]), int(sys.argv[2])
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)], check=True)
found = []
for n in range(count):
    path, ballast = folder / "run.mcap", folder / "ballast"
    ballast.write_bytes(bytes(n * 900_000 // count))
    writer = RecordingWriter(path, RecordingOptions(min_free=0, chunk=4096 + 997 * (n % 40)))
    port = writer.add_port("port", TimedDoubleSeq)
    neighbour = 0
    for i in range(100_000):
        writer.write(port, TimedDoubleSeq(i, [float(i)] * 40), i)
        neighbour += 1
        if not i % 200:
            writer.flush()
        if writer.failure is not None:
            break
    statistics = writer.close()
    with RecordingReader(path) as reader:
        values = [(when, record.data[39]) for _, when, record in reader.records()]
        gaps = len(reader.check())
    found.append(
        {
            "failure": str(writer.failure),
            "stored": statistics.stored,
            "dropped": sum(statistics.dropped.values()),
            "offered": statistics.offered,
            "is prefix": values == [(i, float(i)) for i in range(len(values))],
            "read": len(values),
            "gaps": gaps,
            "neighbour": neighbour,
        }
    )
    path.unlink()
    ballast.unlink()
print(json.dumps(found))
"""


def may_mount() -> bool:
    """Whether a file system of its own can be had here."""
    if not shutil.which("unshare"):
        return False
    command = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs -o size=1m tmpfs /mnt"]
    return subprocess.run(command, capture_output=True, check=False, timeout=100).returncode == 0


@pytest.mark.slow(kept_by="log/test_text_form.py::test_a_full_disk_ends_it_and_what_is_there_is_whole")
@pytest.mark.fault("D03")
@pytest.mark.timeout(time_limit(600))
def test_a_disk_of_1_mib_that_is_full_at_any_write_leaves_an_exact_prefix(tmp_path: Path) -> None:
    """A real file system; what fills it besides makes another write the one that fails, each time."""
    if not may_mount():
        pytest.skip("nobody may mount a tmpfs here, not in a namespace of its own either")
    folder = tmp_path / "disk"
    folder.mkdir()
    count = cases(300)
    done = subprocess.run(
        ["unshare", "-rm", sys.executable, "-c", TMPFS, str(folder), str(count)],
        capture_output=True,
        text=True,
        check=False,
        timeout=30 if count < 300 else 590,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found) == count
    for one in found:
        assert "No space left on device" in one["failure"]
        assert one["is prefix"]
        assert one["read"] == one["stored"]
        assert one["stored"] + one["dropped"] == one["offered"]
        assert one["gaps"] == 0
        assert done.stderr == ""
    assert len({one["stored"] for one in found}) > count // 2


SMALL_SPACE = """
import json, resource, sys
import aiorts.types, aiorts_log.foreign.importing
from aiorts.errors import AiortsError
from aiorts_log import RecordingReader, info_of
import lz4.frame, zstandard
def pages():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()
more = int(sys.argv[1])
for path in sys.argv[2:]:
    resource.setrlimit(resource.RLIMIT_AS, (pages() + more, resource.getrlimit(resource.RLIMIT_AS)[1]))
    try:
        with RecordingReader(path) as reader:
            info_of(reader)
            count = sum(1 for _ in reader.samples())
        told = f"{count} samples"
    except (AiortsError, MemoryError) as error:
        told = type(error).__name__
    resource.setrlimit(resource.RLIMIT_AS, (resource.getrlimit(resource.RLIMIT_AS)[1],) * 2)
    print(told)
"""


@pytest.mark.slow(kept_by="log/test_faults_review.py::test_a_sample_for_which_there_is_no_memory_is_refused_alone")
@pytest.mark.fault("G02")
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="the address space is read from /proc")
def test_a_reader_with_little_memory_refuses_and_lives(tmp_path: Path) -> None:
    """Large chunks do not fit; the same process then reads a small recording, with the same little room."""
    from aiorts.types import TimedOctetSeq
    from aiorts_log import RecordingOptions, RecordingWriter

    large, small = tmp_path / "large.mcap", tmp_path / "small.mcap"
    with RecordingWriter(large, RecordingOptions(min_free=0, chunk=60 * 2**20, age=3600.0)) as writer:
        port = writer.add_port("port", TimedOctetSeq)
        for i in range(50):
            writer.write(port, TimedOctetSeq(i, bytes(2**20)), i)
    make(small, 100)
    order = [str(one) for _ in range(10) for one in (large, small)]
    done = subprocess.run(
        [sys.executable, "-c", SMALL_SPACE, str(24 * 2**20), *order],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[1::2] == ["300 samples"] * 10
    assert set(lines[::2]) <= {"RecordingError", "DamagedError", "MemoryError"}
    assert len(lines) == 20


UNKNOWN = """
import sys
from pathlib import Path
from aiorts.cli.app import run_command
from aiorts.types.registry import wire_type
from aiorts_log import RecordingReader, salvage
assert wire_type("nobody.Knows") is None  # from here on it is loaded what looks for types that plugins declare
path = sys.argv[1]
with RecordingReader(path) as reader:
    before = set(sys.modules)
    for sample in reader.samples():
        assert sample.port.unknown.startswith("no type 'this."), sample.port.unknown
        assert sample.port.plain(sample.data) == {"value": 1.5}, sample.port.plain(sample.data)
        try:
            sample.record
        except Exception as error:
            assert type(error).__name__ == "RecordingError", error
    assert not reader.check()
new = {name for name in set(sys.modules) - before if not name.startswith("aiorts")}
assert not new & {"this", "antigravity", "this.s"}, new
print(sorted(new))
"""


@pytest.mark.slow(kept_by="log/test_text_form.py::test_a_type_that_is_not_known_here_is_told_as_plain_data")
@pytest.mark.fault("D12")
def test_a_type_that_nobody_here_knows_can_be_read_as_plain_data_and_imports_nothing(tmp_path: Path) -> None:
    """The file names a module that is there and prints when it is imported."""
    path = tmp_path / "run.mcap"
    source = tmp_path / "write.py"
    source.write_text(
        "import sys, types\n"
        "from aiorts.types import record\n"
        "from aiorts_log import RecordingOptions, RecordingWriter\n"
        "class Thing:\n    value: float = 0.0\n"
        "Thing.__module__ = 'this.s'\n"
        "sys.modules['this.s'] = types.ModuleType('this.s')\n"
        "Thing = record(Thing)\n"
        f"with RecordingWriter({str(path)!r}, RecordingOptions(min_free=0)) as writer:\n"
        "    port = writer.add_port('port', Thing)\n"
        "    for i in range(10):\n        writer.write(port, Thing(1.5), i)\n"
    )
    subprocess.run([sys.executable, str(source)], check=True, timeout=100)
    done = subprocess.run(
        [sys.executable, "-c", UNKNOWN, str(path)], capture_output=True, text=True, check=False, timeout=100
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "[]\n"  # not even the Zen of Python


@pytest.mark.fault("D10")
def test_the_golden_files_are_read_to_the_last_byte() -> None:
    folder = Path(__file__).parent / "golden"
    for path in sorted(folder.glob("*.mcap")):
        with RecordingReader(path) as reader:
            assert (reader.count, reader.clean, reader.fault) == (10, True, "")
            assert len(list(reader.records())) == 10
            assert not reader.check()
