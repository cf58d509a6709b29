"""FlexiDupe: copies every sample of an in-port to each of its out-ports, unchanged.

    [components.twice]
    type = "FlexiDupe"
    params.inputs = ["TimedDouble:2", "TimedPose2D:3"]    # input0 to output0_0 and output0_1, input1 to ...

An out-port can have many connectors; this component is for systems that connect ports by their names.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from aiorts import InPort, OutPort, Param
from aiorts.errors import ConfigurationError
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.common.ports import parse_counted
from aiorts_flexi.common.sending import Parcel, Sender


class FlexiDupe(FlexiComponent):
    """Copies each sample of `input0` to `output0_0`, `output0_1`, ..., of `input1` to `output1_0`, ...

    A reader with full = block delays the others no longer than one write to it lasts: readers with room get a sample at
    once, the others are waited for together.
    """

    inputs: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc="TYPE:N for each in-port: its type and how many out-ports it is copied to"
    )

    interface: ClassVar[str] = "in: `input<i>`; out: `output<i>_0`, ..., `output<i>_<N-1>`"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-p", "--port"), "inputs", "repeat", "TYPE:N, an in-port and its number of out-ports", required=True),
        Option(("-f", "--config-file"), "", "text", "rtc.conf of the original: accepted and not read"),
        TYPE_MODULES,
        VERBOSITY,
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._sender = Sender()

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        ports: dict[str, InPort[Any] | OutPort[Any]] = {}
        for number, (cls, copies) in enumerate(self._counted(values)):
            ports[f"input{number}"] = InPort(cls)
            ports.update({f"output{number}_{copy}": OutPort(cls) for copy in range(copies)})
        return ports

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        return self.taking(self._use, self._counted(values))

    def _counted(self, values: Mapping[str, Any]) -> list[tuple[type, int]]:
        if not values["inputs"]:
            raise ConfigurationError(f"{self.name}.inputs: expected at least one TYPE:N")
        return [parse_counted(text, f"input{number}") for number, text in enumerate(values["inputs"])]

    def _use(self, counted: list[tuple[type, int]]) -> None:
        self._routes = [
            (self.in_port(f"input{number}"), [self.out_port(f"output{number}_{copy}") for copy in range(copies)])
            for number, (_, copies) in enumerate(counted)
        ]

    async def on_execute(self) -> None:
        waiting = [(deque(source.drain()), targets) for source, targets in self._routes]
        while True:
            parcels: list[Parcel] = []
            for samples, targets in waiting:
                if samples:
                    sample = samples.popleft()
                    parcels += [(target, sample) for target in targets]
            if not parcels:
                return
            await self._sender.send(parcels)
