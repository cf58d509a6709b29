"""Pins that may be absent, have one of a few values, or are moments; constants and lists with such fields."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Literal

import pytest

from aiorts.errors import ConfigurationError, ConversionError
from aiorts.types import Point2D, TimedDouble, TimedLongLong, TimedString, record
from aiorts_flexi.common.constant import sample_of
from aiorts_flexi.common.ports import parse_port
from aiorts_flexi.common.text import line_of
from aiorts_flexi.mapping.mapping import Mapping, Rules
from aiorts_flexi.summing import Summation

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@record
class Voyage:
    """A record with such fields."""

    tm: int = 0
    speed: float | None = None
    where: Point2D | None = None
    mode: Literal["auto", "manual"] = "auto"
    gear: Literal[2, 1] = 2
    begun: datetime = EPOCH


def mapped(source: str, target: str, text: str, sample: Any) -> Any:
    mapping = Mapping([parse_port(source, "in0")], [parse_port(target, "out0")], text, Rules())
    ((_, made),) = mapping.apply({0: sample}, 9)
    return made


@pytest.mark.parametrize(
    ("target", "pins", "expected"),
    [
        ("TimedDouble", "0:speed>2>0", TimedDouble(1, 5.0)),
        ("TimedLongLong", "0:begun>1>0", TimedLongLong(1, 7000)),
        ("TimedString", "0:mode>0", TimedString(1, "manual")),
        ("TimedString", "0:begun>0", TimedString(1, "7000")),
        ("Voyage", "0:gear>1>0:gear", Voyage(1, gear=1)),
        ("Voyage", "0:speed>1000>0:begun", Voyage(1, begun=EPOCH.replace(microsecond=2))),
    ],
)
def test_a_pin_of_each_sort(target: str, pins: str, expected: Any) -> None:
    moment = EPOCH.replace(microsecond=7)
    sample = Voyage(1, 2.0 if "1000" in pins else 2.5, mode="manual", gear=1, begun=moment)
    assert mapped("Voyage", target, pins, sample) == expected


def test_what_no_entry_sets_has_a_value_that_fits() -> None:
    ports = [parse_port("TimedDouble", "in0"), parse_port("TimedString", "in1")], [parse_port("Voyage", "out0")]
    mapping = Mapping(*ports, "0>1>0:speed,1>0:mode", Rules())
    assert mapping.apply({0: TimedDouble(3, 1.5)}, 9)[0][1] == Voyage(3, 1.5)
    assert mapping.apply({1: TimedString(4, "manual")}, 9)[0][1] == Voyage(3, 1.5, mode="manual")
    with pytest.raises(ConversionError, match=r"mode: expected 'auto' \| 'manual', got 'x'"):
        mapping.apply({1: TimedString(4, "x")}, 9)


def test_an_absent_value_is_an_error_that_names_entry_and_field() -> None:
    with pytest.raises(ConversionError, match=r"0:speed>2>0:0: in0: speed is absent"):
        mapped("Voyage", "TimedDouble", "0:speed>2>0", Voyage())


def test_no_pin_leads_through_what_may_be_absent() -> None:
    for source, target, pins in (("Voyage", "TimedDouble", "0:where.x>0"), ("TimedDouble", "Voyage", "0>0:where.x")):
        with pytest.raises(ConfigurationError, match=r"where is optional.Point2D. and may be absent; no pin leads"):
            mapped(source, target, pins, None)


def test_constants_and_sums() -> None:
    text = '{"speed": null, "mode": "manual", "begun": 1000, "where": {"x": 1.0, "y": 2.0}}'
    assert sample_of(Voyage, text) == Voyage(0, None, Point2D(1.0, 2.0), "manual", 2, EPOCH.replace(microsecond=1))
    for wrong, said in (
        ('{"mode": "x"}', "'auto' | 'manual'"),
        ('{"begun": 1.5}', "datetime"),
        ('{"gear": 3}', "2 | 1"),
    ):
        with pytest.raises(ConfigurationError, match=said.replace("|", r"\|")):
            sample_of(Voyage, wrong)
    with pytest.raises(ConfigurationError, match=r"Voyage.speed: values of optional.f64. have no sum"):
        Summation(Voyage, "error")


def test_chosen_fields_are_printed_as_lines_have_them() -> None:
    fields = ("speed", "mode", "begun")
    assert line_of("text", "in0", "Voyage", Voyage(), fields).endswith('speed=null mode="auto" begun=0')
