"""What a form needs to know: limits of parameters, and types of what methods take."""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import pytest

from aiorts import Component, Goal, Param, Provided
from aiorts.types import TimedDouble
from control_parts import WAIT, controlled, with_client


class Side(enum.Enum):
    LEFT = "l"
    RIGHT = "r"


@dataclass(frozen=True)
class Point:
    x: float
    y: float = 0.0


class Arm(Protocol):
    def move(self, to: Point, speed: float = 1.0, *, side: Side | None = None) -> float: ...
    def turn(self, angles: list[int], how: Literal["soft", "hard"], limits: Mapping[str, float]) -> Side: ...
    def stamp(self, sample: TimedDouble, file: Path, pair: tuple[int, str], anything: Any) -> Point: ...
    async def drive(self, metres: int) -> Goal[float, str]: ...


class Robot(Component):
    """Has parameters with limits of their own."""

    arm = Provided[Arm]()
    pose: tuple[float, float] = Param((0.0, 0.0), constraint="0<=x<=1, x>-2")
    gains: dict[str, float] = Param({"p": 1.0, "i": 0.0}, constraint="{p: x>=0, i: 0<=x<=5}")
    rate: float = Param(1.0, ge=0.0)

    def move(self, to: Point, speed: float = 1.0, *, side: Side | None = None) -> float:
        return to.x * speed

    def turn(self, angles: list[int], how: Literal["soft", "hard"], limits: Mapping[str, float]) -> Side:
        return Side.LEFT

    def stamp(self, sample: TimedDouble, file: Path, pair: tuple[int, str], anything: Any) -> Point:
        return Point(sample.data)

    async def drive(self, metres: int) -> Goal[float, str]:
        return Goal()


@pytest.mark.anyio
async def test_the_limits_of_elements_and_keys_are_in_the_report() -> None:
    async with controlled("limits") as kernel:
        await kernel.create(Robot, "robot0")
        found = await with_client("limits", lambda client: client.call("part", WAIT, components=["robot0"]))
    params = found["components"]["robot0"]["params"]
    free = dict.fromkeys(("ge", "gt", "le", "lt", "choices", "pattern"))
    assert params["pose"]["elements"] == [free | {"ge": 0.0, "le": 1.0}, free | {"gt": -2.0}]
    assert params["gains"]["keys"] == {"p": free | {"ge": 0.0}, "i": free | {"ge": 0.0, "le": 5.0}}
    assert (params["rate"]["elements"], params["rate"]["keys"], params["rate"]["ge"]) == (None, None, 0.0)


@pytest.mark.anyio
async def test_the_methods_of_a_service_port_say_their_types_as_schemas() -> None:
    async with controlled("forms") as kernel:
        await kernel.create(Robot, "robot0")
        found = await with_client("forms", lambda client: client.call("interfaces", WAIT, port="robot0.arm"))
    (only,) = found.values()
    assert (only["type"], only["polarity"]) == ("Arm", "provided")
    assert list(only["methods"]) == ["move", "turn", "stamp", "drive"]

    def schemas(method: str) -> dict[str, Any]:
        return {name: json.loads(text) for name, text in only["methods"][method]["parameters"].items()}

    move, turn, stamp = schemas("move"), schemas("turn"), schemas("stamp")
    assert only["methods"]["move"]["required"] == ["to"]
    assert (move["to"]["properties"]["x"]["type"], move["to"]["required"]) == ("number", ["x"])
    assert move["speed"] == {"type": "number", "default": 1.0}
    assert move["side"] == {"anyOf": [{"enum": ["LEFT", "RIGHT"]}, {"type": "null"}]}
    assert turn["angles"] == {"type": "array", "items": {"type": "integer"}}
    assert turn["how"] == {"enum": ["soft", "hard"]}
    assert turn["limits"] == {"type": "object", "additionalProperties": {"type": "number"}}
    assert set(stamp["sample"]["properties"]) == {"tm", "data"}
    assert stamp["file"] == {"type": "string", "format": "path"}
    assert stamp["pair"]["prefixItems"] == [{"type": "integer"}, {"type": "string"}]
    assert stamp["anything"] == {}
    answers = {name: json.loads(one["returns"]) for name, one in only["methods"].items()}
    assert answers["move"]["anyOf"][0] == {"type": "number"}
    assert answers["turn"] == {"enum": ["l", "r"]}
    assert answers["drive"] == {"type": "string"}
    assert only["methods"]["drive"]["feedback"] is not None
    assert only["methods"]["move"]["feedback"] is None
