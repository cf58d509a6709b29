"""Values go to clients without loss, and come from them bounded."""

from __future__ import annotations

import json
import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.errors import RecordError
from aiorts_studio.plain.values import DEEPEST, json_in, json_out, value_out

LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
VALUES = st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


def exact(text: bytes) -> object:
    """As a client reads it whose numbers are doubles."""
    return json.loads(text, parse_int=lambda digits: int(float(digits)), parse_constant=pytest.fail)


@given(VALUES)
def test_a_client_whose_numbers_are_doubles_reads_every_value_exactly(value: object) -> None:
    read = exact(json_out(value))
    try:
        str(value).encode()
    except UnicodeEncodeError:
        return
    assert read == value_out(value)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (2**53, "9007199254740992"),
        (2**53 + 1, '"9007199254740993"'),
        (-(2**63), '"-9223372036854775808"'),
        (math.nan, '"NaN"'),
        ([math.inf, -math.inf], '["Infinity","-Infinity"]'),
        (b"\x00\xff", '"AP8="'),
        ({1: (True, None)}, '{"1":[true,null]}'),
        ("caf\udce9", '"caf?"'),
    ],
)
def test_what_json_does_not_have_is_a_text(value: object, text: str) -> None:
    assert json_out(value).decode() == text


def nested(levels: int) -> bytes:
    return b"[" * levels + b"]" * levels


def test_json_of_the_deepest_level_is_read_and_beyond_it_refused() -> None:
    assert json_in(nested(DEEPEST)) is not None
    for levels in (DEEPEST + 1, 1_000, 30_000):
        with pytest.raises(RecordError):
            json_in(nested(levels))
    with pytest.raises(RecordError, match="deeper"):
        json_in(b'{"a":' * 33 + b"0" + b"}" * 33)


@pytest.mark.parametrize("text", [b"", b"{", b"NaN", b"[Infinity]", b"\xff", b"1" * 5_000, b"{'a': 1}", b"nul"])
def test_what_is_no_json_is_refused(text: bytes) -> None:
    with pytest.raises(RecordError):
        json_in(text)


@given(st.binary(max_size=200) | st.text(max_size=200))
def test_any_bytes_are_a_value_or_a_refusal(text: bytes | str) -> None:
    with suppress(RecordError):
        json_in(text)
