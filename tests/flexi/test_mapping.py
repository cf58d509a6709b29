"""What FlexiFilter makes of values: between all pairs of types, held against exact arithmetic done another way."""

from __future__ import annotations

import itertools
import math
import struct
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import ConfigurationError, ConversionError
from aiorts.types import TimedDouble, TimedLong, find_type
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.common.ports import parse_port
from aiorts_flexi.mapping.mapping import Mapping, Rules
from campaign import cases

INTEGERS = {
    "TimedShort": (-(2**15), 2**15 - 1),
    "TimedUShort": (0, 2**16 - 1),
    "TimedLong": (-(2**31), 2**31 - 1),
    "TimedULong": (0, 2**32 - 1),
    "TimedLongLong": (-(2**63), 2**63 - 1),
    "TimedULongLong": (0, 2**64 - 1),
    "TimedOctet": (0, 255),
    "TimedState": (-(2**15), 2**15 - 1),
    "TimedBoolean": (0, 1),
}
FLOATS = ("TimedFloat", "TimedDouble")
TEXTS = ("TimedChar", "TimedWChar", "TimedString", "TimedWString")
TYPES = (*INTEGERS, *FLOATS, *TEXTS)
SEQUENCES = tuple(name for name in TYPES if name != "TimedState")
SOME_TEXT = st.sampled_from(
    ["", "7", "-3.7", "1e3", "true", "False", "no", "x", "nan", "inf", "9" * 30, "\u00e9", "1e999"]
)
NUMBERS = st.floats(width=64) | st.integers(-(10**6), 10**6).map(float) | st.sampled_from([0.5, 1.5, 2.5, -0.5, 3e10])


def values_of(name: str) -> st.SearchStrategy[Any]:
    """Values that samples of this type may hold."""
    if name == "TimedBoolean":
        return st.booleans()
    if name in INTEGERS:
        low, high = INTEGERS[name]
        return st.integers(low, high) | st.sampled_from([low, high, 0])
    if name == "TimedDouble":
        return NUMBERS
    if name == "TimedFloat":
        return st.floats(width=32)
    if name in ("TimedString", "TimedWString"):
        return SOME_TEXT | st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=5)
    return st.characters(max_codepoint=0xFF if name == "TimedChar" else 0xFFFF, exclude_categories=["Cs"])


def mapped(source: str, target: str, value: Any, text: str = "0>0", **rules: Any) -> Any:
    """The data of the sample that comes of one with this data."""
    mapping = Mapping([parse_port(source, "input0")], [parse_port(target, "output0")], text, Rules(**rules))
    cls = find_type(source.partition(":")[0])
    ((name, sample),) = mapping.apply({0: cls(5, value)}, 9)
    assert name == "output0"
    assert type(sample) is find_type(target.partition(":")[0])
    assert sample.tm == 5
    return sample.data


def number_in(value: Any) -> Fraction | float | None:
    """The number a value stands for, as exactly as it was written; None for text that is none."""
    if isinstance(value, str):
        text = value.strip()
        if not text.isascii() or "_" in text or "/" in text:
            return None  # numbers to Python, and to nobody else
        try:
            return Fraction(text)
        except (ValueError, ZeroDivisionError):
            try:
                return float(text)
            except ValueError:
                return None
    return Fraction(value) if math.isfinite(value) else value


def rounded(number: Fraction, rounding: str) -> int:
    return {"nearest": round, "truncate": math.trunc, "floor": math.floor}[rounding](number)


def check(source: str, target: str, value: Any, rounding: str, overflow: str) -> None:
    """Hold one conversion against what it has to be, or that there is none."""
    try:
        made = mapped(source, target, value, rounding=rounding, overflow=overflow)
    except ConversionError as error:
        made, said = None, str(error)
        assert said.startswith("0:0>0:0: ")
    if target in TEXTS:
        whole = value if isinstance(value, str) else str(value)
        if made is not None:
            assert made == whole
        else:  # only what is no single character, or has none of one byte
            assert target in ("TimedChar", "TimedWChar") or "\0" in whole or len(whole) != 1
        return
    number = number_in(value)
    if target == "TimedBoolean" and isinstance(value, str) and value.strip().lower() in ("true", "false", "no", "yes"):
        assert made is (value.strip().lower() in ("true", "yes"))
    elif number is None:
        assert made is None or (target == "TimedBoolean" and value.strip().lower() in ("on", "off"))
    elif target in FLOATS:
        check_float(target, number, value, made, overflow)
    elif not isinstance(number, Fraction):
        low, high = INTEGERS[target]
        saturated = overflow == "saturate" and number == number
        assert made == (high if number > 0 else low) if saturated else made is None
    else:
        low, high = INTEGERS[target]
        whole_number = rounded(number, rounding)
        if low <= whole_number <= high:
            assert made == whole_number
        elif overflow == "saturate":
            assert made == min(max(whole_number, low), high)
        elif overflow == "wrap" and abs(whole_number) < 10**300:
            assert made == (whole_number - low) % (high - low + 1) + low
        elif overflow == "error":
            assert made is None


def check_float(target: str, number: Fraction | float, value: Any, made: Any, overflow: str) -> None:
    """Exactly the nearest float of the target, as `struct` has it; out of its range what was asked for."""
    if not isinstance(number, Fraction):
        assert made == number or (made != made and number != number)
        return
    nearest = nearest_float(number, "f" if target == "TimedFloat" else "d")
    if made is None:
        whole = isinstance(value, int) or (isinstance(value, str) and value.strip().lstrip("+-").isdigit())
        assert overflow == "error"
        assert math.isinf(nearest) or (whole and Fraction(nearest_float(number, "d")) != number)
    elif math.isfinite(nearest):
        assert made == nearest
        if isinstance(value, float):
            assert math.copysign(1.0, made) == math.copysign(1.0, value)  # also of zero
    elif overflow == "wrap":
        assert made == nearest
    else:
        assert overflow == "saturate"
        largest = 3.4028234663852886e38 if target == "TimedFloat" else 1.7976931348623157e308
        assert made == math.copysign(largest, nearest)


def nearest_float(number: Fraction, code: str) -> float:
    try:
        made: float = struct.unpack(f"<{code}", struct.pack(f"<{code}", float(number)))[0]
    except OverflowError:
        return math.inf if number > 0 else -math.inf
    return made


@pytest.mark.slow
@pytest.mark.row(127)
@pytest.mark.parametrize("source", TYPES)
def test_every_value_of_every_type_becomes_each_other_type_exactly_or_not_at_all(source: str) -> None:
    @given(values_of(source))
    @settings(max_examples=cases(2_000), deadline=None)
    def run(value: Any) -> None:
        for target in TYPES:
            for rounding in ("nearest", "truncate", "floor"):
                for overflow in ("error", "saturate", "wrap"):
                    check(source, target, value, rounding, overflow)

    run()


@pytest.mark.slow
@pytest.mark.parametrize("source", SEQUENCES)
def test_a_pin_of_a_sequence_is_converted_as_a_scalar_is(source: str) -> None:
    @given(values_of(source))
    @settings(max_examples=cases(1_000), deadline=None)
    def run(value: Any) -> None:
        for target in SEQUENCES:
            assert outcome(f"{source}Seq:2", f"{target}Seq:3", (value, value), "0:1>0:2") == outcome(
                source, target, value, "0>0"
            )

    run()


def outcome(source: str, target: str, value: Any, text: str) -> str:
    """What one pin becomes, or why it becomes nothing, as text."""
    try:
        made = mapped(source, target, value, text)
    except ConversionError as error:
        return str(error).partition(": ")[2]
    if "Seq" in target:
        made = made[2] if isinstance(made, tuple) else made.tolist()[2]
    return repr(made)


@pytest.mark.row(126)
@given(
    st.integers(-(10**12), 10**12),
    st.integers(-(10**6), 10**6),
    st.none() | st.integers(-(10**6), 10**6),
)
@settings(max_examples=cases(5_000))
def test_factor_and_offset_of_integers_are_exact(value: int, mult: int, off: int | None) -> None:
    made = mapped("TimedLongLong", "TimedLongLong", value, f"0>{mult}{'' if off is None else f'{off:+}'}>0")
    assert made == value * mult + (off or 0)


@pytest.mark.row(126)
@given(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
@settings(max_examples=cases(5_000))
def test_factor_and_offset_of_floats_are_what_the_machine_computes(value: float, mult: float, off: float) -> None:
    text = f"0>{mult!r}{'' if str(off).startswith('-') else '+'}{off!r}>0"
    assert mapped("TimedDouble", "TimedDouble", value, text) == value * mult + off


@pytest.mark.row(127)
@pytest.mark.parametrize(
    ("source", "value", "text"),
    [
        ("TimedDouble", math.nan, "0>0"),
        ("TimedDouble", math.nan, "0>2>0"),
        ("TimedString", "nan", "0>0"),
        ("TimedString", "nan", "0>2>0"),
        ("TimedDouble", math.inf, "0>0>0"),
        ("TimedDoubleSeq:1", [math.nan], "0:0>0"),
    ],
)
def test_nan_is_dealt_with_wherever_it_comes_from(source: str, value: Any, text: str) -> None:
    assert math.isnan(mapped(source, "TimedDouble", value, text))
    with pytest.raises(ConversionError, match="NaN"):
        mapped(source, "TimedDouble", value, text, nan="error")
    assert math.isfinite(mapped(source, "TimedDouble", value, text, nan="3"))


def combined(rule: str, *samples: Any, source: str = "TimedDouble", **rules: Any) -> Any:
    """What one pin becomes of one sample of each of several inputs."""
    count = len(samples)
    text = ",".join(f"{number}>0" for number in range(count))
    specs = [parse_port(source, f"input{number}") for number in range(count)]
    mapping = Mapping(specs, [parse_port(source, "output0")], text, Rules(combine=rule, **rules))
    ((_, sample),) = mapping.apply(dict(enumerate(samples)), 0)
    return sample.data


@pytest.mark.row(126)
def test_entries_to_one_pin_are_combined_in_the_same_way_in_any_order() -> None:
    values = [TimedDouble(3, 1.0), TimedDouble(9, -2.0), TimedDouble(5, 4.0)]
    for samples in itertools.permutations(values):
        assert combined("sum", *samples) == 3.0
        assert combined("min", *samples) == -2.0
        assert combined("max", *samples) == 4.0
        assert combined("newest", *samples) == -2.0  # the one of the latest time
    for samples in itertools.permutations([TimedDouble(0, math.nan), TimedDouble(0, 1.0), TimedDouble(0, 2.0)]):
        assert all(math.isnan(combined(rule, *samples)) for rule in ("sum", "min", "max"))


@pytest.mark.parametrize(("rule", "tm"), [("newest", 9), ("sum", 3), ("max", 3)])
def test_the_time_of_a_combined_value_is_of_what_it_was_made_of(rule: str, tm: int) -> None:
    specs = [parse_port("TimedDouble", "input0"), parse_port("TimedDouble", "input1")]
    mapping = Mapping(specs, [parse_port("TimedDouble", "output0")], "0>0,1>0", Rules(combine=rule))
    ((_, sample),) = mapping.apply({0: TimedDouble(9, 1.0), 1: TimedDouble(3, 2.0)}, 0)
    assert sample.tm == tm


@pytest.mark.row(127)
def test_a_combined_value_out_of_range_is_what_was_asked_for() -> None:
    big = TimedDouble(0, 1.7e308)
    with pytest.raises(ConversionError, match="sum of 0:0>0:0 and 1:0>0:0: it is too large"):
        combined("sum", big, big)
    assert combined("sum", big, big, overflow="saturate") == 1.7976931348623157e308
    assert combined("sum", big, big, overflow="wrap") == math.inf
    assert combined("sum", TimedDouble(0, math.inf), big) == math.inf
    long = TimedLong(0, 2**31 - 1)
    with pytest.raises(ConversionError, match="i32"):
        combined("sum", long, long, source="TimedLong")
    assert combined("sum", long, long, source="TimedLong", overflow="wrap") == -2


@pytest.mark.row(126)
@pytest.mark.parametrize(
    ("source", "value", "result"),
    [
        ("TimedDouble", 7.5, 5.0),
        ("TimedDouble", -math.inf, -5.0),
        ("TimedLong", 9, 5.0),
        ("TimedDouble", 1.25, 1.25),
    ],
)
def test_a_clamp_limits_every_number(source: str, value: Any, result: float) -> None:
    assert mapped(source, "TimedDouble", value, clamp=(-5.0, 5.0)) == result


def test_zero_old_is_zero_false_or_no_text_by_the_type_of_the_pin() -> None:
    outs = [
        parse_port(spec, f"output{n}")
        for n, spec in enumerate(("TimedDoubleSeq:2", "TimedBooleanSeq:2", "TimedStringSeq:2"))
    ]
    ins = [parse_port(spec, f"input{n}") for n, spec in enumerate(("TimedLong", "TimedLong"))]
    text = ",".join(f"{pin}>{out}:{pin}" for out in range(3) for pin in range(2))
    for zero_old, expected in (
        (True, [[0.0, 1.0], [False, True], ("", "1")]),
        (False, [[1.0, 1.0], [True, True], ("1", "1")]),
    ):
        mapping = Mapping(ins, outs, text, Rules(zero_old=zero_old))
        mapping.apply({0: TimedLong(1, 1)}, 0)
        made = [sample.data for _, sample in mapping.apply({1: TimedLong(2, 1)}, 0)]
        assert [data if isinstance(data, tuple) else data.tolist() for data in made] == expected
    with pytest.raises(ConfigurationError, match="exclude each other"):
        Rules(zero_old=True, reset="1")


def test_the_value_of_zero_old_is_only_sent_with_something_new() -> None:
    ins = [parse_port("TimedLong", "input0"), parse_port("TimedLong", "input1")]
    outs = [parse_port("TimedLong", "output0"), parse_port("TimedLongSeq:2", "output1")]
    mapping = Mapping(ins, outs, "0>0,0>1:0,1>1:1", Rules(zero_old=True))
    assert [name for name, _ in mapping.apply({0: TimedLong(1, 7)}, 0)] == ["output0", "output1"]
    ((name, sample),) = mapping.apply({1: TimedLong(2, 8)}, 0)
    assert (name, sample.data.tolist()) == ("output1", [0, 8])
    made = dict(mapping.apply({0: TimedLong(3, 9)}, 0))
    assert made["output0"].data == 9


@pytest.mark.fault("F07")
@pytest.mark.parametrize(
    ("text", "place"),
    [("0>0, 1>0", 6), ("0>0 , 0:5>1", 7), ("0>0,0>7", 5), ("0>1:3", 1), ("9>0", 1), ("0>1:0,0>1:0", 7)],
)
def test_an_entry_that_does_not_fit_its_ports_is_marked_too(text: str, place: int) -> None:
    ins = [parse_port("TimedLong", "input0"), parse_port("TimedLong", "input1")]
    outs = [parse_port("TimedLong", "output0"), parse_port("TimedLongSeq:2", "output1")]
    with pytest.raises(TypedTextError) as caught:
        Mapping(ins, outs, text, Rules())
    assert caught.value.place == place - 1
    assert caught.value.marked() == f"{text}\n{' ' * (place - 1)}^"


def test_text_says_what_it_is() -> None:
    assert [mapped("TimedString", "TimedBoolean", text) for text in ("False", "true", "0", "1")] == [
        False,
        True,
        False,
        True,
    ]
    assert mapped("TimedString", "TimedLong", "3.7") == 4
    assert mapped("TimedString", "TimedLong", "3.7", rounding="truncate") == 3
    assert mapped("TimedBoolean", "TimedString", True) == "True"
    assert mapped("TimedOctet", "TimedString", 65) == "65"
    assert mapped("TimedChar", "TimedString", "A") == "A"
