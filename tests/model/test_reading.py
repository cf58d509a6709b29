"""What `plain` wrote is read back as it was; of anything else the path is named, and nothing but that comes out."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any, ClassVar, Literal, Optional

import pytest
from hypothesis import HealthCheck, given, settings

from aiorts.errors import DeclarationError, LimitError, RecordError
from aiorts.model.plain import plain
from aiorts.model.reading import PlainLimits, from_plain
from campaign import cases
from plain_parts import JSON, MSGPACK, values


class Colour(Enum):
    RED = "red"
    BLUE = 2


class Level(IntEnum):
    LOW = 1


@dataclass(frozen=True)
class Port:
    name: str
    shape: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Rail:
    length: float
    ends: tuple[str, str] = ("", "")


@dataclass(frozen=True)
class Box:
    """One field of each kind that is read."""

    kind: ClassVar[str] = "box"
    name: str
    count: int
    open: bool
    rate: float | None
    colour: Colour
    ports: tuple[Port, ...] = ()
    by_size: Mapping[int, Mapping[str, Port]] = field(default_factory=dict)
    pair: tuple[int, str] = (0, "")
    either: Port | Rail | None = None
    word: Literal["a", "b", 3] = "a"
    level: Level = Level.LOW
    anything: Any = None
    inner: Optional[Box] = None  # noqa: UP045 - the other spelling
    mixed: Colour | Literal["a"] | None = None


@dataclass(frozen=True)
class Positive:
    value: int

    def __post_init__(self) -> None:
        if self.value <= 0:
            raise ValueError(f"value = {self.value}: expected a positive number")


def refused(kind: type[Any], data: object, limits: PlainLimits) -> str:
    """The message when the data are refused; empty when a value of the class comes out, as it should."""
    try:
        read = from_plain(kind, data, limits=limits, unknown={})
    except (RecordError, LimitError) as error:
        return str(error)
    assert type(read) is kind
    return ""


FULL: dict[str, Any] = {
    "name": "b",
    "count": 1,
    "open": True,
    "rate": 2.0,
    "colour": "red",
    "ports": [{"name": "p", "shape": [1, 2]}, {"name": "q"}],
    "by_size": {"-4": {"x y": {"name": "r"}}},
    "either": {"length": 1, "ends": ["a", "b"]},
}


@pytest.mark.slow(kept_by="test_lists_become_tuples_and_objects_are_read_only")
@settings(max_examples=cases(2_000), suppress_health_check=[HealthCheck.too_slow])
@given(values(Box))
def test_what_was_written_is_read_back(box: Box) -> None:
    assert from_plain(Box, plain(box)) == box
    assert from_plain(Box, json.loads(json.dumps(plain(box), allow_nan=False))) == box


def test_lists_become_tuples_and_objects_are_read_only() -> None:
    box = from_plain(Box, FULL | {"anything": {"a": [1, {"b": []}]}})
    assert box.ports == (Port("p", (1, 2)), Port("q"))
    assert box.by_size == {-4: {"x y": Port("r")}}
    assert box.either == Rail(1.0, ("a", "b"))
    assert box.anything == {"a": (1, {"b": ()})}
    for mapping in (box.by_size, box.by_size[-4], box.anything, box.anything["a"][1]):
        with pytest.raises(TypeError):
            mapping["new"] = 1
    assert from_plain(tuple[int, ...], [1, 2]) == (1, 2)  # type: ignore[arg-type,comparison-overlap]


def test_numbers_that_json_has_no_word_for_are_texts() -> None:
    assert from_plain(Rail, {"length": "-Infinity"}) == Rail(-math.inf)
    assert math.isnan(from_plain(Rail, {"length": "NaN"}).length)
    assert (
        json.dumps(plain(from_plain(Rail, {"length": 2**63 - 1})))
        == '{"length": 9223372036854775807, "ends": ["", ""]}'
    )
    with pytest.raises(RecordError, match="length: expected a number that a float holds, got "):
        from_plain(Rail, {"length": 10**400})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": 1}, "name: expected text, got 1"),
        ({"count": True}, "count: expected a whole number, got True"),
        ({"count": 1.0}, "count: expected a whole number, got 1.0"),
        ({"open": 1}, "open: expected true or false, got 1"),
        ({"rate": "fast"}, "rate: expected a number, got 'fast'"),
        ({"rate": True}, "rate: expected a number or null, got True"),
        ({"colour": "green"}, "colour: expected 'red', 2, got 'green'"),
        ({"colour": []}, "colour: expected 'red', 2, got a list"),
        ({"level": True}, "level: expected 1, got True"),
        ({"word": "c"}, "word: expected 'a', 'b', 3, got 'c'"),
        ({"ports": {}}, "ports: expected a list, got an object"),
        ({"ports": [{"name": "p"}, 5]}, "ports[1]: expected an object (Port), got 5"),
        ({"ports": [{"name": "p", "shape": [1, "x"]}]}, "ports[0].shape[1]: expected a whole number, got 'x'"),
        ({"ports": [{"shape": []}]}, "ports[0].name: is missing"),
        ({"by_size": {"04": {}}}, "by_size.04: expected a whole number as the key, got '04'"),
        ({"by_size": {"4": {}, 4: {}}}, "by_size: two keys mean the same"),
        ({"by_size": {"4": {"x y": {"name": None}}}}, "by_size.4['x y'].name: expected text, got null"),
        ({"pair": [1]}, "pair: expected a list of 2, got a list"),
        ({"pair": [1, 2]}, "pair[1]: expected text, got 2"),
        ({"either": {"length": None}}, "either.length: expected a number, got null"),
        ({"either": 7}, "either: expected Port or Rail or null, got 7"),
        ({"inner": {"name": "i"}}, "inner.count: is missing"),
        ({"anything": {1: 2}}, "anything[1]: expected text, got 1"),
        ({3: 4}, "[3]: expected text, got 3"),
    ],
)
def test_what_is_wrong_is_named_by_its_path(change: dict[Any, Any], message: str) -> None:
    with pytest.raises(RecordError, match=re.escape(message)) as caught:
        from_plain(Box, FULL | change)
    assert str(caught.value) == message


def test_the_outermost_value_goes_by_its_class() -> None:
    with pytest.raises(RecordError, match=r"^Box: expected an object \(Box\), got a list$"):
        from_plain(Box, [1])


def test_a_check_of_the_class_itself_is_told_with_the_path() -> None:
    with pytest.raises(RecordError, match=r"^Positive: value = 0: expected a positive number$"):
        from_plain(Positive, {"value": 0})


def test_unknown_keys_are_kept_by_path_and_otherwise_left_out() -> None:
    data = FULL | {"later": [1], "ports": [{"name": "p", "colour": {"a": 1}}]}
    unknown: dict[str, Any] = {}
    assert from_plain(Box, data, unknown=unknown).ports == (Port("p"),)
    assert unknown == {"later": [1], "ports[0].colour": {"a": 1}}
    assert from_plain(Box, data).ports == (Port("p"),)


def test_unknown_keys_whose_paths_are_cut_short_are_all_kept() -> None:
    unknown: dict[str, Any] = {}
    from_plain(Port, {"name": "p"} | {"k" * 1000 + str(number): number for number in range(5)}, unknown=unknown)
    assert sorted(unknown.values()) == [0, 1, 2, 3, 4]
    assert max(map(len, unknown)) < 100


@pytest.mark.parametrize(
    ("data", "limits", "message"),
    [
        (FULL, PlainLimits(depth=2), "ports[0]: nested deeper than 2 levels"),
        (FULL | {"anything": [[[[]]]]}, PlainLimits(depth=4), "anything[0][0][0]: nested deeper than 4 levels"),
        (FULL | {"anything": [0] * 90}, PlainLimits(values=99), "anything: more than 99 values in all"),
        (FULL | {"name": "n" * 9}, PlainLimits(text=8), "name: text of length 9; at most 8"),
        (FULL | {"anything": {"n" * 9: 1}}, PlainLimits(text=8), "anything.nnnnnnnnn: text of length 9; at most 8"),
        (FULL | {"anything": b"n" * 9}, PlainLimits(text=8), "anything: bytes of length 9; at most 8"),
    ],
)
def test_what_is_too_much_is_refused(data: object, limits: PlainLimits, message: str) -> None:
    with pytest.raises(LimitError, match=re.escape(message)):
        from_plain(Box, data, limits=limits)


def test_unknown_keys_far_inside_use_up_the_values() -> None:
    """Their paths are long: few bytes shall not become many."""
    data: Any = {str(number): 0 for number in range(100)}
    for _ in range(20):
        data = {"name": "b", "inner": data}
    with pytest.raises(LimitError, match="more than 2000 values in all"):
        from_plain(Box, data, limits=PlainLimits(values=2000), unknown={})


def test_depth_of_hostile_data_ends_in_a_clean_error() -> None:
    data: Any = []
    for _ in range(100_000):
        data = [data]
    with pytest.raises(LimitError, match="deeper than 100 levels"):
        from_plain(Box, FULL | {"anything": data}, limits=PlainLimits(depth=100))


@pytest.mark.parametrize("name", Box.__dataclass_fields__)
def test_messages_of_huge_or_strange_values_are_short(name: str) -> None:
    huge = "x" * 10**6
    for value in (10**5000, -(10**5000), huge, [huge] * 10**5, {huge: 1}, 1e400, "\ud800", b"\xff", {1}, object()):
        assert len(refused(Box, FULL | {name: value}, PlainLimits()).encode()) < 400


@pytest.mark.slow(kept_by="test_messages_of_huge_or_strange_values_are_short")
@settings(max_examples=cases(5_000))
@given(JSON | MSGPACK, MSGPACK)
def test_whatever_comes_a_value_or_a_clean_error_comes_out(whole: Any, part: Any) -> None:
    for kind in (Box, Positive, Rail):
        with_fields = [FULL | {name: part} for name in Box.__dataclass_fields__]
        for data in (whole, part, {"value": part, "length": part, "ends": part}, *with_fields):
            text = refused(kind, data, PlainLimits(depth=4, values=200, text=100))
            assert len(text.encode()) < 4_000


@pytest.mark.parametrize("limit", [0, -1, True, 2.0, 2**40])
@pytest.mark.parametrize("name", ["depth", "values", "text"])
def test_limits_are_whole_numbers_in_bounds(name: str, limit: Any) -> None:
    with pytest.raises(ValueError, match=f"PlainLimits.{name}: expected an integer"):
        PlainLimits(**{name: limit})


def test_annotations_that_cannot_be_read_are_refused_at_once() -> None:
    @dataclass(frozen=True)
    class Heap:
        items: list[int]

    @dataclass(frozen=True)
    class Made:
        now: int = field(init=False, default=1)

    @dataclass(frozen=True)
    class Unclear:
        both: Any

    Heap.__annotations__["items"] = list[int]
    Made.__annotations__["now"] = int
    Unclear.__annotations__["both"] = Port | Mapping[str, int]
    for kind, message in ((Heap, "list"), (Made, "now: is not read"), (Unclear, "nothing says which")):
        with pytest.raises(DeclarationError, match=message):
            from_plain(kind, {})
