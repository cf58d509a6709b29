"""FlexiAdd: adds the samples of its in-ports, member by member: motor schemas, biases, fused forces.

    [components.steer]
    type = "FlexiAdd"
    params.port = "TimedVelocity2D:2"     # input0 + input1 -> output

With `wait = "last"` each sample that arrives makes a sum with the last samples of the other inputs; an input without
a sample since the activation counts as zero. With `wait = "all"` a sum takes one new sample of each input; samples
without a partner wait in their connectors, within each connector's length and full policy.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from aiorts import InPort, OutPort, Param
from aiorts.types import has_tm
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.common.ports import parse_counted
from aiorts_flexi.summing import Summation


class FlexiAdd(FlexiComponent):
    """Adds the samples of `input0`, ... and sends the sum from `output`.

    Two sequences of different lengths, and a sum that its field cannot hold, are errors that name input and field.
    """

    port = Param("", doc="TYPE:N, the type and how many in-ports are added")
    wait = Param("last", choices=("last", "all"), doc="use the last known of each input, or wait for one of all")
    overflow = Param("error", choices=("error", "saturate", "wrap"), doc="a sum that its field cannot hold")
    time = Param("newest", choices=("newest", "oldest"), doc="time of a sum: of its newest or its oldest sample")

    interface: ClassVar[str] = "in: `input0`, ..., `input<N-1>`; out: `output`"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-p", "--port"), "port", "text", "TYPE:N, the type and number of in-ports", required=True),
        Option(("--wait",), "wait", "text", "last: with the last known of each input; all: one of each"),
        Option(("--overflow",), "overflow", "text", "error, saturate or wrap"),
        Option(("--time",), "time", "text", "newest or oldest"),
        TYPE_MODULES,
        VERBOSITY,
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._type: type = object
        self._last: dict[int, Any] = {}

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        cls, count = parse_counted(values["port"], "port")
        return {**{f"input{number}": InPort(cls) for number in range(count)}, "output": OutPort(cls)}

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        cls, count = parse_counted(values["port"], "port")
        return self.taking(self._use, cls, count, Summation(cls, values["overflow"]))

    def _use(self, cls: type, count: int, summation: Summation) -> None:
        # An input that stays counts with its last sample; a removed input counts no more.
        self._last = {number: sample for number, sample in self._last.items() if number < count and cls is self._type}
        self._type, self._sum = cls, summation
        self._inputs = [self.in_port(f"input{number}") for number in range(count)]
        self._output = self.out_port("output")

    def on_activated(self) -> None:
        self._last.clear()

    @property
    def in_line_order(self) -> bool:
        return self.wait != "all"  # "all" leaves samples without a partner, and makes the same sums in any order

    async def on_execute(self) -> None:
        if self.wait == "all":
            while all(port.is_new for port in self._inputs):
                self._last = {number: port.read_nowait() for number, port in enumerate(self._inputs)}
                await self._send_sum()
            return
        waiting = [deque(port.drain()) for port in self._inputs]
        while any(waiting):
            self._last.update({number: samples.popleft() for number, samples in enumerate(waiting) if samples})
            await self._send_sum()

    async def _send_sum(self) -> None:
        numbers = sorted(self._last)
        samples = [self._last[number] for number in numbers]
        tm = 0
        if has_tm(self._type):
            tm = (max if self.time == "newest" else min)(int(sample.tm) for sample in samples)
        await self._output.write(self._sum(samples, [f"input{number}" for number in numbers], tm))
