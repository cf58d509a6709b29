"""Fields that may be absent, have one of a few values, are moments, or maps of maps: everywhere a record goes."""

from __future__ import annotations

import dataclasses
import json
import random
from collections.abc import Mapping
from datetime import UTC, date, datetime, timedelta, timezone
from enum import Enum
from pathlib import Path
from typing import Any, Literal, NamedTuple, Optional

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import ConversionError, DeclarationError, RecordError, WireError
from aiorts.testing.invented import invent
from aiorts.types import (
    Array,
    Map,
    Point2D,
    Rows,
    Seq,
    convert,
    describe,
    detached,
    f32,
    f64,
    from_plain,
    is_mutable,
    path_type,
    read_path,
    record,
    snapshot,
    to_plain,
    u8,
)
from aiorts.wire import LineReader, MsgpackCodec, line_of

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MOMENT = datetime(2026, 11, 22, 17, 45, 1, 234567, tzinfo=UTC)
NS = 1795369501234567000
NO_MAP: Any = {}


class Gear(Enum):
    """An enumeration."""

    PARK = "park"
    DRIVE = "drive"


@record
class Report:
    """A record with one of each."""

    tm: int = 0
    level: float | None = None
    note: Optional[str] = None  # noqa: UP045 - the other spelling
    small: f32 | None = None
    where: Point2D | None = None
    gear: Gear | None = None
    path: Rows[Point2D] | None = None
    samples: Array[f64] | None = None
    raw: Array[u8] | None = None
    texts: Seq[str] | None = None
    flag: bool | None = None
    mode: Literal["auto", "manual", ""] = "auto"
    size: Literal[1, 2, -3] = 1
    sure: Literal[True] = True
    maybe: Literal["x", None] = None
    when: datetime = EPOCH
    until: datetime | None = None
    moments: Seq[datetime] = ()  # type: ignore[assignment]
    several: Seq[float | None] = ()  # type: ignore[assignment]
    data: Map = NO_MAP


@dataclasses.dataclass
class Loose:
    """The same in a dataclass that can change."""

    level: float | None = None
    items: list[float] | None = None
    when: datetime = EPOCH
    mode: Literal["a", "b"] = "a"
    data: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)


FULL = Report(
    7,
    0.5,
    "",
    0.1,
    Point2D(1.0, 2.0),
    Gear.DRIVE,
    [Point2D(3.0, 4.0)],
    [1.0, float("nan")],
    b"\x00\xff",
    ["a", ""],
    False,
    "",
    -3,
    True,
    "x",
    MOMENT,
    MOMENT,
    [MOMENT, EPOCH],
    [None, float("nan")],
    {"a": {"b": {"c": 1, "d": b"\x00"}, "e": np.array([1.5])}, "f": {}, "map": {"map": 1}, "float": {"bytes": "x"}},
)
CODEC = MsgpackCodec()


@pytest.mark.parametrize("sample", [Report(), FULL], ids=["absent", "present"])
def test_it_travels_and_comes_back(sample: Report) -> None:
    assert CODEC.decode(CODEC.encode(sample)) == sample
    assert from_plain(Report, json.loads(json.dumps(to_plain(sample), allow_nan=False))) == sample
    reader = LineReader({"port": Report})
    assert reader.sample(line_of("port", sample), 0) == ("port", sample)
    assert snapshot(sample) is sample
    assert detached(sample) == sample
    assert dataclasses.replace(sample) == sample
    assert not is_mutable(Report)


def test_what_travels_is_as_documented() -> None:
    plain = to_plain(FULL)
    assert (plain["when"], plain["until"], plain["moments"]) == (NS, NS, [NS, 0])
    assert plain["several"] == [None, "NaN"]
    assert plain["data"]["map"] == {"map": {"map": 1}}
    assert plain["data"]["float"] == {"map": {"bytes": "x"}}
    assert to_plain(Report())["level"] is None
    spellings = {field.name: field.spelling for field in describe(Report).fields}
    assert spellings["level"] == "optional[f64]"
    assert spellings["mode"] == "'auto' | 'manual' | ''"
    assert spellings["maybe"] == "optional['x']"
    assert (spellings["when"], spellings["until"]) == ("datetime", "optional[datetime]")
    assert spellings["texts"] == "optional[seq[str]]"
    with pytest.raises(TypeError):
        FULL.data["a"]["b"] = 1  # type: ignore[index]
    assert "'c': 1" in repr(FULL)


@pytest.mark.slow
def test_a_hundred_invented_ones_come_back() -> None:
    dice = random.Random(7)
    for _ in range(100):
        sample = invent(Report, dice)
        assert CODEC.decode(CODEC.encode(sample)) == sample
        assert from_plain(Report, json.loads(json.dumps(to_plain(sample)))) == sample


@given(st.datetimes(datetime(1678, 1, 1), datetime(2262, 1, 1)), st.integers(-1439, 1439))
def test_a_moment_of_any_zone_is_the_same_moment_in_utc(naive: datetime, minutes: int) -> None:
    zoned = naive.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    kept = Report(when=zoned).when
    assert (kept, kept.tzinfo) == (zoned, UTC)
    ns = to_plain(Report(when=zoned))["when"]
    assert ns == (zoned - EPOCH) // timedelta(microseconds=1) * 1000
    assert Report(when=ns) == Report(when=zoned)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("level", "much", "expected a number"),
        ("when", datetime(2026, 1, 1), "add tzinfo=UTC"),
        ("when", 1.5, "its nanoseconds since the epoch, got 1.5"),
        ("when", True, "got True"),
        ("when", NS + 1, "whole microseconds"),
        ("when", 2**63, "expected an integer"),
        ("when", datetime(2262, 4, 12, tzinfo=UTC), "to 2262-04-11"),
        ("when", "2026-11-22", "expected a datetime"),
        ("when", date(2026, 1, 1), "expected a datetime"),
        ("when", None, "got None"),
        ("mode", "Auto", "expected 'auto' | 'manual' | '', got 'Auto'"),
        ("mode", None, "got None"),
        ("size", 3, r"expected 1 \| 2 \| -3, got 3"),
        ("size", True, "write int"),
        ("sure", 1, "True or False"),
        ("data", {"a": {1: 2}}, "key"),
        ("data", {"a": {"b": {"c": None}}}, r"data\['a'\]\['b'\]\['c'\]"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_field(field: str, value: Any, said: str) -> None:
    with pytest.raises(RecordError, match=said.replace("|", r"\|") if "\\" not in said else said) as caught:
        Report(**{field: value})
    assert f"Report.{field}" in str(caught.value)


def test_a_map_within_itself_and_a_frame_that_nests_without_end_are_refused() -> None:
    endless: dict[str, Any] = {}
    endless["again"] = endless
    with pytest.raises(RecordError, match="at most 16 maps within each other"):
        Report(data=endless)
    deep: Any = {}
    for _ in range(15):
        deep = {"a": deep}
    assert CODEC.decode(CODEC.encode(Report(data=deep))).data == deep
    frame, plain = CODEC.encode(Report(data=deep)), to_plain(Report(data=deep))
    with pytest.raises(WireError, match="at most 16 maps"):
        CODEC.decode(frame[:-1] + b"\x81\xa1a\x80")
    for levels in (1, 200):
        worse = plain["data"]
        for _ in range(levels):
            worse = {"a": {"map": worse}}
        with pytest.raises(RecordError, match="at most 16 maps"):
            from_plain(Report, {**plain, "data": worse})
    with pytest.raises(WireError):
        CODEC.decode(frame[:-1] + b"\x81\xa1a" * 400 + b"\x80")


class Pair(NamedTuple):
    a: int


@pytest.mark.parametrize(
    ("annotation", "said"),
    [
        (int | str | None, "a field has one, or that and None"),
        (int | str, "a field has one, or that and None"),
        (Literal["a", 1], "all text, all integers or all truth values"),
        (Literal[b"a"], "all text, all integers or all truth values"),
        (Literal[Gear.PARK], "take an Enum"),
        (Literal[None], "all text"),
        (Literal[2**70], "expected an integer"),
        (Literal["\ud800"], "surrogate"),
        (date, "a datetime"),
        (timedelta, "cannot travel"),
        (complex | None, "cannot travel"),
        (dict[str, Point2D], "write a record for it"),
        (dict[str, Gear], "write a record for it"),
        (dict[str, datetime], "write a record for it"),
        (dict[str, dict[str, Point2D]], "write a record for it"),
        (dict[int, float], "cannot travel"),
        (Array[float | None], r"Array\[...\] takes a number type"),  # type: ignore[valid-type]
    ],
)
def test_what_cannot_travel_is_said_when_the_class_is_made(annotation: Any, said: str) -> None:
    with pytest.raises(DeclarationError, match=said) as caught:
        record(type("Odd", (), {"__annotations__": {"data": annotation}, "__module__": __name__}))
    assert "Odd.data" in str(caught.value)


@pytest.mark.parametrize("annotation", [datetime, int | None, float | None])
def test_a_time_stamp_is_an_int_and_never_absent(annotation: Any) -> None:
    with pytest.raises(DeclarationError, match=r"Odd\.tm: a time stamp is an int"):
        record(type("Odd", (), {"__annotations__": {"tm": annotation}, "__module__": __name__}))


@pytest.mark.parametrize(
    "annotation",
    [
        dict[str, float],
        dict[str, Any],
        dict[str, bool | int],
        Mapping[str, dict[str, npt.NDArray[np.float64]]],
        dict[str, list[float]],
        Map,
    ],
)
def test_maps_may_say_what_they_hold(annotation: Any) -> None:
    cls: Any = record(type("Even", (), {"__annotations__": {"data": annotation}, "__module__": __name__}))
    assert describe(cls).fields[0].spelling == "map"


def test_a_dataclass_that_can_change_gets_what_it_declares() -> None:
    sample = Loose(1.5, [1.0], MOMENT, "b", {"a": {"b": 2.0}})
    sent: Any = snapshot(sample)
    assert sent is not sample
    sample.items = None
    sample.data["a"]["b"] = 3.0
    assert (sent.items, sent.data) == ((1.0,), {"a": {"b": 2.0}})
    with pytest.raises(TypeError):
        sent.data["a"]["b"] = 4.0
    back = CODEC.decode(CODEC.encode(sent), Loose)
    assert back == Loose(1.5, [1.0], MOMENT, "b", {"a": {"b": 2.0}})
    back.data["a"]["b"] = 5.0  # its own
    assert back.items == [1.0]
    assert CODEC.decode(CODEC.encode(Loose())) == Loose()
    with pytest.raises(RecordError, match=r"Loose\.mode: expected 'a' \| 'b', got 'c'"):
        CODEC.encode(Loose(mode="c"))  # type: ignore[arg-type]


def test_hash_and_equality_see_what_is_absent() -> None:
    @record
    class Plain:
        level: float | None = None
        when: datetime | None = None
        mode: Literal["a"] = "a"

    nan = Plain(float("nan"))
    assert len({Plain(), Plain(None), Plain(0.0), Plain(0.0, EPOCH), nan, Plain(float("nan"))}) == 4
    assert Plain() != Plain(0.0)
    with pytest.raises(TypeError):
        hash(Report())


def test_paths_lead_through_what_may_be_absent() -> None:
    assert str(path_type(Report, "where.x")) == "f64"
    assert str(path_type(Report, "level")) == "optional[f64]"
    assert path_type(Report, "path[0]") is Point2D
    assert read_path(FULL, "where.x") == 1.0
    assert read_path(FULL, "data['a']['b']['c']") == 1
    with pytest.raises(RecordError, match=r"Report\.where is a value of type NoneType and has no field 'x'"):
        read_path(Report(), "where.x")
    with pytest.raises(RecordError, match="no field 'z'; its fields are x, y"):
        path_type(Report, "where.z")


def test_conversion_takes_a_moment_as_its_nanoseconds() -> None:
    kinds = {field.name: field.kind for field in describe(Report).fields}
    assert convert(MOMENT, "i64") == NS
    assert convert(MOMENT, "str") == "2026-11-22T17:45:01.234567+00:00"
    assert convert("1.5", kinds["level"]) == 1.5
    assert convert(2.0, kinds["size"]) == 2
    assert convert(5, kinds["mode"]) == "5"
    assert Report(when=convert(str(NS), kinds["when"])).when == EPOCH + timedelta(microseconds=NS // 1000)
    with pytest.raises(ConversionError, match="None has no conversion to f64"):
        convert(None, kinds["level"])
    with pytest.raises(ConversionError, match="add tzinfo"):
        convert(datetime(2026, 1, 1), "f64")


def test_the_record_of_the_guide_is_one() -> None:
    page = (Path(__file__).parents[2] / "aiorts/guide/pages/howto/records.md").read_text(encoding="utf-8")
    space: dict[str, Any] = {"__name__": __name__}
    code = page.partition("```python\n")[2].partition("```")[0]
    exec(compile(code, "records.md", "exec", dont_inherit=True), space)
    tank = space["tank"]
    assert CODEC.decode(CODEC.encode(tank)) == tank
    assert to_plain(tank)["filled"] == 1_772_366_400_000_000_000
    assert tank.more["pump"]["rate"] == 2.5
    code = next(block for block in page.split("```python\n") if "class Fix" in block).partition("```")[0]
    exec(compile(code, "records.md", "exec", dont_inherit=True), space)
    fix = space["Fix"](tm=1, place=(1, 2, 3))
    assert CODEC.decode(CODEC.encode(fix)) == fix
    with pytest.raises(RecordError, match="expected 9 numbers, got 2"):
        space["Fix"](covariance=[1, 2])
    with pytest.raises(RecordError, match="place"):
        space["Fix"](place=(1, 2))
