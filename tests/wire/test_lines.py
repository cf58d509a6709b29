"""Samples as lines of JSON: every record comes back, and a bad line says what is wrong with it."""

from __future__ import annotations

import json
import math
import random
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from aiorts.errors import RecordError
from aiorts.testing.invented import invent, record_types
from aiorts.testing.samples import difference
from aiorts.types import (
    RangeData,
    TimedBoolean,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedString,
    from_plain,
    full_name,
    record,
)
from aiorts.types.registry import _by_full_name, _by_short_name
from aiorts.wire.lines import LineReader, LineWriter, line_of, split_sample
from each import each

NOW = 1_700_000_000_000_000_000
NUMBER = LineReader({"input0": TimedDouble})
BOTH = LineReader({"input0": TimedDouble, "input1": TimedLong})


@pytest.mark.slow(kept_by="first")
@each(record_types())
def test_every_record_comes_back_from_its_line(cls: type) -> None:
    reader = LineReader({"other": cls})
    for sample in (invent(cls, random.Random(seed)) for seed in range(5)):
        line = line_of("output0", sample)
        assert LineWriter("output0", cls).line(sample) == line
        assert line.isprintable()
        assert "\n" not in line
        port, read = reader.sample(line, 0)
        assert port == "other"
        # A NaN is a NaN in JSON; its payload is not.
        assert line_of("output0", read) == line
        assert "NaN" in line or difference(sample, read) is None


def test_the_form_of_a_line() -> None:
    assert line_of("output0", TimedLong(NOW, 6200)) == (
        '{"port": "output0", "type": "TimedLong", "tm": 1700000000000000000, "data": 6200}'
    )
    assert json.loads(line_of("out", TimedDoubleSeq(1, [1.0, math.nan, -math.inf])))["data"] == [
        1.0,
        "NaN",
        "-Infinity",
    ]
    assert line_of("out", 2.5) == '{"port": "out", "type": "float", "data": 2.5}'


def test_a_record_without_data_has_an_object_of_its_fields() -> None:
    scan = invent(RangeData, random.Random(1))
    line = json.loads(line_of("scan", scan))
    assert set(line) == {"port", "type", "tm", "data"}
    assert "ranges" in line["data"]
    assert "tm" not in line["data"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('{"data": 1.5}', TimedDouble(NOW, 1.5)),
        ('{"tm": 7, "data": 1.5}', TimedDouble(7, 1.5)),
        ("1.5", TimedDouble(NOW, 1.5)),
        ("  2  ", TimedDouble(NOW, 2.0)),
        ('"NaN"', TimedDouble(NOW, math.nan)),
        ('{"port": "somewhere", "type": "TimedDouble", "data": 0}', TimedDouble(NOW, 0.0)),
    ],
)
def test_what_a_line_may_leave_out(line: str, expected: TimedDouble) -> None:
    port, sample = NUMBER.sample(line, NOW)
    assert port == "input0"
    assert difference(sample, expected) is None


@record
class Echo:
    distance: float
    angle: float = 0.5


@dataclass
class Sweep:
    echoes: list[Echo]
    first: Echo | None = None
    label: str = "sweep"
    tm: int = 0
    spots: list[float] = field(default_factory=lambda: [1.0])


def test_a_line_may_leave_out_fields_that_have_a_default_at_any_depth() -> None:
    reader = LineReader({"input0": Sweep})
    _, sample = reader.sample('{"echoes": [{"distance": 1}], "first": {"distance": 2}}', NOW)
    assert sample == Sweep([Echo(1.0, 0.5)], Echo(2.0, 0.5), "sweep", NOW, [1.0])
    _, other = reader.sample('{"tm": 7, "data": {"echoes": [], "label": "own"}}', NOW)
    assert other == Sweep([], None, "own", 7, [1.0])
    assert sample.spots is not other.spots


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('{"label": "x"}', "Sweep: missing field echoes; expected echoes, first"),
        ('{"echoes": [{"angle": 1}]}', r"Sweep.echoes\[0\]: missing field distance; expected distance, angle"),
        ('{"echoes": [], "lable": "x"}', "Sweep: unknown field lable"),
    ],
)
def test_a_line_without_a_field_that_has_no_default_names_it(line: str, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        LineReader({"input0": Sweep}).sample(line, NOW)


@dataclass(frozen=True)
class Filled:
    at: datetime
    before: datetime | None = None


def test_a_line_may_have_a_datetime_as_text_with_a_zone() -> None:
    reader = LineReader({"input0": Filled})
    moment = datetime(2026, 3, 1, 12, tzinfo=UTC)
    for text in ("2026-03-01T12:00:00Z", "2026-03-01 21:00:00.000000000+09:00"):
        assert reader.sample(json.dumps({"at": text, "before": text}), NOW)[1] == Filled(moment, moment)
    assert reader.sample(line_of("input0", Filled(moment)), NOW)[1] == Filled(moment)
    with pytest.raises(RecordError, match="expected a datetime with a time zone"):
        from_plain(Filled, {"at": "2026-03-01T12:00:00Z", "before": None})  # what is no line stays strict


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2026-03-01T12:00:00", "Filled.at: '2026-03-01T12:00:00' has no time zone; add Z"),
        ("noon", "Filled.at: expected a datetime such as 2026-03-01T12:00:00Z, .* got 'noon'"),
        ("2026-03-01T12:00:00.0000001Z", "Filled.at: expected whole microseconds"),
        ("1066-10-14T12:00:00Z", "Filled.at: expected a datetime with a time zone, from 1677"),
        ("0001-01-01T00:00:00+09:00", "Filled.at: expected a datetime with a time zone, from 1677"),
    ],
)
def test_a_text_that_is_no_exact_datetime_is_refused(text: str, message: str) -> None:
    with pytest.raises(RecordError, match=message):
        LineReader({"input0": Filled}).sample(json.dumps({"at": text}), NOW)


def test_with_several_in_ports_a_line_names_its_own() -> None:
    assert BOTH.sample('{"port": "input1", "data": 3}', NOW) == ("input1", TimedLong(NOW, 3))
    with pytest.raises(RecordError, match=r"which in-port\? .* there are input0, input1"):
        BOTH.sample("3", NOW)
    with pytest.raises(RecordError, match="no in-port 'input2'; there are input0, input1"):
        BOTH.sample('{"port": "input2", "data": 3}', NOW)
    with pytest.raises(RecordError, match=r"no in-port \[\]"):
        BOTH.sample('{"port": [], "data": 3}', NOW)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("", "column 1: no JSON"),
        ("{", "column 2: no JSON"),
        ("NaN", "NaN is not JSON"),
        ('{"data": Infinity}', "Infinity is not JSON"),
        ('{"data": 1, "data": 2}', "'data' stands there twice"),
        ('{"data": 1, "time": 2}', "unknown key 'time'"),
        ('{"data": 1, "tipe": "x"}', "did you mean 'type'"),
        ('{"type": "TimedLong", "data": 1}', "'TimedLong' for a port of TimedDouble"),
        ('{"type": 3, "data": 1}', "3 for a port of TimedDouble"),
        ('{"data": "1.5"}', "NaN"),
        ('{"data": null}', "TimedDouble.data"),
        ("[1]", "TimedDouble.data"),
        ('{"tm": -1, "data": 1}', "TimedDouble.tm"),
        ('{"tm": 1.5, "data": 1}', "TimedDouble.tm"),
        ("9" * 5000, "no JSON|TimedDouble.data"),
        ("[" * 100_000, "nested too deeply|recursion"),
        ("1 2", "no JSON"),
    ],
)
def test_a_bad_line_says_what_is_wrong(line: str, message: str) -> None:
    with pytest.raises(RecordError, match=message) as raised:
        NUMBER.sample(line, NOW)
    assert len(str(raised.value)) < 300


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["data", "tm", "port", "x"]), inner),
    max_leaves=8,
)


@pytest.mark.slow(kept_by="test_a_bad_line_says_what_is_wrong")
@pytest.mark.parametrize("cls", [TimedDouble, TimedBoolean, TimedString, TimedDoubleSeq, RangeData, float])
@given(st.one_of(st.text(max_size=30), JSON.map(json.dumps)))
@example('{"data": {"data": {"data": 1}}}')
def test_any_text_is_a_sample_or_an_error_of_one_kind(cls: type, line: str) -> None:
    try:
        port, sample = LineReader({"in": cls}).sample(line, NOW)
    except RecordError:
        return
    assert port == "in"
    assert type(sample) is cls
    assert json.loads(line_of("in", sample))["data"] == _plain(split_sample(sample)[1])


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value))


def test_a_line_with_very_many_keys_is_refused_in_no_time() -> None:
    keys = ", ".join(f'"k{number}": 1' for number in range(50_000))
    with pytest.raises(RecordError, match="'k1' stands there twice"):
        NUMBER.sample(f'{{{keys}, "k1": 2}}', NOW)  # one look at each: with one at each pair this takes minutes


@pytest.mark.parametrize("line", ["1e400", "-1e400", '{"data": 1e400}', "[1.0, 1e309]"])
def test_a_number_that_no_float_holds_is_refused_and_not_made_infinite(line: str) -> None:
    with pytest.raises(RecordError, match="too large for a number of 64 bits"):
        LineReader({"in": TimedDouble}).sample(line, 1)


@pytest.mark.row(64)
def test_a_line_may_name_the_type_in_full_and_a_bare_name_is_that_of_aiorts_where_it_has_one() -> None:
    @record
    class Probe:
        data: float = 0.0

    def line_for(name: str) -> str:
        return json.dumps({"type": name, "data": 1.5})

    own = type("TimedDouble", (), {"__annotations__": {"tm": "int", "data": "float"}, "__module__": __name__})
    other: Any = record(own)
    reader = LineReader({"port": Probe})
    for name in ("Probe", full_name(Probe)):
        assert reader.sample(line_for(name), 0) == ("port", Probe(1.5))
    for name in ("probe", "other.Probe", "", "TimedDouble"):
        with pytest.raises(RecordError, match="for a port of Probe"):
            reader.sample(line_for(name), 0)
    assert LineReader({"port": TimedDouble}).sample(line_for("aiorts.types.TimedDouble"), 3)[1] == TimedDouble(3, 1.5)
    assert LineReader({"port": TimedDouble}).sample(line_for("TimedDouble"), 3)[1] == TimedDouble(3, 1.5)
    assert LineReader({"port": other}).sample(line_for(full_name(other)), 3)[1] == other(3, 1.5)
    pair, several = LineReader({"port": Filled}), LineReader({"port": RangeData})
    for wrong, name in ((pair, "TimedDouble"), (several, "TimedLong"), (several, "Filled"), (pair, "nowhere.Nothing")):
        with pytest.raises(RecordError, match=r"; pass on only lines of \w+ \(of a replay: --ports NAME\)$"):
            wrong.sample(line_for(name), 3)
    with pytest.raises(RecordError, match="put a flexifilter between them"):
        LineReader({"port": other}).sample(line_for("TimedDouble"), 3)
    del _by_full_name[full_name(other)], _by_short_name["TimedDouble"][full_name(other)]
