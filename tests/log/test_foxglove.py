"""Recordings in JSON open in Foxglove: names as it documents them, and a file that stands up to a stranger's checks."""

from __future__ import annotations

import base64
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import jsonschema
import pytest

from aiorts.types import Seq, TimedDouble, TimedDoubleSeq, TimedOctetSeq, TimedPose3D, TimedString, record
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter

reader_module = pytest.importorskip("mcap.reader")
records = pytest.importorskip("mcap.records")
well_known = pytest.importorskip("mcap.well_known")
stream_reader = pytest.importorskip("mcap.stream_reader")

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SAMPLES: dict[str, list[Any]] = {
    "number": [TimedDouble(i, i / 7) for i in range(300)],
    "list": [TimedDoubleSeq(i, [i, 0.5]) for i in range(3)],
    "odd": [TimedDoubleSeq(0, [1.0, float("nan"), float("-inf")])],
    "bytes": [TimedOctetSeq(i, bytes([i, 255])) for i in range(3)],
    "pose": [TimedPose3D(i) for i in range(3)],
    "text": [TimedString(0, 'ü"\n')],
    "bare": [1.5, 2.5],
}


def made(path: Path, encoding: Any) -> Path:
    """A recording of all of them in several chunks."""
    with RecordingWriter(path, RecordingOptions(min_free=0, encoding=encoding, chunk=2048)) as writer:
        for name, samples in SAMPLES.items():
            port = writer.add_port(name, type(samples[0]))
            for number, one in enumerate(samples):
                assert writer.write(port, one, 1000 * (list(SAMPLES).index(name) + 1) + number)
    return path


@pytest.mark.slow(kept_by="test_bytes_are_base_64_and_the_schema_says_so")
def test_names_are_those_that_foxglove_documents(tmp_path: Path) -> None:
    """https://docs.foxglove.dev: message encoding "json", schema encoding "jsonschema", whose root is an object."""
    with made(tmp_path / "run.mcap", "json").open("rb") as stream:
        reader = reader_module.make_reader(stream, validate_crcs=True)
        found: dict[str, list[Any]] = {}
        for schema, channel, message in reader.iter_messages():
            assert channel.message_encoding == well_known.MessageEncoding.JSON == "json"
            assert schema.encoding == well_known.SchemaEncoding.JSONSchema == "jsonschema"
            document = json.loads(schema.data)
            assert document["type"] == "object"
            assert not schema.name.startswith("foxglove"), "a well-known type of theirs that ours is not"
            value = json.loads(message.data, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
            if channel.topic != "odd":  # a number that is not finite is text, as the schema says in words
                jsonschema.validate(value, document)
            found.setdefault(channel.topic, []).append(value)
    assert {name: len(values) for name, values in found.items()} == {name: len(s) for name, s in SAMPLES.items()}
    assert [one["data"] for one in found["number"]] == [i / 7 for i in range(300)]
    assert found["list"][1]["data"] == [1.0, 0.5]
    assert found["odd"][0]["data"] == [1.0, "NaN", "-Infinity"]
    assert base64.b64decode(found["bytes"][2]["data"]) == b"\x02\xff"
    assert found["pose"][0]["data"]["position"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    assert found["text"][0]["data"] == 'ü"\n'
    assert found["bare"] == [{"value": 1.5}, {"value": 2.5}]


@record
class Part:
    """Within another record."""

    x: float = 0.0
    label: str | None = None


@record
class Reading:
    """A record with fields that may be absent, of every kind that Foxglove shows."""

    tm: int = 0
    speed: float | None = None
    count: int | None = None
    door: bool | None = None
    note: str | None = None
    raw: bytes | None = None
    part: Part | None = None
    parts: Seq[Part] = ()  # type: ignore[assignment]
    mode: Literal["auto", "manual"] | None = None
    ended: datetime | None = None
    usual: float | None = 1.0
    """Absent is not what it is by default: a message says null."""


def shown_by_foxglove(schema: dict[str, Any]) -> bool:
    """What its reader of schemas asks for: each field has one type, and each list items of one type."""
    if schema.get("type") == "object":
        return all(map(shown_by_foxglove, schema["properties"].values()))
    if schema.get("type") == "array":
        return "contentEncoding" not in schema["items"] and shown_by_foxglove(schema["items"])
    return schema.get("type") in ("boolean", "string", "number", "integer")


def test_a_field_that_may_be_absent_has_its_type_in_the_schema_and_is_left_out(tmp_path: Path) -> None:
    full = Reading(1, 2.5, 0, False, "", b"\x00", Part(1.0, "a"), [Part(2.0), Part(3.0, "")], "manual", EPOCH, None)
    samples = [Reading(), full]
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0, encoding="json")) as writer:
        port = writer.add_port("a", Reading)
        assert all(writer.write(port, one, number) for number, one in enumerate(samples))
    with path.open("rb") as stream:
        read = [
            (s, json.loads(m.data)) for s, _, m in reader_module.make_reader(stream, validate_crcs=True).iter_messages()
        ]
    document = json.loads(read[0][0].data)
    jsonschema.Draft202012Validator.check_schema(document)
    for _, value in read:
        jsonschema.validate(value, document)
    fields = document["properties"]
    assert document["required"] == ["tm", "parts", "usual"]
    assert fields["part"]["required"] == ["x"]
    assert fields["usual"]["anyOf"][1] == {"type": "null"}
    types = {name: one.get("type") for name, one in fields.items()}
    expected = {"speed": "number", "count": "integer", "door": "boolean", "note": "string", "raw": "string"}
    assert types == {"tm": "integer", **expected, "part": "object", "parts": "array", "mode": "string",
                     "ended": "integer", "usual": None}  # fmt: skip
    assert shown_by_foxglove({**document, "properties": {k: v for k, v in fields.items() if k != "usual"}})
    assert read[0][1] == {"tm": 0, "parts": [], "usual": 1.0}
    assert (read[1][1]["parts"], read[1][1]["usual"]) == ([{"x": 2.0}, {"x": 3.0, "label": ""}], None)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**read[1][1], "speed": "fast"}, document)
    with RecordingReader(path) as reader:
        assert [one for _, _, one in reader.records()] == samples


def test_bytes_are_base_64_and_the_schema_says_so(tmp_path: Path) -> None:
    with made(tmp_path / "run.mcap", "json").open("rb") as stream:
        summary = reader_module.make_reader(stream).get_summary()
        (schema,) = (one for one in summary.schemas.values() if one.name == "TimedOctetSeq")
        assert json.loads(schema.data)["properties"]["data"] == {"type": "string", "contentEncoding": "base64"}


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_file_stands_up_to_the_checks_of_a_doctor(tmp_path: Path, encoding: Any) -> None:
    """What `mcap doctor` looks at: every record in its place, every offset right, every count and time as they are."""
    path = made(tmp_path / "run.mcap", encoding)
    raw = path.read_bytes()
    with path.open("rb") as stream:
        summary = reader_module.make_reader(stream, validate_crcs=True).get_summary()
    with path.open("rb") as stream:
        flat = list(stream_reader.StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    kinds = [type(one).__name__ for one in flat]
    assert (kinds[0], kinds[-1]) == ("Header", "Footer")
    assert kinds.count("DataEnd") == 1
    assert not {"Schema", "Channel", "Message"} & set(kinds[: kinds.index("DataEnd")]), "all of them in chunks"
    chunks = [one for one in flat if isinstance(one, records.Chunk)]
    assert len(chunks) == len(summary.chunk_indexes) == summary.statistics.chunk_count > 5
    counted: dict[int, int] = {}
    defined: set[int] = set()
    for chunk, index in zip(chunks, sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset), strict=True):
        assert raw[index.chunk_start_offset] == 0x06
        assert chunk.uncompressed_crc != 0
        begin = index.chunk_start_offset + index.chunk_length
        assert all(raw[at] == 0x07 for at in index.message_index_offsets.values())
        assert all(begin <= at < begin + index.message_index_length for at in index.message_index_offsets.values())
        times, last = [], -1
        for one in stream_reader.breakup_chunk(chunk, validate_crc=True):
            if isinstance(one, records.Channel):
                assert one.schema_id in summary.schemas
                defined.add(one.id)
            elif isinstance(one, records.Message):
                assert one.channel_id in defined, "a message before its channel"
                assert one.log_time >= last
                last = one.log_time
                times.append(one.log_time)
                counted[one.channel_id] = counted.get(one.channel_id, 0) + 1
        if times:
            assert (min(times), max(times)) == (chunk.message_start_time, chunk.message_end_time)
            assert (min(times), max(times)) == (index.message_start_time, index.message_end_time)
    assert counted == summary.statistics.channel_message_counts
    assert summary.statistics.message_count == sum(map(len, SAMPLES.values()))
    assert summary.statistics.attachment_count == len(summary.attachment_indexes) == 2
    assert (summary.statistics.channel_count, summary.statistics.schema_count) == (7, 6)
