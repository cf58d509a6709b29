"""Both ends of a link mean the same by a type, or the first difference is named."""

from __future__ import annotations

import json
from dataclasses import make_dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts.links.layout import difference, layout_of
from aiorts.types import TimedLong, TimedVelocity2D


def kind(name: str, **fields: Any) -> Any:
    made = make_dataclass(name, list(fields.items()), frozen=True)
    made.__module__ = "robot"
    return made


def text(cls: Any) -> str:
    return layout_of(cls)[1]


@pytest.mark.parametrize(
    ("theirs", "ours", "said"),
    [
        (kind("Pose", x=float), kind("Pose", x=float, y=float), "has no field 'y' at the writer"),
        (kind("Pose", x=float, z=float), kind("Pose", x=float), "has no field 'z' at the reader"),
        (kind("Pose", x=int), kind("Pose", x=float), "x is of another kind"),
        (kind("Pose", x=float, y=float), kind("Pose", y=float, x=float), "are in another order"),
        (kind("Pose", x=float), kind("Position", x=float), "the writer sends 'robot.Pose', the reader takes"),
    ],
)
def test_the_first_difference_is_named(theirs: Any, ours: Any, said: str) -> None:
    assert layout_of(theirs)[0] != layout_of(ours)[0]
    assert said in difference(text(theirs), text(ours))


def test_equal_types_have_equal_hashes_of_16_bytes() -> None:
    assert layout_of(TimedLong) == layout_of(TimedLong)
    assert len(layout_of(TimedLong)[0]) == 16
    assert difference(text(TimedVelocity2D), text(TimedVelocity2D)) == ""


@pytest.mark.parametrize(
    "name", ["'); import os; ('", 'a"b', "line\nbreak", "{x.__class__}", "%s", "\\u0000", "x" * 5_000]
)
def test_a_name_that_looks_like_code_is_only_shown(name: str) -> None:
    document = json.loads(text(TimedLong))
    document["prefixItems"][2]["properties"][name] = {"type": "integer"}
    said = difference(json.dumps(document), text(TimedLong))
    assert "at the reader" in said
    assert len(said) < 200
    assert "\n" not in said


@pytest.mark.slow
@given(
    st.recursive(
        st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
    )
)
def test_any_document_of_a_peer_is_a_difference(document: Any) -> None:
    assert difference(json.dumps(document), text(TimedLong))


@pytest.mark.parametrize("junk", ["", "{", "[" * 100_000, "null", "\x00"])
def test_what_is_no_document_is_a_difference(junk: str) -> None:
    assert difference(junk, text(TimedLong))
