"""The map as people read it: `--check` prints this."""

from __future__ import annotations

import pytest

from aiorts.errors import ConfigurationError
from aiorts_flexi.common.place import TypedTextError
from aiorts_flexi.mapping.filter import FlexiFilter
from aiorts_flexi.mapping.mapping import Rules
from aiorts_flexi.mapping.table import map_table


def test_the_map_of_the_paper() -> None:
    made = map_table(
        ["TimedFloatSeq:2", "TimedString", "TimedLong"],
        ["TimedStringSeq:4", "TimedFloat"],
        "2>0:2,0:1>0.1>0:3,0:1>1",
    )
    assert made.splitlines() == [
        "from      factor  to         value",
        "input2            output0:2  i32 -> str",
        "input0:1  x 0.1   output0:3  f32 -> str",
        "input0:1          output1    f32 -> f32",
    ]


def test_factors_offsets_and_fields() -> None:
    made = map_table(
        ["TimedPose2D"], ["TimedLong"] * 2, "0:position.x>1000-5>0, 0:heading>-1e-3+2>1", Rules(rounding="floor")
    )
    assert [line.split("  ")[0] for line in made.splitlines()[1:]] == ["input0:position.x", "input0:heading"]
    assert "x 1000 - 5" in made
    assert "x -0.001 + 2" in made


def test_the_component_gives_the_table_from_what_a_command_line_has() -> None:
    made = FlexiFilter.table(inputs=["TimedDouble"], outputs="TimedLong, TimedLong", map="0>1", clamp="-1, 1")
    assert made.splitlines()[1] == "input0          output1  f64 -> i32"
    for params, said in (
        ({"inputs": ["TimedDouble"]}, "outputs: expected at least one port"),
        ({"inputs": ["TimedDouble"], "outputs": ["TimedLong"], "nan": "x"}, "nan"),
        ({"inputs": ["TimedDouble"], "outputs": ["TimedLong"], "mapp": "x"}, "did you mean map"),
        ({"inputs": ["TimedDouble"] * 2, "outputs": ["TimedLong"], "map": "0>0,1>0"}, "feed one pin"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            FlexiFilter.table(**params)


@pytest.mark.parametrize(
    ("inputs", "text", "marked"),
    [
        (["TimedLong"], "garbage", "garbage\n^"),
        (["TimedLong"], "0>0,0>garbage", "0>0,0>garbage\n      ^"),
        (["TimedLong:3"], "0>0", "TimedLong:3\n         ^"),
        (["TimedLong"], "0>0,3>0:1", "0>0,3>0:1\n    ^"),
    ],
)
def test_a_mistake_is_marked(inputs: list[str], text: str, marked: str) -> None:
    with pytest.raises(TypedTextError) as caught:
        map_table(inputs, ["TimedLongSeq:2"], text)
    assert caught.value.marked() == marked
