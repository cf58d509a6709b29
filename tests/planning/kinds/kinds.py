"""A component with a parameter of each kind, in a file of its own: system files of tests name it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedDouble


class Colour(Enum):
    """Of a parameter."""

    RED = "r"
    BLUE = 2


class Kinds(Component):
    """Parameters of each kind."""

    out = OutPort(TimedDouble)
    inp = InPort(TimedDouble, length=20)
    flag: bool = Param(False)
    size: int = Param(3)
    gain: float = Param(1.0)
    text: str = Param("usual")
    colour: Colour = Param(Colour.RED)
    names: tuple[str, ...] = Param(("usual",), type=tuple[str, ...])
    pair: tuple[int, float] = Param((1, 2.0), type=tuple[int, float])
    table: Mapping[str, float] = Param({"a": 1.0}, type=Mapping[str, float])
    maybe: float | None = Param(1.0, type=float | None)
