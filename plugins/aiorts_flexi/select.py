"""FlexiSelect: passes on one of several in-ports, which another in-port selects.

    [components.switch]
    type = "FlexiSelect"
    params.port = "TimedVelocity2D:2"        # input0, input1 -> output
    params.selection_type = "TimedBoolean"   # the type of `selection`: any integer or truth value

With `order = "cycle"` every selection that has arrived is applied before any sample of the same cycle, so the last one
decides for all of them. With `order = "tm"` the samples and selections of a cycle are taken in the order of their time
stamps, a selection before the samples of its own moment. Samples of inputs that are not selected are read and dropped
in every cycle, so that no old sample is sent later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

from aiorts import InPort, OutPort, Param
from aiorts.errors import AiortsError, ConfigurationError, ConversionError
from aiorts.types import convert, has_tm, type_name
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.common.ports import PortSpec, parse_counted, parse_port

_SELECTING = ("i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "bool")
_NONE = -1


class SelectionError(AiortsError, LookupError):
    """A selection names an input that does not exist."""

    code = "E-SELECT"


class FlexiSelect(FlexiComponent):
    """Sends the samples of the selected one of `input0`, ... from `output`, unchanged.

    The selection lasts: after a reset or a new activation the last valid one is in force. Inputs may be added and
    removed while it runs; when the selected one is removed, `initial` is selected.
    """

    port = Param("", doc="TYPE:N, the type and how many in-ports to select from")
    selection_type = Param("TimedShort", doc="type of `selection`: an integer or truth value")
    initial = Param(0, ge=0, doc="what is selected until a selection arrives")
    out_of_range = Param(
        "error",
        choices=("error", "hold", "none"),
        doc="a selection that there is no input for: error, hold keeps the last one, none sends nothing until the next",
    )
    order = Param("cycle", choices=("cycle", "tm"), doc="selections first in each cycle, or by time stamp")
    feedback = Param(False, doc="an out-port `selected` sends each selection that comes into force")

    interface: ClassVar[str] = "in: `selection`, `input0`, ..., `input<N-1>`; out: `output`, with `feedback` `selected`"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-p", "--port"), "port", "text", "TYPE:N, the type and number of in-ports", required=True),
        Option(("--selection-type",), "selection_type", "text", "type of the in-port selection (default TimedShort)"),
        Option(("--initial",), "initial", "number", "selected until a selection arrives (default 0)"),
        Option(("--out-of-range",), "out_of_range", "text", "error, hold or none"),
        Option(("--order",), "order", "text", "cycle: selections first; tm: by time stamp"),
        Option(("--feedback",), "feedback", "flag", "an out-port `selected` says what is selected"),
        TYPE_MODULES,
        VERBOSITY,
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._chosen = self.initial
        self._initial = True
        """Whether no selection has arrived since the component was made."""

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any] | OutPort[Any]]:
        cls, count, spec = self._specs(values)
        ports: dict[str, InPort[Any] | OutPort[Any]] = {"selection": InPort(spec.type)}
        ports.update({f"input{number}": InPort(cls) for number in range(count)})
        ports["output"] = OutPort(cls)
        return {**ports, "selected": OutPort(spec.type)} if values["feedback"] else ports

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        cls, count, spec = self._specs(values)
        for name, kind in (("selection", spec.type), ("input0", cls)):
            if values["order"] == "tm" and not has_tm(kind):
                raise ConfigurationError(
                    f"{self.name}.order = 'tm': {name} has samples of {type_name(kind)}, which have no time"
                )
        if values["feedback"]:
            self._fitting(values["initial"], spec.element)
        return self.taking(self._use, count, spec)

    def _specs(self, values: Mapping[str, Any]) -> tuple[type, int, PortSpec]:
        cls, count = parse_counted(values["port"], "port")
        text, initial = values["selection_type"], values["initial"]
        spec = parse_port(text, "selection_type")
        if spec.shape != "scalar" or spec.element not in _SELECTING:
            raise ConfigurationError(
                f"{self.name}.selection_type = {text!r}: expected an integer or a truth value "
                "such as TimedShort, TimedBoolean or int"
            )
        if initial >= count:
            raise ConfigurationError(
                f"{self.name}.initial = {initial}: expected 0..{count - 1}; there are {count} inputs"
            )
        return cls, count, spec

    def _use(self, count: int, spec: PortSpec) -> None:
        self._selecting = self.in_port("selection")
        self._inputs = [self.in_port(f"input{number}") for number in range(count)]
        self._output = self.out_port("output")
        self._selected = self.out_port("selected") if self.feedback else None
        self._plain, self._element = spec.plain, spec.element
        if self._initial or self._chosen >= count:
            self._chosen = self.initial

    async def on_activated(self) -> None:
        await self._report()

    async def on_execute(self) -> None:
        refused: SelectionError | None = None
        for number, sample in self._arrivals():
            if number < 0:
                try:
                    changed = self._select(sample if self._plain else sample.data)
                except SelectionError as error:
                    refused = refused or error  # good samples go first: they were taken, and would be lost
                    continue
                if changed:
                    await self._report()
            elif number == self._chosen:
                await self._output.write(sample)
        if refused is not None:
            raise refused

    def _arrivals(self) -> Iterator[tuple[int, Any]]:
        """The samples of this cycle, ordered by the parameter `order`; a selection has the number -1."""
        found = [(_NONE, sample) for sample in self._selecting.drain()]
        for number, port in enumerate(self._inputs):
            found += [(number, sample) for sample in port.drain()]
        if self.order == "tm":
            found.sort(key=lambda one: int(one[1].tm))  # stable: selections first, each port in its own order
        return iter(found)

    def _select(self, value: int) -> bool:
        """Apply a selection, or refuse it and keep the old one; return whether anything changed."""
        number, before = int(value), self._chosen
        if 0 <= number < len(self._inputs):
            self._chosen, self._initial = number, False
            if self.verbosity >= 1 and number != before:
                self.log.info("selected input%d", number)
        elif self.out_of_range == "error":
            raise SelectionError(
                f"{self._selecting.path}: expected a selection 0..{len(self._inputs) - 1}, got {number}; "
                f"{'nothing' if before < 0 else f'input{before}'} stays selected"
            )
        elif self.out_of_range == "none":
            self._chosen, self._initial = _NONE, False
        else:
            self.log.warning("selection %d is not in 0..%d; the last one is held", number, len(self._inputs) - 1)
        return self._chosen != before

    async def _report(self) -> None:
        port = self._selected
        if port is None or self._chosen < 0:
            return
        value = self._fitting(self._chosen, self._element)
        if self._plain:
            await port.write(value)
        elif has_tm(port.type):
            await port.write(port.type(self.clock.time_ns(), value))
        else:
            await port.write(port.type(value))

    def _fitting(self, number: int, element: str) -> Any:
        try:
            return convert(number, element)
        except ConversionError as error:
            raise ConfigurationError(f"{self.name}.initial = {number}: `selected` cannot say so: {error}") from None
