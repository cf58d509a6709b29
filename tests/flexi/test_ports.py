"""Ports as a user states them: what is accepted, what is refused, and which pins they have."""

from __future__ import annotations

import pytest

from aiorts.errors import ConfigurationError
from aiorts_flexi.ports import parse_port


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
    assert (spec.form, spec.element, spec.length) == (form, element, length)


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
