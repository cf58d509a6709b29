"""Components that the tests of configuration share."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, ClassVar

from aiorts import Component, InPort, OutPort, Param
from aiorts.events import Event
from aiorts.types import TimedLong

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from aiorts import Kernel


def even(value: int) -> None:
    if value % 2:
        raise ValueError("must be even")


class Arm(Component):
    """Two gains that must not cross, sets of them, and a count with a validator."""

    low = Param(1.0, ge=0.0, unit="N/m")
    high = Param(2.0, le=100.0, unit="N/m")
    mode = Param("slow", choices=("slow", "fast"))
    count = Param(4, validator=even)
    configurations: ClassVar = {"stiff": {"low": 10.0, "high": 20.0}, "fast": {"mode": "fast"}}

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[tuple[float, float]] = []
        self.pause = 0.0

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["low"] > values["high"]:
            raise ValueError(f"low {values['low']} is above high {values['high']}")

    async def on_execute(self) -> None:
        low = self.low
        if self.pause:
            await asyncio.sleep(self.pause)
        self.seen.append((low, self.high))


class Many(Component):
    """As many in-ports as its parameter says."""

    inputs = Param(1, ge=0, le=8)
    unit = Param("m")
    out = OutPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.got: dict[str, list[int]] = {}

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        return {f"in{number}": InPort(TimedLong, unit=values["unit"]) for number in range(values["inputs"])}

    def on_execute(self) -> None:
        for name, port in self.ports.items():
            if isinstance(port, InPort):
                self.got.setdefault(name, []).extend(sample.data for sample in port.drain())


class Source(Component):
    out = OutPort(TimedLong, unit="m")


def hear(kernel: Kernel, *kinds: type[Event]) -> list[Any]:
    """What the bus tells of these kinds from now on."""
    heard: list[Any] = []
    add: Callable[[Event], None] = heard.append
    for kind in kinds or (Event,):
        kernel.bus.subscribe(kind, add)
    return heard
