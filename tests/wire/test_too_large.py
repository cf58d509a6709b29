"""What is said of a type beforehand is what a frame refuses of its samples."""

from __future__ import annotations

from typing import Any

import pytest

import aiorts.types as t
from aiorts.errors import LimitError
from aiorts.types import Map, Seq, record
from aiorts.types.ros import JointState, PointCloud2
from aiorts.wire import LINK, MsgpackCodec, excess


@record
class Note:
    """A record with a text, within others."""

    text: str | None = None


@record
class Notes:
    """A record with records, texts and a map."""

    tm: int = 0
    notes: Seq[Note] = ()  # type: ignore[assignment]
    more: Map = {}  # type: ignore[assignment]  # noqa: RUF012 - `record` copies it


TEXT, LISTS = "a text above 1 MiB", "65,536 values or more"


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        (str, TEXT),
        (float, ""),
        (t.TimedDouble, ""),
        (t.TimedPose2D, ""),
        (t.TimedDoubleSeq, ""),
        (t.TimedString, TEXT),
        (t.TimedStringSeq, f"{TEXT} or {LISTS}"),
        (Note, TEXT),
        (Notes, f"{TEXT} or {LISTS}"),
        (JointState, f"{TEXT} or {LISTS}"),
        (PointCloud2, f"{TEXT} or {LISTS}"),
    ],
)
def test_what_may_be_refused_is_known_from_the_type(cls: type, said: str) -> None:
    assert excess(cls) == said


@pytest.mark.parametrize(
    "large",
    [
        t.TimedString(0, "y" * 1_048_577),
        t.TimedStringSeq(0, ("a",) * 65_536),
        Notes(0, [Note("y" * 1_048_577)]),
        Notes(0, (), dict.fromkeys(map(str, range(65_536)), 1)),
    ],
)
def test_a_sample_that_a_frame_refuses_is_of_a_type_of_which_that_is_said(large: Any) -> None:
    with pytest.raises(LimitError):
        MsgpackCodec().encode(large)
    assert excess(type(large))


def test_a_link_takes_fewer_values() -> None:
    assert excess(t.TimedStringSeq, LINK) == f"{TEXT} or 4,096 values or more"
