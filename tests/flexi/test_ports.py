"""Ports as a user states them: what is accepted, what is refused, and which pins they have."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError
from aiorts.types import find_type
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.common.ports import MOST_PINS, MOST_PORTS, parse_counted, parse_port
from campaign import cases

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize(
    ("text", "form", "element", "length"),
    [
        ("TimedLong", "scalar", "i32", 1),
        ("TimedFloatSeq:2", "sequence", "f32", 2),
        ("TimedStringSeq:4", "sequence", "str", 4),
        ("TimedPose2D", "record", "", 1),
        ("RangeData", "record", "", 1),
        ("float", "scalar", "f64", 1),
    ],
)
def test_a_port_is_a_type_and_for_a_sequence_its_length(text: str, form: str, element: str, length: int) -> None:
    spec = parse_port(text, "input0")
    assert (spec.shape, spec.element, spec.length) == (form, element, length)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("TimedFoo", "did you mean"),
        ("TimedLong:3", "no sequence"),
        ("TimedLongSeq", "needs its length"),
        ("TimedLongSeq:0", "from 1 to"),
        ("TimedLongSeq:-1", "from 1 to"),
        ("TimedLongSeq:1.5", "from 1 to"),
        ("TimedLongSeq:1000000000", "from 1 to"),
        (":", "unknown type"),
        ("a:b:c", "unknown type"),
        ("", "unknown type"),
        ("GPSFixType", "cannot be a port's type"),
    ],
)
def test_a_bad_port_is_refused_with_its_name(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said) as caught:
        parse_port(text, "input3")
    assert str(caught.value).startswith("input3")


def test_the_pins_of_a_record_are_its_fields() -> None:
    pose = parse_port("TimedPose2D", "input0")
    assert pose.kind("position.x") == pose.kind("data.position.x") == "f64"
    assert pose.pin_path("heading") == "data.heading"
    assert parse_port("RangeData", "input0").kind("ranges[3]") == "f64"
    for pin in ("position", "position.z", 0, "data"):
        with pytest.raises(ConfigurationError):
            pose.kind(pin)
    with pytest.raises(ConfigurationError, match="last one is 1"):
        parse_port("TimedLongSeq:2", "input0").kind(2)


@pytest.mark.fault("F06")
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("TimedFoo", 1),
        ("  TimedFoo", 3),
        ("TimedLong:3", 10),
        ("TimedLongSeq", 13),
        ("TimedLongSeq:", 14),
        ("TimedLongSeq:0", 14),
        ("TimedLongSeq:-1", 14),
        ("TimedLongSeq:1 000", 14),
        ("TimedLongSeq:1000000000", 14),
        ("TimedLongSeq:1000001", 14),
        ("TimedLongSeq:\u0661", 14),
        ("TimedLongSeq:2:3", 14),
        (":", 1),
        ("", 1),
        ("a:b:c", 1),
        ("GPSFixType", 1),
    ],
)
def test_the_bad_part_of_a_port_is_marked(text: str, place: int) -> None:
    with pytest.raises(TypedTextError) as caught:
        parse_port(text, "input3")
    assert caught.value.place == place - 1
    assert f"character {place}: " in str(caught.value)
    quoted, mark = caught.value.marked().split("\n")
    assert quoted == text
    assert mark == " " * (place - 1) + "^"


def test_a_mark_stands_right_in_a_long_text_and_below_what_does_not_print() -> None:
    quoted, mark = TypedTextError("map", "\x1b" * 500 + "!" + "x" * 500, 500, "expected nothing").marked().split("\n")
    assert quoted[len(mark) - 1] == "!"
    assert quoted.isprintable()
    assert len(quoted) <= 120


TYPES = ("TimedLong", "TimedLongSeq", "TimedStringSeq", "TimedPose2D", "RangeData", "int", "float", "TimedFoo", "")
OTHERS = (":", "0", "1", "2", "10", "999999", "1000001", "-", "+", ".", " ", "x")
pieces = st.lists(st.sampled_from([*TYPES, *OTHERS]), max_size=5)
typed = pieces.map("".join) | st.text("0123456789:-+. \t\x00xyz\u0661\u00b2", max_size=12)


def accepted(text: str, name: str, parse: Callable[[str, str], object]) -> bool:
    """Whether it is accepted; if not, that it says where."""
    try:
        parse(text, name)
    except TypedTextError as error:
        place, said = error.place, str(error)
    else:
        return True
    assert 0 <= place <= len(text)
    assert said.startswith(f"{name} ")
    assert f"character {place + 1}: " in said
    return False


@pytest.mark.fault("F06")
@given(typed)
@settings(max_examples=cases(5_000))
def test_what_is_accepted_as_a_port_is_the_grammar(text: str) -> None:
    sequence = re.fullmatch(r"\s*(TimedLongSeq|TimedStringSeq):([1-9][0-9]{0,6})\s*", text)
    other = re.fullmatch(r"\s*(TimedLong|TimedPose2D|RangeData|int|float)\s*", text)
    good = other is not None or (sequence is not None and int(sequence[2]) <= MOST_PINS)
    assert accepted(text, "output7", parse_port) is good


@pytest.mark.slow(kept_by="test_a_port_is_a_type_and_for_a_sequence_its_length")
@pytest.mark.fault("F06")
@given(typed)
@settings(max_examples=cases(5_000))
def test_what_is_accepted_as_a_type_and_a_number_of_ports_is_the_grammar(text: str) -> None:
    match = re.fullmatch(r"\s*(Timed(Long|LongSeq|StringSeq|Pose2D)|RangeData|int|float)\s*:([1-9][0-9]{0,6})\s*", text)
    good = match is not None and int(match[3]) <= MOST_PORTS
    assert accepted(text, "port", parse_counted) is good
    if match is not None and good:
        assert parse_counted(text, "port") == (find_type(match[1]), int(match[3]))
