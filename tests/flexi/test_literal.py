"""Constants that users type: literals of JSON and Python become samples, and nothing else is accepted or run."""

from __future__ import annotations

import ast
import json
import math
import time
import tracemalloc
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import aiorts.types.ros  # noqa: F401 - records like others
from aiorts.errors import ConfigurationError
from aiorts.types import (
    CameraImage,
    GPSData,
    GPSFixType,
    Point2D,
    Point3D,
    Pose2D,
    RangeData,
    TimedBoolean,
    TimedChar,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedLong,
    TimedLongLong,
    TimedLongSeq,
    TimedMap,
    TimedOctetSeq,
    TimedPose2D,
    TimedShort,
    TimedString,
    TimedStringSeq,
    all_types,
    to_plain,
)
from aiorts_flexi.common.constant import sample_of
from aiorts_flexi.common.literal import DEEPEST, LONGEST, parse_literal
from aiorts_flexi.common.place import TypedTextError
from campaign import cases


@pytest.mark.row(125)
@pytest.mark.fault("F08")
@pytest.mark.parametrize(
    ("cls", "text", "sample"),
    [
        (TimedDouble, "6.2", TimedDouble(0, 6.2)),
        (TimedDouble, "0", TimedDouble(0, 0.0)),
        (TimedDouble, "0.0", TimedDouble(0, 0.0)),
        (TimedLong, "0", TimedLong(0, 0)),
        (TimedLong, "-0x1f", TimedLong(0, -31)),
        (TimedBoolean, "False", TimedBoolean(0, False)),
        (TimedBoolean, "true", TimedBoolean(0, True)),
        (TimedString, '""', TimedString(0, "")),
        (TimedString, r"'a\tb\x41\u00e9\'\ud83d\ude00'", TimedString(0, "a\tbA\u00e9'\U0001f600")),
        (TimedChar, '"c"', TimedChar(0, "c")),
        (TimedDoubleSeq, "[]", TimedDoubleSeq(0, [])),
        (TimedDoubleSeq, "(1, 2.5,)", TimedDoubleSeq(0, [1.0, 2.5])),
        (TimedDoubleSeq, "[Infinity, -inf, 1e3]", TimedDoubleSeq(0, [math.inf, -math.inf, 1000.0])),
        (TimedStringSeq, '["a", "b"]', TimedStringSeq(0, ("a", "b"))),
        (TimedOctetSeq, "b'\\x00ab'", TimedOctetSeq(0, b"\0ab")),
        (TimedOctetSeq, "[0, 255]", TimedOctetSeq(0, b"\0\xff")),
        (TimedOctetSeq, '"AP8="', TimedOctetSeq(0, b"\0\xff")),
        (TimedPose2D, '{"position": {"x": 1}}', TimedPose2D(0, Pose2D(Point2D(1.0, 0.0), 0.0))),
        (TimedPose2D, '{"data": {"heading": 2}}', TimedPose2D(0, Pose2D(Point2D(0.0, 0.0), 2.0))),
        (RangeData, '{"ranges": [1, 2]}', RangeData(0, ranges=[1.0, 2.0])),
        (CameraImage, "{'width': 2, 'pixels': [1, 2]}", CameraImage(0, width=2, pixels=b"\1\2")),
        (GPSData, '{"fixType": "GPS_FIX_NORMAL"}', GPSData(0, fixType=GPSFixType.GPS_FIX_NORMAL)),
        (TimedMap, '{"data": 5, "x": null}', None),
        (TimedMap, '{"data": 5}', TimedMap(0, {"data": 5})),
        (Point3D, '{"z": 1}', Point3D(0.0, 0.0, 1.0)),
        (float, "1", 1.0),
        (bool, "False", False),
    ],
)
def test_a_literal_is_a_sample_of_its_type(cls: type, text: str, sample: Any) -> None:
    if sample is None:
        with pytest.raises(ConfigurationError):
            sample_of(cls, text)
    else:
        made = sample_of(cls, text)
        assert type(made) is cls
        assert made == sample


@pytest.mark.row(125)
@pytest.mark.fault("F08")
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("__import__('os').getpid()", 1),
        ("__import__('os')", 1),
        ("9**9**9", 2),
        ("'a'*10**10", 4),
        ("lambda: 1", 1),
        ("f'{1}'", 1),
        ("-" * LONGEST, 1),
        ("-" * 100_000, LONGEST + 1),
        ("[" * LONGEST, DEEPEST + 1),
        ('{"a":' * 100, 5 * DEEPEST + 1),
        ("1e999", 1),
        ("9" * 5_000, 1),
        ("1" + "," * 1_000, 2),
        ("1+1j", 2),
        ("1_000", 1),
        ("1.2.3", 1),
        ("", 1),
        ("   ", 4),
        ("[1", 1),
        ("[1,,2]", 4),
        ("(1)", 3),
        ("{'a': 1, 'a': 2}", 10),
        ("{1: 2}", 2),
        ("{'a' 2}", 6),
        ("'abc", 1),
        ("'a\nb'", 3),
        (r"'\q'", 2),
        (r"'\x4'", 2),
        (r"'\ud83d'", 1),
        (r"'\U00110000'", 2),
        ("b'\u0100'", 1),
        ("True if 1 else 2", 6),
        ("os", 1),
        ("...", 1),
        ("{*()}", 2),
        ("\u0661", 1),
    ],
)
def test_what_is_no_literal_is_refused_with_the_place(text: str, place: int) -> None:
    with pytest.raises(TypedTextError) as caught:
        parse_literal(text)
    assert caught.value.place == place - 1
    assert f"character {place}:" in str(caught.value)
    quoted, mark = caught.value.marked().split("\n")
    assert mark.strip() == "^"
    assert quoted[len(mark) - 1 : len(mark)] == "".join(c if c.isprintable() else "?" for c in text[place - 1 : place])


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(125)
@pytest.mark.fault("F08")
@pytest.mark.parametrize(
    "text",
    [
        "9**9**9",
        "'a'*10**10",
        "-" * LONGEST,
        "[" * LONGEST,
        "[0," * (LONGEST // 3),
        "[" + "0," * (LONGEST // 2 - 1),
        "[" + "'a'," * (LONGEST // 4 - 1),
        "'" + "\\n'" * (LONGEST // 3),
        "1e999",
        "9" * LONGEST,
        "x" * 10**7,
    ],
)
def test_a_hostile_constant_costs_neither_time_nor_memory(text: str) -> None:
    def refused() -> float:
        began = time.process_time()
        with pytest.raises(TypedTextError):
            sample_of(TimedDoubleSeq, text)
        return time.process_time() - began

    assert min(refused() for _ in range(3)) <= 0.1
    tracemalloc.start()
    try:
        refused()
        assert tracemalloc.get_traced_memory()[1] <= 10 * 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.row(125)
@pytest.mark.parametrize(
    ("cls", "text", "said"),
    [
        (TimedShort, "40000", "TimedShort.data: expected an integer -32768..32767, got 40000"),
        (TimedLong, "6.2", "TimedLong.data"),
        (TimedLong, "True", "TimedLong.data"),
        (TimedBoolean, "0", "TimedBoolean.data: expected True or False"),
        (TimedFloat, "1e39", "TimedFloat.data"),
        (TimedLong, '"7"', "TimedLong.data"),
        (TimedDouble, "None", "TimedDouble.data"),
        (TimedDouble, "[1]", "TimedDouble.data"),
        (TimedDoubleSeq, "1", "TimedDoubleSeq.data"),
        (TimedDoubleSeq, "b'ab'", "bytes"),
        (TimedLongSeq, "[1, 2.5]", "TimedLongSeq.data"),
        (TimedOctetSeq, "[1, 256]", "[1]: expected a byte"),
        (TimedPose2D, '{"position": {"q": 1}}', "TimedPose2D.data.position: unknown field q; expected x, y"),
        (TimedPose2D, '{"position": {"x": "a"}}', "TimedPose2D.data.position.x"),
        (TimedPose2D, "3", "TimedPose2D.data"),
        (RangeData, '{"tm": 1}', "RangeData.tm: is when the sample is sent"),
        (RangeData, "[1.0]", "RangeData: expected a mapping"),
        (GPSData, '{"fixType": "NONE"}', "GPSData.fixType"),
        (TimedLongLong, str(2**63), "TimedLongLong.data"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_its_field(cls: type, text: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        sample_of(cls, text, "constant 0")
    assert str(caught.value).startswith("constant 0: ")
    assert said in str(caught.value)


@pytest.mark.fault("F08")
def test_a_sequence_of_the_wrong_length_is_refused() -> None:
    assert sample_of(TimedDoubleSeq, "[1, 2]", length=2) == TimedDoubleSeq(0, [1.0, 2.0])
    with pytest.raises(ConfigurationError, match=r"TimedDoubleSeq.data: expected 3 items, got 2"):
        sample_of(TimedDoubleSeq, "[1, 2]", length=3)


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc", max_size=3), inner, max_size=3),
    max_leaves=12,
)


@pytest.mark.slow(kept_by="test_a_literal_is_a_sample_of_its_type")
@given(values)
@settings(max_examples=cases(5_000))
def test_what_json_and_python_write_is_read_as_it_was(value: Any) -> None:
    assert parse_literal(json.dumps(value)) == value
    assert parse_literal(json.dumps(value, ensure_ascii=False, indent=1)) == value
    assert parse_literal(repr(value)) == value


@pytest.mark.slow(kept_by="test_what_is_no_literal_is_refused_with_the_place")
@given(st.text("0123456789+-.eExob_'\"\\[](){},: abfnrtuTFN\n", max_size=20))
@settings(max_examples=cases(20_000))
def test_any_text_is_what_python_reads_or_refused_with_a_place(text: str) -> None:
    try:
        value = parse_literal(text)
    except TypedTextError as error:
        place = error.place
        assert 0 <= place <= len(text)
        return
    try:
        expected = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        # Words and escapes that JSON has and Python has not, a leading zero, blanks where Python wants none.
        assert any(part in text for part in ("true", "false", "null", "nan", "inf", "\\", "0", "\n", "N"))
        return
    plain = json.loads(json.dumps(expected)) if not isinstance(expected, bytes | set) else expected
    if "\\" not in text:
        assert value == plain


@pytest.mark.row(125)
def test_every_type_can_be_sent_as_a_constant() -> None:
    records = [cls for cls in all_types().values() if cls.__module__.startswith("aiorts.types.")]
    records = [cls for cls in records if hasattr(cls, "__dataclass_fields__")]
    assert len(records) > 120
    for cls in records:
        plain = to_plain(cls())
        plain.pop("tm", None)
        data = plain["data"] if list(plain) == ["data"] else plain
        assert sample_of(cls, json.dumps(data)) == cls(), cls
