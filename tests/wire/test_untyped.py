"""A tool without the class decodes what a link carries by the text of its layout, and believes nothing else of it."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import UTC, datetime
from enum import Enum, IntEnum
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import WireError
from aiorts.testing.invented import invent, record_types
from aiorts.types import Acceleration2D, PointCloud, RecordArray, TimedDouble, TimedNDArray, record
from aiorts.wire import LINK, MsgpackCodec, layout_text, untyped_decoder
from campaign import cases
from each import each

CODEC = MsgpackCodec(LINK)
TYPES = sorted(record_types(), key=lambda cls: cls.__name__)


class Gear(IntEnum):
    FIRST = 1
    REVERSE = -1


class Colour(Enum):
    RED = "red"


@record
class Odd:
    """What the types of the house do not have."""

    gear: Gear
    colour: Colour
    mode: Literal["fast", "slow"]
    level: Literal[1, 2]
    when: datetime
    pair: tuple[int, str]
    absent: float | None = None


@dataclass
class Numbers:
    """Packed would be possible, but a mutable dataclass is not."""

    x: float = 0.0
    n: int = 0


@dataclass
class Holder:
    """Mutable, with others in it."""

    one: Numbers
    many: list[Numbers] = field(default_factory=list)


def plain(value: Any) -> Any:
    """The reference: what a value is without its class."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, RecordArray):
        return value.array
    if is_dataclass(value):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(one) for one in value]
    if isinstance(value, datetime):
        return round((value - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds()) * 1_000_000_000
    return value


def same(left: Any, right: Any) -> bool:
    if isinstance(left, np.ndarray) or isinstance(right, np.ndarray):
        return len(left) == len(right) == 0 or (left.dtype == right.dtype and left.tobytes() == right.tobytes())
    if isinstance(left, dict):
        return list(left) == list(right) and all(same(left[name], right[name]) for name in left)
    if isinstance(left, list):
        return len(left) == len(right) and all(map(same, left, right))
    return type(left) is type(right) and (left == right or left != left)


def untyped(sample: Any) -> Any:
    head, parts = CODEC.encode_parts(sample)
    return untyped_decoder(layout_text(type(sample)))(head, parts)


@pytest.mark.slow
@each(TYPES)
def test_every_type_is_decoded_without_its_class(cls: type) -> None:
    dice = random.Random(cls.__name__)
    for _ in range(3):
        sample = invent(cls, dice)
        assert same(untyped(sample), plain(sample)), (untyped(sample), plain(sample))


@pytest.mark.parametrize(
    "sample",
    [
        Odd(Gear.REVERSE, Colour.RED, "slow", 2, datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC), (3, "text")),
        Odd(Gear.FIRST, Colour.RED, "fast", 1, datetime(2000, 1, 1, tzinfo=UTC), (3, "text"), 1.5),
        Numbers(1.5, 7),
        Holder(Numbers(0.5, 1), [Numbers(1.5, 2), Numbers()]),
        TimedNDArray(data=np.arange(40_000, dtype="f4").reshape(200, 200)),
        *(True, 7, 1.5, "text", b"bytes", bytes(20_000)),
    ],
    ids=lambda sample: type(sample).__name__,
)
def test_other_values_are_decoded_without_their_class(sample: Any) -> None:
    assert same(untyped(sample), plain(sample)), untyped(sample)


def test_the_layout_says_whether_records_of_numbers_are_packed() -> None:
    said = {cls: json.loads(layout_text(cls))["x-frame"] for cls in (Acceleration2D, TimedDouble, Numbers, PointCloud)}
    assert said == {Acceleration2D: "packed", TimedDouble: "packed", Numbers: "positions", PointCloud: "positions"}


def test_a_name_in_a_layout_is_text_and_nothing_else() -> None:
    name = "x'); import os; os._exit(3)\n#\""
    document = json.loads(layout_text(Numbers))
    document["prefixItems"][1]["const"] = name
    document["prefixItems"][2]["properties"] = {name: {"type": "number"}, "__class__": {"type": "integer"}}
    assert untyped_decoder(json.dumps(document))(b"\x92\xcb" + bytes(8) + b"\x07", ()) == {name: 0.0, "__class__": 7}
    with pytest.raises(WireError):
        untyped_decoder(json.dumps(document))(b"\x91\x07", ())


@pytest.mark.parametrize(
    "layout",
    ["", "[]", "{}", "null", "7", '{"prefixItems": "abc"}', "[" * 100_000, '{"prefixItems": [1, 2, 3], "x-frame": []}'],
)
def test_a_text_that_is_no_layout_is_refused(layout: str) -> None:
    with pytest.raises(WireError):
        untyped_decoder(layout)


@pytest.mark.parametrize("word", ["anyOf", "items", "properties", "prefixItems"])
@pytest.mark.parametrize("lies", ["packed", "positions"])
def test_a_layout_without_end_is_refused(word: str, lies: str) -> None:
    value: Any = {"type": "number", "x-number": "f64"}
    for _ in range(200):
        inside = {"anyOf": [value, value], "items": value, "properties": {"x": value}, "prefixItems": [value]}
        value = {word: inside[word]}
        if word == "anyOf":
            value[word][1] = {"type": "null"}
    document = {"x-frame": lies, "prefixItems": [{"const": 1}, {"const": "Deep"}, value]}
    with pytest.raises(WireError):
        untyped_decoder(json.dumps(document))


_WORDS = [
    "x-frame",
    "const",
    "type",
    "x-number",
    "contentEncoding",
    "anyOf",
    "enum",
    "x-names",
    "x-array",
    "properties",
]
_NAMES = st.sampled_from([*_WORDS, "prefixItems", "items", "additionalProperties", "a"])
_ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["number", "binary", "packed", "f64"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_NAMES, inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.slow
@settings(max_examples=cases(10_000), deadline=None)
@given(
    st.sampled_from(["packed", "positions"]), _ANY, st.binary(max_size=64), st.lists(st.binary(max_size=9), max_size=2)
)
def test_whatever_a_layout_and_a_frame_say_is_refused_or_decoded(
    lies: str, value: Any, head: bytes, parts: list[bytes]
) -> None:
    document = {"x-frame": lies, "prefixItems": [{"const": 1}, {"const": "Any"}, value]}
    with suppress(WireError):
        untyped_decoder(json.dumps(document))(head, [memoryview(part) for part in parts])


@settings(max_examples=cases(10_000), deadline=None)
@given(st.sampled_from(TYPES), st.data())
def test_a_changed_frame_is_refused_or_decoded(cls: type, data: Any) -> None:
    head, parts = CODEC.encode_parts(invent(cls, random.Random(7)))
    changed = bytearray(head)
    for place in data.draw(st.lists(st.integers(0, max(len(head) - 1, 0)), max_size=4)):
        if changed:
            changed[place] = data.draw(st.integers(0, 255))
    with suppress(WireError):
        untyped_decoder(layout_text(cls))(bytes(changed), parts)
