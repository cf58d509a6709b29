"""FlexiFilter's map as a converter of connections: `convert = "map 0>1000>0"`."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts.errors import AiortsError, ConfigurationError, ConversionError
from aiorts.testing import check_converter
from aiorts.types import (
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedPoint2D,
    TimedPose2D,
    TimedShort,
    TimedString,
)
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.mapping.conversion import conversion


@pytest.mark.parametrize(
    ("text", "sample", "made"),
    [
        ("0>0", TimedDouble(4, 2.0), TimedLong(4, 2)),
        ("0>1000>0", TimedDouble(4, 1.5), TimedLong(4, 1500)),
        ("0>1.8+32>0", TimedDouble(4, 100.0), TimedDouble(4, 212.0)),
        ("0>0 rounding=floor", TimedDouble(4, 1.9), TimedLong(4, 1)),
        ("0>0 overflow=saturate", TimedDouble(4, 1e9), TimedShort(4, 32767)),
        ("0>0 clamp=-1,1", TimedDouble(4, 7.0), TimedDouble(4, 1.0)),
        ("0>0 nan=5", TimedDouble(4, float("nan")), TimedDouble(4, 5.0)),
        ("0:0>0,0:1>0 combine=sum", TimedDoubleSeq(4, [1.0, 2.0]), TimedDouble(4, 3.0)),
        ("0:1>0", TimedDoubleSeq(4, [1.0, 2.0, 3.0]), TimedDouble(4, 2.0)),
        ("0>0:0, 0>0:2", TimedDouble(4, 3.0), TimedDoubleSeq(4, [3.0, 0.0, 3.0])),
        ("0>0", TimedDouble(4, 2.5), TimedString(4, "2.5")),
        ("0:tm>0", TimedDouble(4, 2.5), TimedLong(4, 4)),
        ("0>0", 2.5, TimedDouble(0, 2.5)),
        ("0>0", TimedDouble(4, 2.5), 2.5),
    ],
)
def test_it_converts_one_sample(text: str, sample: Any, made: Any) -> None:
    function = conversion(text, type(sample), type(made))
    for _ in range(2):
        assert function(sample) == made


def test_fields_of_a_record_are_pins() -> None:
    function = conversion("0:position.x>0:x,0:position.y>0:y", TimedPose2D, TimedPoint2D)
    made = function(TimedPose2D(9))
    assert (made.tm, made.data.x, made.data.y) == (9, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("", TypedTextError, "expected the number of an in-port"),
        ("0>1", TypedTextError, "there is no out-port 1"),
        ("1>0", TypedTextError, "there is no in-port 1"),
        ("0:x>0", TypedTextError, "TimedDouble has no field 'x'"),
        ("0>0,0>0", TypedTextError, "feed one pin"),
        ("0>0 overflow=never", ConfigurationError, "overflow=never: expected error, saturate, wrap"),
        ("0>0 reset=1", ConfigurationError, "no such rule; there are rounding, overflow, combine, clamp, nan"),
        ("0>0 clamp=1", ConfigurationError, "expected two numbers, the lower one first"),
        ("0>0 nan=x", ConfigurationError, "expected a decimal number"),
    ],
)
def test_a_wrong_text_is_refused(text: str, error: type[AiortsError], said: str) -> None:
    with pytest.raises(error, match=said):
        conversion(text, TimedDouble, TimedLong)


def test_types_without_pins_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="input0: a bytes has no pins"):
        conversion("0>0", bytes, TimedLong)


def test_a_value_that_does_not_fit_is_a_conversion_error() -> None:
    with pytest.raises(ConversionError, match="0:0>0:0: "):
        conversion("0>0", TimedDouble, TimedShort)(TimedDouble(0, 1e9))
    with pytest.raises(ConversionError, match="0:3>0:0: "):
        conversion("0:3>0", TimedDoubleSeq, TimedDouble)(TimedDoubleSeq(0, [1.0]))


def test_it_keeps_the_promises_of_converters() -> None:
    samples = [TimedDouble(number, number / 4) for number in range(20)]
    check_converter(conversion, "0>1000>0", samples, TimedLong)
    check_converter(conversion, "0>0:0,0>2>0:1", samples, TimedDoubleSeq)
