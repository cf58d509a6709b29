"""What a whole recording may cost: a small file that holds very much is refused at once, every honest one is read."""

from __future__ import annotations

import random
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from aiorts.types import TimedLong
from aiorts_log import Limits, RecordingError, RecordingOptions, RecordingReader, RecordingWriter, salvage
from aiorts_log.commands.command import log
from aiorts_log.mcap.format import HEADER, MAGIC, MESSAGE, MESSAGE_HEAD, Channel, ChunkHead, ChunkPlace, Schema, record
from aiorts_log.mcap.summary import Summary
from log_parts import read

MIB = 2**20
SCHEMA, CHANNEL = Schema(1, "x", "jsonschema", b"{}"), Channel(1, 1, "port", "json", {})
EMPTY = MESSAGE_HEAD.pack(MESSAGE, 22, 1, 0, 0, 0)
MANY = 1_800_000
"""Empty messages that zstd packs into a few kB."""
COST = """
import sys, time
from click.testing import CliRunner
import aiorts_log.analysis.convert, aiorts_log.foreign.importing, aiorts_log.analysis.series, zstandard
from aiorts_log.commands.command import log

def peak():
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmHWM:"))

before, began = peak(), time.monotonic()
result = CliRunner().invoke(log, sys.argv[1:])
print(time.monotonic() - began, (peak() - before) // 1024, type(result.exception).__name__, result.exception)
"""


def packed(path: Path, *chunks: list[bytes], times: tuple[int, int] = (0, 9), closed: bool = True, **lie: Any) -> Path:
    """A recording whose chunks, of these messages, zstd compressed; `lie` is what its index says of the first."""
    zstandard = pytest.importorskip("zstandard")
    raw, summary = MAGIC + record(HEADER, bytes(8)), Summary()
    summary.define(SCHEMA, CHANNEL)
    for messages in chunks:
        whole = SCHEMA.put() + CHANNEL.put() + b"".join(messages)
        stored = zstandard.compress(whole)
        chunk = ChunkHead(*times, len(whole), zlib.crc32(whole), "zstd", len(stored), 0).put() + stored
        summary.chunks.append(ChunkPlace(*times, len(raw), len(chunk), {1: 0}, 0, "zstd", len(stored), len(whole)))
        raw += chunk
    summary.counts[1] = lie.pop("messages", sum(map(len, chunks)))
    summary.chunks[0] = summary.chunks[0]._replace(**lie)
    path.write_bytes(raw + (b"".join(summary.put(len(raw))) if closed else b""))
    return path


def cost(*arguments: object) -> tuple[float, int, str]:
    """Seconds and MiB that a command of `aiorts log` costs, and what it was refused with."""
    done = subprocess.run(
        [sys.executable, "-c", COST, *map(str, arguments)], capture_output=True, text=True, check=True, timeout=100
    )
    seconds, most, said = done.stdout.split(" ", 2)
    return float(seconds), int(most), said


@pytest.mark.slow
@pytest.mark.fault("D08")
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is read from /proc")
@pytest.mark.parametrize("command", ["cat", "info --check", "convert", "salvage"])
@pytest.mark.parametrize("form", ["closed", "not closed", "an index that lies"])
def test_a_small_file_of_very_many_messages_is_refused_at_once(tmp_path: Path, command: str, form: str) -> None:
    lie = {"messages": 3, "uncompressed": 500} if form == "an index that lies" else {}
    path = packed(tmp_path / "bomb.mcap", [EMPTY] * MANY, closed=form != "not closed", **lie)
    assert path.stat().st_size < 20_000
    target = [tmp_path / "new.mcap"] if command in ("convert", "salvage") else []
    seconds, most, said = cost(*command.split(), path, *target)
    assert said.startswith(("RecordingError", "DamagedError"))
    assert form == "an index that lies" or "--unlimited" in said
    assert most <= 64
    assert seconds < 5.0  # 2 s on a machine that does nothing else
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.fault("D08")
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("what", ["messages", "bytes unpacked"])
def test_what_is_in_many_chunks_counts_together(tmp_path: Path, what: str, closed: bool) -> None:
    large = MESSAGE_HEAD.pack(MESSAGE, 22 + 3 * MIB, 1, 0, 0, 0) + bytes(3 * MIB)
    chunks = [[EMPTY] * 30_000] * 5 if what == "messages" else [[large]] * 8
    path = packed(tmp_path / "run.mcap", *chunks, closed=closed)
    with pytest.raises(RecordingError, match=rf"hold \d+ {what}; \d+ are read of such a file; --unlimited"):
        RecordingReader(path)
    with RecordingReader(path, limits=Limits.unlimited()) as reader:
        assert sum(1 for _ in reader.samples(order="file")) == reader.count == sum(map(len, chunks))


@pytest.mark.slow
@pytest.mark.fault("D08")
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is read from /proc")
@pytest.mark.parametrize("defined", ["schemas", "channels", "metadata"])
def test_a_small_file_of_very_many_definitions_is_found_out_at_once(tmp_path: Path, defined: str) -> None:
    many = {str(number): "" for number in range(100_000)}
    one = {"schemas": SCHEMA.put(), "channels": CHANNEL.put(), "metadata": Channel(1, 1, "n", "", many).put()}[defined]
    path = packed(tmp_path / "run.mcap", [one] * (12 * MIB // len(one)), closed=False)
    seconds, most, _ = cost("info", path)
    assert most <= 64
    assert seconds < 10.0


@pytest.mark.slow
@pytest.mark.fault("D08")
def test_chunks_of_nothing_count(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + record(HEADER, bytes(8)) + ChunkHead(0, 0, 0, 0, "", 0, 0).put() * 45_000)
    with pytest.raises(RecordingError, match=r"hold \d+ chunks; \d+ are read"):
        RecordingReader(path)
    with RecordingReader(path, limits=Limits.unlimited()) as reader:
        assert len(reader.pieces) == 45_000


@pytest.mark.slow
@pytest.mark.fault("D08")
def test_unlimited_reads_it_and_what_it_writes_needs_no_leave(tmp_path: Path) -> None:
    path = packed(tmp_path / "much.mcap", [EMPTY] * 150_000)
    run = CliRunner().invoke
    assert isinstance(run(log, ["info", str(path)]).exception, RecordingError)
    assert "150000 samples" in run(log, ["info", str(path), "--unlimited", "--check"]).output
    for command in ("convert", "cut", "salvage"):
        new = tmp_path / f"{command}.mcap"
        result = run(log, [command, str(path), str(new), "--unlimited"])
        assert result.exit_code == 0, result.output
        assert "150000 samples" in run(log, ["info", str(new)]).output
    merged = run(log, ["merge", str(path), str(path), str(tmp_path / "merged.mcap"), "--join", "--unlimited"])
    assert merged.exit_code == 0
    assert run(log, ["diff", str(path), str(tmp_path / "cut.mcap"), "--unlimited", "--by", "order"]).exit_code == 0


@pytest.mark.slow(kept_by="log/test_foreign.py::test_recordings_of_the_mcap_library_are_read")
@pytest.mark.fault("D08")
def test_an_honest_recording_is_within_the_budgets_however_it_was_written(tmp_path: Path) -> None:
    count, path = 12_000, tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0, chunk=1, queue=count)) as writer:  # a chunk for each
        port = writer.add_port("n", TimedLong)
        for number in range(count):
            writer.write(port, TimedLong(number, number), number)
    with RecordingReader(path) as reader:
        assert len(reader.pieces) == count
    assert len(read(path)) == count
    salvage(path, tmp_path / "new.mcap")

    chance, time, parts = random.Random(5), 1_700_000_000_000_000_000, []
    for number in range(150_000):  # a kHz with some jitter, and a number of 8 bytes
        time += 1_000_000 + chance.randrange(20_000)
        parts.append(MESSAGE_HEAD.pack(MESSAGE, 30, 1, number, time, time) + chance.randbytes(8))
    first, last = 1_700_000_000_000_000_000, time
    with RecordingReader(packed(tmp_path / "packed.mcap", parts, times=(first, last))) as reader:
        assert sum(1 for _ in reader.samples()) == len(parts)
