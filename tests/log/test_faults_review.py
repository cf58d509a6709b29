"""What once ended a recording, or took memory or time without end: odd samples and numbers, bombs of many parts."""

from __future__ import annotations

import time
import tracemalloc
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aiorts.types import TimedDouble, TimedDoubleSeq, TimedLong, TimedString, all_types
from aiorts.wire import MsgpackCodec
from aiorts_log import Limits, RecordingError, RecordingOptions, RecordingReader, RecordingWriter, salvage
from aiorts_log.mcap.chunks import contents, tally
from aiorts_log.mcap.encodings import schema_of, splitter
from aiorts_log.mcap.format import HEADER, MAGIC, MESSAGE, MESSAGE_HEAD, Channel, ChunkHead, Schema, record
from aiorts_log.mcap.locked_file import LockedFile
from aiorts_log.mcap.outfile import OutFile
from log_parts import make, read

MIB = 2**20


@dataclass(frozen=True)
class Loose:
    """Holds whatever it is given."""

    tm: int
    x: float


def write(path: Path, cls: type, records: list[Any], **options: Any) -> RecordingWriter:
    with RecordingWriter(path, RecordingOptions(min_free=0, **options)) as writer:
        port = writer.add_port("port", cls)
        for number, one in enumerate(records):
            writer.write(port, one, number)
    return writer


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
@pytest.mark.parametrize(
    ("cls", "good", "bad"),
    [(str, "a", "\ud800"), (Loose, Loose(1, 1.5), Loose(-1, 1.5)), (Loose, Loose(1, 1.5), Loose(2**64, 1.5))],
    ids=["half a character", "a time before all", "a time after all"],
)
def test_a_sample_that_cannot_be_written_is_refused_alone(
    tmp_path: Path, encoding: Any, cls: type, good: Any, bad: Any
) -> None:
    writer = write(tmp_path / "run.mcap", cls, [good, bad, good], encoding=encoding)
    assert writer.failure is None
    assert (writer.statistics.stored, writer.statistics.refused) == (2, {"port": 1})
    assert [one for _, _, one in read(tmp_path / "run.mcap")] == [good, good]


@pytest.mark.fault("G02")
def test_a_sample_for_which_there_is_no_memory_is_refused_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The packer of the codec says so where the system would."""
    genuine = MsgpackCodec.encoder

    def encoder(self: MsgpackCodec, cls: type) -> Any:
        encode = genuine(self, cls)

        def scarce(record: Any) -> bytes:
            if record == 1.0:
                raise MemoryError
            return encode(record)

        return scarce

    monkeypatch.setattr(MsgpackCodec, "encoder", encoder)
    writer = write(tmp_path / "run.mcap", float, [0.0, 1.0, 2.0])
    assert writer.failure is None
    assert (writer.statistics.stored, writer.statistics.refused) == (2, {"port": 1})
    assert [one for _, _, one in read(tmp_path / "run.mcap")] == [0.0, 2.0]


class Broken(LockedFile):
    """Takes nothing any more as soon as a sample comes."""

    def put(self, parts: list[memoryview]) -> int:
        if self.size > 1000:
            raise OSError(5, "Input/output error")
        return super().put(parts)


@pytest.mark.fault("D04")
def test_who_waits_for_the_file_is_told_when_it_fails(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0, chunk=4096), kind=Broken)
    port = writer.add_port("port", TimedDouble)
    waited: list[bool] = []
    began = time.monotonic()
    for turn in range(20):
        for number in range(200):
            writer.write(port, TimedDouble(0, 1.5), turn * 200 + number)
        waited.append(writer.flush(timeout=20.0))
        if writer.failure is not None:
            break
    assert waited[-1] is False
    assert time.monotonic() - began < 15.0  # it was told, and did not wait in vain
    assert "Input/output error" in str(writer.failure)
    writer.close()


def test_a_port_that_is_named_twice_is_one_port(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        first, second = writer.add_port("port", float), writer.add_port("port", float)
        for number in range(6):
            writer.write((first, second)[number % 2], float(number), number)
        with pytest.raises(RecordingError, match="port 'port': is recorded already, as float"):
            writer.add_port("port", str)
    assert (writer.statistics.stored, writer.statistics.dropped) == (6, {})
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert [sample.sequence for sample in reader.samples()] == list(range(6))


def test_a_recording_of_which_some_definitions_are_lost_can_be_continued(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    file = OutFile(path, "refuse", 0)
    file.take_definitions({2: schema_of(2, TimedDouble, "msgpack")}, {2: Channel(2, 2, "old", "msgpack", {})})
    file.finish()
    with RecordingWriter(path, RecordingOptions(min_free=0, existing="append")) as writer:
        writer.write(writer.add_port("new", TimedLong), TimedLong(1, 2), 5)
    assert writer.failure is None
    assert read(path) == [("new", 5, TimedLong(1, 2))]


def test_metadata_that_cannot_be_written_is_refused_before_anything_is_recorded(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="metadata: expected what JSON can carry"):
        RecordingWriter(tmp_path / "run.mcap", metadata={"a": {("no", "key"): 1}})
    assert not (tmp_path / "run.mcap").exists()


def chunk(records: bytes, start: int, end: int) -> bytes:
    zstandard = pytest.importorskip("zstandard")
    stored = zstandard.compress(records)
    return ChunkHead(start, end, len(records), zlib.crc32(records), "zstd", len(stored), 0).put() + stored


def foreign(path: Path, *parts: bytes) -> Path:
    path.write_bytes(MAGIC + record(HEADER, bytes(8)) + b"".join(parts))
    return path


DEFINED = Schema(1, "x", "jsonschema", b"{}").put() + Channel(1, 1, "port", "json", {}).put()


@pytest.mark.slow
@pytest.mark.fault("D08")
def test_compressed_chunks_that_overlap_are_counted_as_large_as_they_become(tmp_path: Path) -> None:
    data = bytes(2 * MIB)
    message = MESSAGE_HEAD.pack(MESSAGE, 22 + len(data), 1, 0, 0, 0) + data
    one = chunk(DEFINED + message + MESSAGE_HEAD.pack(MESSAGE, 22, 1, 1, 10, 0), 0, 10)
    path = foreign(tmp_path / "bomb.mcap", *[one] * 40)
    assert path.stat().st_size < 20_000
    tracemalloc.start()
    try:
        with RecordingReader(path, limits=Limits(overlap=8 * MIB, unpacked=None)) as reader:
            assert reader.count == 80
            with pytest.raises(RecordingError, match="overlap in time"):
                list(reader.samples())
        assert tracemalloc.get_traced_memory()[1] < 24 * MIB
    finally:
        tracemalloc.stop()


@pytest.mark.slow(kept_by="test_chunks_within_chunks_take_no_hours")
@pytest.mark.fault("D08")
@pytest.mark.parametrize("is_sorted", [True, False])
def test_a_chunk_of_very_many_messages_is_read_one_by_one(tmp_path: Path, is_sorted: bool) -> None:
    """As a list, they would take ten times the bytes that they have; equal times keep their order."""
    count = 60_000
    times = [i // 2 for i in range(count)] if is_sorted else [(i * 7919) % 1000 for i in range(count)]
    messages = b"".join(
        MESSAGE_HEAD.pack(MESSAGE, 72, 1, i, when, i) + i.to_bytes(50, "big") for i, when in enumerate(times)
    )
    path = foreign(tmp_path / "many.mcap", chunk(DEFINED + messages, 0, max(times)))
    with RecordingReader(path) as reader:
        assert reader.count == count
        found = [(s.log_time, s.sequence, s.publish_time, s.data) for s in reader.samples()]
    assert found == sorted((when, i, i, i.to_bytes(50, "big")) for i, when in enumerate(times))
    tracemalloc.start()
    try:
        assert len(contents(messages).messages) == count
        assert tracemalloc.get_traced_memory()[1] < len(messages)
    finally:
        tracemalloc.stop()


@pytest.mark.fault("D08")
def test_chunks_within_chunks_take_no_hours(tmp_path: Path) -> None:
    count = 30_000
    size = 9 + count * 49
    parts, at = [b"\x05" + (10**9).to_bytes(8, "little")], 9
    for _ in range(count):
        left = size - at - 49
        parts.append(ChunkHead(0, 1, left, 1, "", left, 0).put())
        at += 49
    path = foreign(tmp_path / "russian.mcap", *parts)
    began = time.process_time()
    with RecordingReader(path) as reader:
        assert (reader.count, reader.clean) == (0, False)
        assert reader.torn is not None
    assert time.process_time() - began < 3.0


@pytest.mark.fault("D06")
def test_numbers_with_holes_are_counted_within_a_chunk_and_over_the_end_of_32_bits() -> None:
    head = MESSAGE_HEAD.pack
    numbers = [(1, 2**32 - 2), (1, 2**32 - 1), (2, 7), (1, 0), (1, 5), (2, 8), (1, 4)]
    found = tally(b"".join(head(MESSAGE, 22, channel, number, 3, 0) for channel, number in numbers))
    assert found.counts == {1: [5, 2**32 - 2, 4 - 2], 2: [2, 7, 0]}
    assert (found.start, found.end) == (3, 3)


@pytest.mark.fault("D08")
@pytest.mark.parametrize("when", [4, 11])
def test_a_message_outside_the_time_of_its_chunk_is_damage_without_an_index_too(tmp_path: Path, when: int) -> None:
    messages = b"".join(MESSAGE_HEAD.pack(MESSAGE, 22, 1, 0, one, 0) for one in (5, when, 10))
    with RecordingReader(foreign(tmp_path / "run.mcap", chunk(DEFINED + messages, 5, 10))) as reader:
        assert (reader.count, reader.clean) == (0, False)
        assert reader.torn is not None
        assert "outside the time" in reader.torn.why


@pytest.mark.slow
@pytest.mark.fault("D06")
def test_many_damaged_chunks_are_all_passed(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make(path, 3000, chunk=4096)
    with RecordingReader(path) as reader:
        pieces = reader.pieces
    raw = bytearray(path.read_bytes())
    for piece in pieces[1::2]:
        raw[piece.offset + 9 + 40 + 5] ^= 1
    path.write_bytes(raw)
    report = salvage(path, tmp_path / "whole.mcap")
    assert len(report.lost) == len(pieces[1::2])
    assert sum(report.samples.values()) + sum(report.missing.values()) == 9000
    names = {"pid0.command", "arm.joints", "log"}
    assert set(report.samples) == names
    assert all(isinstance(one, TimedString) for _, _, one in read(tmp_path / "whole.mcap", ports=["log"]))


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("count", [8_191, 8_192, 100_000, 1_000_000])
def test_a_large_array_lies_in_the_file_as_the_codec_writes_it(tmp_path: Path, count: int) -> None:
    """It goes there in two parts; nobody can tell."""
    samples = [TimedDoubleSeq(i, np.arange(count) * 0.5 + i) for i in range(2)]
    write(tmp_path / "run.mcap", TimedDoubleSeq, samples)
    with RecordingReader(tmp_path / "run.mcap") as reader:
        assert [one.data for one in reader.samples()] == [MsgpackCodec().encode(one) for one in samples]
        assert not reader.check()
    assert [one for _, _, one in read(tmp_path / "run.mcap")] == samples


@pytest.mark.parametrize("cls", [c for c in all_types().values() if c.__name__.endswith("Seq")])
def test_every_sequence_is_split_as_the_codec_writes_it_or_not_at_all(cls: Any) -> None:
    split = splitter("msgpack", cls)
    assert (split is None) is (cls.__name__ in ("TimedStringSeq", "TimedWStringSeq", "TimedCharSeq", "TimedWCharSeq"))
    if split is not None:
        one = cls(7, np.ones(70_000, bool) if "Boolean" in cls.__name__ else np.arange(70_000) % 100)
        assert b"".join(split(one)) == MsgpackCodec().encode(one)
        assert all(split(one))
