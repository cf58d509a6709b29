"""Recordings made here are MCAP for everybody; those that others made are read here."""

from __future__ import annotations

import io
import json
import random
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from aiorts.types import (
    MultiCameraImages,
    Point3D,
    TimedDouble,
    TimedDoubleSeq,
    TimedPoint3D,
    TimedString,
    all_types,
    to_plain,
)
from aiorts_log import RecordingError, RecordingOptions, RecordingReader, RecordingWriter, salvage
from log_parts import MS, make, read

mcap_reader = pytest.importorskip("mcap.reader")
mcap_exceptions = pytest.importorskip("mcap.exceptions")
mcap_writer = pytest.importorskip("mcap.writer")


@pytest.mark.parametrize("closed", [True, False])
def test_the_reader_of_the_mcap_library_reads_ours_and_finds_every_sum_right(tmp_path: Path, closed: bool) -> None:
    path = tmp_path / "run.mcap"
    make(path, 500, chunk=4096)
    with RecordingReader(path) as reader:
        expected = [(s.port.name, s.log_time, s.publish_time, s.sequence, s.data) for s in reader.samples()]
        last = reader.pieces[-1]
    raw = path.read_bytes() if closed else path.read_bytes()[: last.offset + last.length]
    if closed:
        seeking = mcap_reader.SeekingReader(io.BytesIO(raw), validate_crcs=True)
        summary = seeking.get_summary()
        assert summary.statistics.message_count == 1500
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        assert {channel.topic for channel in summary.channels.values()} == {"pid0.command", "arm.joints", "log"}
        assert [one.name for one in seeking.iter_attachments()] == ["metadata.json", "end.json"]
        some = list(seeking.iter_messages(topics=["log"]))
        assert [message.data for _, _, message in some] == [e[4] for e in expected if e[0] == "log"]
    else:
        seeking = mcap_reader.NonSeekingReader(io.BytesIO(raw), validate_crcs=True)
    found = []
    with_order = {} if closed else {"log_time_order": False}
    try:
        for schema, channel, message in seeking.iter_messages(**with_order):
            assert schema.encoding == "jsonschema"
            assert channel.message_encoding == "msgpack"
            found.append((channel.topic, message.log_time, message.publish_time, message.sequence, message.data))
    except mcap_exceptions.EndOfFile:
        assert not closed
    assert found == expected


READER = '''
"""Reads a recording with the mcap library and what the recording itself says: nothing of aiorts is here."""
import json, math, struct, sys
class Nothing:
    def find_spec(self, name, *rest):
        if name.split(".")[0] in ("aiorts", "aiorts_log"):
            raise ImportError(name)
sys.meta_path.insert(0, Nothing())
import msgpack
from mcap.reader import make_reader
CODES = {"bool": "?", "i8": "b", "i16": "h", "i32": "i", "i64": "q", "u8": "B", "u16": "H", "u32": "I", "u64": "Q",
         "f16": "e", "f32": "f", "f64": "d"}
def explain(value, schema, layout):
    if isinstance(value, bytes):
        if "x-array" not in schema:
            return value.hex()
        assert schema["contentEncoding"] == "binary"
        shape = struct.unpack_from(f"<{value[1]}Q", value, 8)
        element = layout["codes"][str(value[0])]
        assert schema["x-array"]["element"] in (None, element)
        assert schema["x-array"].get("dimensions", len(shape)) == len(shape)
        return [element, shape, struct.unpack_from(f"<{math.prod(shape)}{CODES[element]}", value, 8 + 8 * len(shape))]
    if schema["type"] == "object":
        assert list(value) == schema["required"]
        return {key: explain(value[key], inner, layout) for key, inner in schema["properties"].items()}
    if schema["type"] == "array":
        kinds = schema.get("prefixItems") or [schema["items"]] * len(value)
        return [explain(item, kind, layout) for item, kind in zip(value, kinds, strict=True)]
    return value
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
        document = json.loads(schema.data)
        version, name, fields = msgpack.unpackb(message.data)
        head = document["prefixItems"]
        assert [version, name] == [head[0]["const"], head[1]["const"]] and name == schema.name == document["title"]
        print(json.dumps([channel.topic, name, explain(fields, head[2], document["x-array-layout"])]))
try:
    import aiorts
    print("aiorts is here")
except ImportError:
    pass
'''


@pytest.mark.slow
def test_any_reader_understands_the_samples_without_our_code(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    point, images = TimedPoint3D(5, Point3D(1.0, 2.0, 3.0)), MultiCameraImages()
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        for name, value in {
            "number": TimedDouble(7, 1.5),
            "array": TimedDoubleSeq(7, [1.0, 2.0]),
            "text": TimedString(7, "ä"),
            "point": point,
            "images": images,
            "plain": 2.5,
            "bytes": b"\1\2",
        }.items():
            writer.write(writer.add_port(name, type(value)), value, 1)
    done = subprocess.run(
        [sys.executable, "-c", READER, str(path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert done.stderr == ""
    found = {topic: (name, value) for topic, name, value in map(json.loads, done.stdout.splitlines())}
    assert found["number"] == ("TimedDouble", {"tm": 7, "data": 1.5})
    assert found["array"] == ("TimedDoubleSeq", {"tm": 7, "data": ["f64", [2], [1.0, 2.0]]})
    assert found["text"] == ("TimedString", {"tm": 7, "data": "ä"})
    assert found["point"] == ("TimedPoint3D", {"tm": 5, "data": {"x": 1.0, "y": 2.0, "z": 3.0}})
    assert found["plain"] == ("float", 2.5)
    assert found["bytes"] == ("bytes", "0102")
    assert found["images"][0] == "MultiCameraImages"


@pytest.mark.slow(kept_by="test_the_reader_of_the_mcap_library_reads_ours_and_finds_every_sum_right")
def test_every_type_has_a_schema_that_its_samples_keep(tmp_path: Path) -> None:
    """In JSON with the names that Foxglove documents; the schema is a valid one, and an object at its root."""
    path = tmp_path / "run.mcap"
    types = [c for c in all_types().values() if c.__module__.startswith("aiorts.types") and is_dataclass(c)]
    samples = [cls() for cls in types]
    with RecordingWriter(path, RecordingOptions(min_free=0, encoding="json")) as writer:
        for i, sample in enumerate((*samples, 1.5, "text", b"\1")):
            writer.write(writer.add_port(f"port{i}", type(sample)), sample, i)
    assert writer.statistics.refused == {}
    with path.open("rb") as file:
        found = list(mcap_reader.make_reader(file, validate_crcs=True).iter_messages())
    assert len(found) == len(samples) + 3 > 120
    for (schema, channel, message), sample in zip(found, samples, strict=False):
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        document, value = json.loads(schema.data), json.loads(message.data)
        assert document["type"] == "object"
        jsonschema.Draft202012Validator.check_schema(document)
        jsonschema.validate(value, document)
        assert value == to_plain(sample)
    assert json.loads(found[-3][2].data) == {"value": 1.5}


def foreign(path: Path, count: int = 300, **options: Any) -> list[tuple[str, int, bytes]]:
    """A recording by the mcap library, two channels, not in order; its messages by log time."""
    chance = random.Random(3)
    messages = []
    with path.open("wb") as file:
        writer = mcap_writer.Writer(file, chunk_size=1000, **options)
        writer.start(profile="ros2", library="somebody")
        schema = writer.register_schema("Thing", "jsonschema", b'{"type": "object"}')
        channels = {
            "/a": writer.register_channel("/a", "json", schema),
            "/b": writer.register_channel("/b", "cdr", 0),
        }
        for i in range(count):
            topic, time = chance.choice(list(channels.items())), i * MS + chance.randrange(3 * MS)
            data = json.dumps({"n": i}).encode()
            writer.add_message(topic[1], time, data, time + 1, i)
            messages.append((topic[0], time, data))
        writer.add_metadata("m", {"k": "v"})
        writer.add_attachment(1, 2, "file.txt", "text/plain", b"hello")
        writer.finish()
    return sorted(messages, key=lambda message: message[1])


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("more", [{}, {"use_chunking": False}, {"use_statistics": False}, {"enable_data_crcs": True}])
def test_recordings_of_the_mcap_library_are_read(tmp_path: Path, compression: str, more: dict[str, Any]) -> None:
    path = tmp_path / "run.mcap"
    expected = foreign(path, compression=getattr(mcap_writer.CompressionType, compression), **more)
    with RecordingReader(path) as reader:
        assert reader.clean
        assert reader.fault == ""
        found = list(reader.samples())
        assert [(s.port.name, s.log_time, s.data) for s in found] == expected
        assert {port.name: port.unknown for port in reader.ports.values()} == {
            "/a": "no type 'Thing' is known here; import the module that defines it "
            "(--type-mod), or install its plugin",
            "/b": "its messages are cdr, which are not read here",
        }
        assert found[0].port.plain(b'{"n": 1}') == (
            {"n": 1} if found[0].port.name == "/a" else {"encoding": "cdr", "bytes": "eyJuIjogMX0="}
        )
        assert [(one.name, one.data) for one in reader.attachments()] == [("file.txt", b"hello")]
        assert reader.metadata == ()
        assert reader.check() == ()
        assert (reader.start, reader.count) == (expected[0][1], 300)
    new = tmp_path / "new.mcap"
    report = salvage(path, new)
    assert (report.lost, report.missing, report.closed) == ((), {}, True)
    with RecordingReader(new) as reader:
        assert [(s.port.name, s.log_time, s.data) for s in reader.samples()] == expected
    with pytest.raises(RecordingError, match="not made by aiorts and cannot be continued"):
        RecordingWriter(path, RecordingOptions(existing="append"))


def test_a_recording_of_others_that_is_cut_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    expected = foreign(path, compression=mcap_writer.CompressionType.ZSTD)
    whole = path.read_bytes()
    for length in range(200, len(whole), 997):
        path.write_bytes(whole[:length])
        with RecordingReader(path) as reader:
            found = {(s.port.name, s.log_time, s.data) for s in reader.samples()}
        assert found <= set(expected)


def test_large_samples_are_not_copied_into_one(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    array = np.arange(200_000, dtype=np.float64)
    with RecordingWriter(path, RecordingOptions(min_free=0, queue_bytes=2**30)) as writer:
        port = writer.add_port("n", TimedDoubleSeq)
        for i in range(10):
            writer.write(port, TimedDoubleSeq(i, array), i)
    assert [bool((value.data == array).all()) for _, _, value in read(path)] == [True] * 10
    with path.open("rb") as file:
        assert len(list(mcap_reader.make_reader(file, validate_crcs=True).iter_messages())) == 10
