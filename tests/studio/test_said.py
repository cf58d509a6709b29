"""What pages say of events, in words that the server makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts_studio.watching.feeds import happening
from aiorts_studio.watching.words import event_said


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (
            {"component": "wave", "parameter": "gain", "old": 3.0, "new": 2.5, "set": "default"},
            "gain: 3.0 → 2.5, set default",
        ),
        (
            {
                "component": "wave",
                "set": "fast",
                "old": [["gain", 3.0], ["on", True]],
                "new": [["gain", 2.5], ["on", True]],
            },
            "fast: gain = 2.5",
        ),
        ({"component": "wave", "values": [["gain", 2.5], ["name", "a, b"]]}, "gain = 2.5, name = a, b"),
        ({"component": "wave", "old": None, "new": [["gain", 2]], "set": "fast"}, "fast: gain = 2"),
        ({"component": "wave", "old": "default", "new": "fast"}, "default → fast"),
        ({"component": "wave", "context": "main", "old": "inactive", "new": "active"}, "main: inactive → active"),
        ({"context": "main", "skipped": 3, "late_ns": 12_345_678, "blame": {"who": "x"}}, "skipped 3, late 12.3 ms"),
        ({"component": "wave", "error": None, "text": "old 1, new 2"}, "text old 1, new 2"),
        ({"component": "wave"}, ""),
    ],
)
def test_an_event_is_said_in_words(event: Mapping[str, Any], said: str) -> None:
    assert event_said(event) == said


def test_an_event_leads_to_its_component_or_its_context() -> None:
    late = happening("here", "Overrun", {"context": "main", "skipped": 1}, 5)
    assert (late["component"], late["context"], late["text"]) == ("", "main", "skipped 1")
    port = happening("here", "PortAdded", {"path": "wave.out"}, 5)
    assert (port["component"], port["context"]) == ("wave", "")


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(
    st.dictionaries(st.sampled_from(["component", "old", "new", "values", "late_ns", "set", "x"]) | st.text(), _VALUES)
)
def test_no_event_is_beyond_words(event: dict[str, Any]) -> None:
    assert isinstance(event_said(event), str)
