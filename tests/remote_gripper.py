"""A component for kernels of other processes, which read this file alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong


class Gripper(Component):
    """Multiplies whole numbers; -1 makes it fail, and a closed one does not begin."""

    inp = InPort(TimedLong, length=10_000)
    force = OutPort(TimedLong)
    factor: int = Param(2, ge=0)
    stuck: bool = Param(False)
    configurations: ClassVar[Mapping[str, Mapping[str, object]]] = {"large": {"factor": 1000}}
    on_link_lost = "deactivate"

    async def on_activated(self) -> None:
        if self.stuck:
            raise RuntimeError("is stuck")

    async def on_execute(self) -> None:
        for sample in self.inp.drain():
            if sample.data == -1:
                raise RuntimeError("lost its grip")
            if sample.data == -2:
                self.finish()
            self.force.write_nowait(TimedLong(sample.tm, sample.data * self.factor))

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["factor"] == 13:
            raise ValueError("13 is no factor")


class Keeper(Component):
    """A source that never ends: nor does the run."""

    out = OutPort(TimedLong)
