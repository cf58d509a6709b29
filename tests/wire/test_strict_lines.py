"""Lines are strict JSON: a second parser, which knows no NaN and no Python, reads and writes the same."""

from __future__ import annotations

import json
import math
import random
import struct
from base64 import b64decode
from typing import Any

import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import RecordError
from aiorts.testing.invented import invent, record_types
from aiorts.testing.samples import difference
from aiorts.types import (
    GPSData,
    GPSFixType,
    RangeData,
    TimedDouble,
    TimedDoubleSeq,
    TimedLongLong,
    TimedOctetSeq,
    TimedString,
    TimedULongLong,
)
from aiorts.wire.lines import LineReader, LineWriter, json_text, line_of
from campaign import cases
from each import each

RECORDS = list(record_types())
pytestmark = pytest.mark.row(123)


def test_all_records_are_played_here() -> None:
    assert len(RECORDS) >= 126  # OpenRTM's, and those it has not


def forbidden(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


@pytest.mark.slow
@each(RECORDS)
def test_another_parser_reads_what_we_write_and_writes_what_we_read(cls: type) -> None:
    reader, writer = LineReader({"inp": cls}), LineWriter("out", cls)
    for sample in (invent(cls, random.Random(seed)) for seed in range(cases(250))):
        line = writer.line(sample)
        theirs = orjson.loads(line)
        assert theirs == json.loads(line, parse_constant=forbidden)
        assert set(theirs) <= {"port", "type", "tm", "data"}
        _, read = reader.sample(orjson.dumps(theirs).decode(), 0)
        assert line_of("out", read) == line
        if '"NaN"' not in line:  # a NaN is one in JSON; its payload is not
            assert difference(sample, read) is None
        # A line may leave out all but the data, unless several values could be meant.
        bare = orjson.dumps(theirs["data"]).decode()
        if not (isinstance(theirs["data"], dict) and "data" in theirs["data"]):
            _, read = reader.sample(bare, theirs.get("tm", 0))
            assert line_of("out", read) == line


@pytest.mark.slow(kept_by="test_a_line_of_brackets_is_refused_at_any_depth")
@given(st.floats(), st.integers(0, 2**32 * 10**9 - 1))
@settings(max_examples=cases(10_000))
def test_every_float_survives_to_the_bit(value: float, tm: int) -> None:
    line = LineWriter("out", TimedDouble).line(TimedDouble(tm, value))
    theirs = orjson.loads(line)
    if math.isfinite(value):
        assert struct.pack("<d", theirs["data"]) == struct.pack("<d", value)
    else:
        assert theirs["data"] == ("NaN" if value != value else "Infinity" if value > 0 else "-Infinity")
    _, read = LineReader({"inp": TimedDouble}).sample(orjson.dumps(theirs).decode(), 0)
    assert read.tm == tm
    assert struct.pack("<d", read.data) == struct.pack("<d", value) or value != value


@pytest.mark.parametrize(
    ("cls", "value"),
    [
        (TimedLongLong, -(2**63)),
        (TimedLongLong, 2**63 - 1),
        (TimedULongLong, 2**64 - 1),
        (TimedULongLong, 2**53 + 1),
    ],
)
def test_integers_of_64_bits_are_written_in_full(cls: type, value: int) -> None:
    line = LineWriter("out", cls).line(cls(7, value))
    assert orjson.loads(line)["data"] == value
    assert LineReader({"inp": cls}).sample(line, 0)[1] == cls(7, value)


@pytest.mark.slow(kept_by="test_enumerations_are_names_and_a_record_without_data_is_an_object_of_its_other_fields")
@given(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40))
@settings(max_examples=cases(10_000))
def test_every_text_survives_and_prints(text: str) -> None:
    line = LineWriter("out", TimedString).line(TimedString(1, text))
    assert line.isprintable()
    assert orjson.loads(line)["data"] == text


@given(st.binary(max_size=40))
@settings(max_examples=cases(5_000))
def test_bytes_are_base64(data: bytes) -> None:
    line = LineWriter("out", TimedOctetSeq).line(TimedOctetSeq(1, data))
    assert b64decode(orjson.loads(line)["data"], validate=True) == data


def test_enumerations_are_names_and_a_record_without_data_is_an_object_of_its_other_fields() -> None:
    line: Any = orjson.loads(line_of("out", GPSData(3)))
    assert line["data"]["fixType"] == GPSData(3).fixType.name
    assert line["data"]["fixType"] in GPSFixType.__members__
    scan = RangeData(5, ranges=[1.0, math.inf])
    line = orjson.loads(line_of("out", scan))
    assert line["tm"] == 5
    assert line["data"]["ranges"] == [1.0, "Infinity"]
    assert sorted(line["data"]) == sorted(set(scan.__dataclass_fields__) - {"tm"})  # type: ignore[attr-defined]


@pytest.mark.parametrize("value", [math.nan, [math.inf], {"x": -math.inf}])
def test_nothing_writes_what_is_no_json(value: Any) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_text(value)


@pytest.mark.parametrize("depth", [10, 100, 300, 900, 990, 5_000, 100_000])
@pytest.mark.parametrize("brackets", ["[]", '{"data":}', '{"a":}', '[{"data":}]'])
@pytest.mark.parametrize("cls", [TimedDouble, TimedDoubleSeq, RangeData], ids=lambda cls: cls.__name__)
def test_a_line_of_brackets_is_refused_at_any_depth(cls: type, brackets: str, depth: int) -> None:
    opening = brackets.rstrip("]}")
    closing = brackets[len(opening) :]
    reader = LineReader({"inp": cls})
    for text in (opening * depth, opening * depth + "1" + closing * depth):
        with pytest.raises(RecordError) as caught:
            reader.sample(text, 0)
        assert len(str(caught.value)) < 400
