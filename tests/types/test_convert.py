"""One conversion between all kinds: what it gives is exact, or was asked for, or is an error."""

from __future__ import annotations

# ruff: noqa: E501 - tables read better with one case on a line
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from aiorts.errors import ConversionError
from aiorts.types import convert
from aiorts.types.arrays import DTYPES
from aiorts.types.convert import limits_of
from campaign import cases

INTEGERS = ["i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64"]
TARGETS = [*INTEGERS, "f32", "f64", "bool", "str", "char", "wchar"]
LARGEST_F32 = float(np.finfo(np.float32).max)


@pytest.mark.row(65)
@pytest.mark.fault("B05")
@pytest.mark.parametrize(
    ("value", "to", "saturated", "wrapped"),
    [
        (3e10, "i32", 2**31 - 1, 30000000000 - 7 * 2**32),
        (math.nan, "i32", None, None),
        (300.7, "u8", 255, 45),
        (-1, "u8", 0, 255),
        (2**63, "i64", 2**63 - 1, -(2**63)),
        (1e300, "f32", LARGEST_F32, math.inf),
        ("größer", "char", None, None),
    ],
)
def test_value_out_of_range_is_an_error_unless_a_policy_is_asked_for(
    value: Any, to: str, saturated: Any, wrapped: Any
) -> None:
    for sample, target in ((value, to), ([value], f"seq[{to}]")):
        with pytest.raises(ConversionError):
            convert(sample, target)
    for policy, expected in (("saturate", saturated), ("wrap", wrapped)):
        if expected is None:
            with pytest.raises(ConversionError):
                convert(value, to, overflow=policy)
        else:
            assert convert(value, to, overflow=policy) == expected
            assert list(convert(np.array([value]), to, overflow=policy)) == [expected]


@pytest.mark.row(65)
@pytest.mark.parametrize(
    ("value", "rounded", "truncated", "floored"),
    [
        (1.001 * 1000, 1001, 1000, 1000),
        (2.5, 2, 2, 2),
        (3.5, 4, 3, 3),
        (-1.5, -2, -1, -2),
        (-0.4, 0, 0, -1),
        ("-1.5", -2, -1, -2),
    ],
)
def test_rounding_is_chosen(value: Any, rounded: int, truncated: int, floored: int) -> None:
    for rounding, expected in (("round", rounded), ("truncate", truncated), ("floor", floored)):
        assert convert(value, "i32", rounding=rounding) == expected
        assert convert([value], "seq[i32]", rounding=rounding).tolist() == [expected]
        if isinstance(value, float):
            assert convert(np.array([[value]]), "i32", rounding=rounding).tolist() == [[expected]]


@pytest.mark.parametrize(
    ("value", "to", "expected"),
    [
        ("False", "bool", False), ("true", "bool", True), (" ON ", "bool", True), ("0", "bool", False), (1.0, "bool", True),
        ("7", "u8", 7), (" -1.5e2 ", "f64", -150.0), ("3.7", "i32", 4), ("9007199254740993.0", "i64", 2**53 + 1),
        ("NaN", "f64", math.nan), ("-inf", "f32", -math.inf), (True, "str", "True"), (1.5, "str", "1.5"), (np.int8(3), "str", "3"),
        (5, "char", "5"), ("é", "char", "é"), ("€", "wchar", "€"), (True, "i8", 1), (np.float32(2.0), "u8", 2), (b"\x01\x02", "seq[u16]", [1, 2]),
        ([1, 2.0, "3"], "seq[u8]", [1, 2, 3]), ((1, 2), "bytes", b"\x01\x02"), ([1.5, True], "seq[str]", ("1.5", "True")),
        (np.array([[1, 2]], dtype=">i4"), "f64", [[1.0, 2.0]]), (np.array([True]), "seq[i8]", [1]), ([], "seq[f32]", []),
    ],
)  # fmt: skip
def test_conversion_gives_what_the_text_or_number_says(value: Any, to: str, expected: Any) -> None:
    result = convert(value, to)
    if hasattr(result, "tolist"):
        assert not result.flags.writeable
        result = result.tolist()
    assert repr(result) == repr(expected)


@pytest.mark.parametrize(
    ("value", "to"),
    [
        ("maybe", "bool"), ("", "i32"), ("1_000", "i32"), ("0x10", "i32"), ("٣", "i32"), ("1,5", "f64"), ("1e400", "f64"),
        ("9" * 5000, "i64"), ("1e999999999", "i64"), (10, "char"), ("ab", "char"), ("€", "char"), ("\ud800", "str"), (2, "bool"),
        (None, "i32"), ([None], "seq[i32]"), (1j, "f64"), (2**53 + 1, "f64"), ({}, "str"), ("abc", "seq[u8]"), (3, "seq[i32]"),
        (np.array([1j]), "seq[f64]"), (np.array([2**63 - 1]), "f64"), (1, "point"), ("ab", "bytes"), (math.inf, "i64"),
    ],
)  # fmt: skip
def test_what_has_no_conversion_is_an_error(value: Any, to: str) -> None:
    with pytest.raises(ConversionError):
        convert(value, to)


def test_unknown_policy_is_an_error() -> None:
    with pytest.raises(ConversionError, match="overflow: expected error"):
        convert(1, "i8", overflow="clip")
    with pytest.raises(ConversionError, match="rounding: expected round"):
        convert(1.5, "i8", rounding="up")


def _exact(value: Any) -> Fraction | None:
    """The number a source value is, None for NaN, infinity and text."""
    if isinstance(value, str) or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return Fraction(value)


def _around(bits: int) -> st.SearchStrategy[int]:
    return st.integers(-3, 3).map(lambda off: 2**bits + off)


SOURCES = st.one_of(
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.sampled_from([7, 8, 15, 16, 24, 31, 32, 53, 63, 64])
    .flatmap(_around)
    .flatmap(lambda n: st.sampled_from([n, -n])),
    st.floats(),
    st.sampled_from([7, 8, 31, 32, 53, 63, 64]).flatmap(_around).map(float),
    st.integers(-(10**6), 10**6).map(lambda n: n / 2),
    st.text(max_size=3),
)


@pytest.mark.slow(kept_by="test_value_out_of_range_is_an_error_unless_a_policy_is_asked_for")
@pytest.mark.row(65)
@pytest.mark.fault("B05")
@pytest.mark.campaign
@settings(max_examples=cases(100_000))
@given(SOURCES, st.sampled_from(TARGETS), st.sampled_from(["round", "truncate", "floor"]))
def test_no_pair_of_kinds_changes_a_value_silently(value: Any, to: str, rounding: str) -> None:
    try:
        result = convert(value, to, rounding=rounding)
    except ConversionError:
        number = _exact(value)
        if number is not None and to in INTEGERS:
            low, high = limits_of(to) or (0, 0)
            assert not low <= _rounded(number, rounding) <= high, "refused although it fits"
        return
    number = _exact(value)
    if isinstance(value, str):
        return
    if to in ("str", "char", "wchar"):
        assert repr(value) == result
    elif number is None:
        assert to in ("f32", "f64")
        assert repr(result) == repr(value)
    elif to == "f64":
        assert Fraction(result) == number
    elif to == "f32":
        assert result == float(np.float32(float(value)))
    else:
        assert int(result) == _rounded(number, rounding)
        assert type(result) is (bool if to == "bool" else int)


def _rounded(number: Fraction, rounding: str) -> int:
    return {"round": round, "truncate": math.trunc, "floor": math.floor}[rounding](number)


@pytest.mark.slow(kept_by="test_conversion_gives_what_the_text_or_number_says")
@pytest.mark.fault("B05")
@pytest.mark.campaign
@settings(max_examples=cases(50_000))
@given(
    st.data(),
    st.sampled_from([*INTEGERS, "f32", "f64", "bool"]),
    st.sampled_from([*INTEGERS, "f32", "f64", "bool"]),
    st.sampled_from(["error", "saturate", "wrap"]),
    st.sampled_from(["round", "truncate", "floor"]),
)
def test_arrays_convert_exactly_as_their_items_do(
    data: st.DataObject, source: str, to: str, overflow: str, rounding: str
) -> None:
    items = data.draw(st.lists(SOURCES.filter(lambda v: not isinstance(v, str)), min_size=1, max_size=4))
    try:
        array = convert(items, f"seq[{source}]", overflow="saturate")
    except ConversionError:
        assume(False)
    one_by_one: Any
    try:
        one_by_one = [convert(item, to, overflow=overflow, rounding=rounding) for item in array.tolist()]
    except ConversionError:
        with pytest.raises(ConversionError, match=r"^\[\d"):
            convert(array, f"seq[{to}]", overflow=overflow, rounding=rounding)
        return
    result = convert(array, f"seq[{to}]", overflow=overflow, rounding=rounding)
    assert result.dtype == np.dtype(DTYPES[to])
    assert repr(result.tolist()) == repr(one_by_one)


@pytest.mark.slow(kept_by="test_value_out_of_range_is_an_error_unless_a_policy_is_asked_for")
@settings(max_examples=cases(20_000))
@given(st.integers(-(2**70), 2**70), st.sampled_from(INTEGERS))
def test_wrap_is_modulo_and_saturate_is_the_nearest_limit(value: int, to: str) -> None:
    low, high = limits_of(to) or (0, 0)
    wrapped = convert(value, to, overflow="wrap")
    assert low <= wrapped <= high
    assert (wrapped - value) % (high - low + 1) == 0
    assert convert(value, to, overflow="saturate") == min(max(value, low), high)
