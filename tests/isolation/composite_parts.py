"""Composites that run in processes of their own. Not a test module: a process imports it."""

from __future__ import annotations

import os

from aiorts import Component, InPort, OutPort, Param
from aiorts.composites import Composite
from aiorts.types import TimedLong


class Stage(Component):
    """Adds to what it reads; ends its process for -3, raises for other numbers below 0."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)
    plus: int = Param(1)

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            if sample.data == -3:
                os._exit(3)
            if sample.data < 0:
                raise ValueError(f"{self.name}: negative")
            self.out.write_nowait(TimedLong(sample.tm, sample.data + self.plus))


class Pair(Composite):
    """Two stages, one behind the other."""

    def __init__(self, name: str = "") -> None:
        super().__init__(
            name,
            Stage("first"),
            Stage("second"),
            exported={"first.inp": "inp", "second.out": "out"},
        )

    async def on_initialize(self) -> None:
        first, second = self.members
        await self.kernel.connect(first.out, second.inp)


class Neighbours(Composite):
    """Two stages that know nothing of each other; one goes on when the other fails."""

    def __init__(self, name: str = "") -> None:
        super().__init__(
            name,
            Stage("first"),
            Stage("second"),
            exported={"*.inp": "{component}_inp", "*.out": "{component}_out"},
            errors="isolate",
        )
