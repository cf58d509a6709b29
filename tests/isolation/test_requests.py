"""Requests and answers between a kernel and its processes carry plain values, and bytes as they are."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from aiorts.isolation.messages import asked, done, request, value_of

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text() | st.binary(max_size=50),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


@given(VALUES)
def test_values_and_bytes_come_as_they_were_sent(value: Any) -> None:
    assert value_of(done(value)) == value
    assert asked(request("give", {"state": value})) == ("give", {"state": value})


def test_bytes_take_as_much_as_they_are() -> None:
    assert len(done([bytes(1 << 20)] * 3)) < (3 << 20) + 1_000
