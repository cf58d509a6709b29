"""FlexiDump: prints what arrives, one line for each sample: `NAME TYPE TIME: DATA`.

    [components.show]
    type = "FlexiDump"
    params.inputs = ["TimedPose2D"]
    params.names = ["pose"]

Every sample is read; with `rate_limit` some are not printed, and their number is logged at the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from aiorts import InPort, Param
from aiorts.errors import ConfigurationError, InvalidNameError, RecordError
from aiorts.system import LineStream
from aiorts.types import has_tm, path_type, type_name
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, Option
from aiorts_flexi.common.ports import named_types
from aiorts_flexi.common.text import FORMATS, full_path, line_of, news_of


class FlexiDump(FlexiComponent):
    """Prints the samples of its in-ports, `input0..` or named by `names`, to standard output.

    While standard output takes no more, it waits, and with it the other members of its context, but no other context;
    when the reader of standard output has gone, it goes to error with BrokenPipeError.
    """

    inputs: tuple[str, ...] = Param((), type=tuple[str, ...], doc="types of the in-ports")
    names: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc='names of the in-ports; "" or missing: input0, input1, ...'
    )
    format = Param("text", choices=FORMATS, doc="text: NAME TYPE TIME: DATA; json, csv; values: data only")
    rate_limit = Param(0.0, ge=0.0, unit="Hz", doc="lines in a second for each port at the most; 0 is all")
    rate_clock = Param("kernel", choices=("kernel", "tm"), doc="whose seconds: the kernel's, or those of the samples")
    fields: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc="field paths to show, such as position.x; none shows all"
    )

    stamp = Param("tm", choices=("tm", "arrival"), doc="TIME of a line: the sample's own, or when it was taken here")

    interface: ClassVar[str] = "in: `input0`, `input1`, ..., or `names`"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-p", "--port"), "inputs", "repeat", "type of an in-port; repeat for more", required=True),
        Option(("-n", "--port-names"), "names", "text", "names of the in-ports, separated by commas"),
        Option(("-v", "--verbosity"), "verbosity", "number", "-1 shows that data came and not what; 1 logs the ports"),
        Option(("--format",), "format", "text", "text (default), json, csv or values"),
        Option(("--rate-limit",), "rate_limit", "number", "lines in a second for each port at the most"),
        Option(("--rate-clock",), "rate_clock", "text", "whose seconds: kernel (default) or tm"),
        Option(("--field",), "fields", "repeat", "a field path to show, such as position.x; repeat for more"),
        Option(("--stamp",), "stamp", "text", "TIME of a line: tm (default) or arrival"),
        TYPE_MODULES,
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._stream = LineStream()
        self._printed_last: dict[str, int] = {}
        self._hidden = 0

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, InPort[Any]]:
        named = named_types(self.name, values["inputs"], values["names"])
        return {name: self._input(name, cls, values["fields"]) for name, cls in named.items()}

    def _input(self, name: str, cls: type[Any], fields: Sequence[str]) -> InPort[Any]:
        for path in fields:
            try:
                path_type(cls, full_path(cls, path))
            except (RecordError, InvalidNameError) as error:
                raise ConfigurationError(f"{self.name}.{name}: fields: {error}") from None
        return InPort(cls)

    def on_activated(self) -> None:
        self._printed_last.clear()
        self._hidden = 0

    async def on_execute(self) -> None:
        lines: list[str] = []
        for port in self.ports.values():
            if not isinstance(port, InPort):
                continue
            lines += [self._line(port.name, sample) for sample in port.drain() if self._is_due(port.name, sample)]
        if lines:
            await self._stream.write(lines)

    def _line(self, port: str, sample: Any) -> str:
        arrived = self.clock.time_ns() if self.stamp == "arrival" else None
        name = type_name(type(sample))
        if self.verbosity < 0:
            return news_of(port, name, sample, arrived)
        return line_of(self.format, port, name, sample, self.fields, arrived)

    def on_deactivated(self) -> None:
        if self._hidden:
            self.log.info("%d samples were not shown (rate_limit = %g Hz)", self._hidden, self.rate_limit)

    def _is_due(self, port: str, sample: Any) -> bool:
        if self.rate_limit == 0.0:
            return True
        by_sample = self.rate_clock == "tm" and has_tm(type(sample))
        now = int(sample.tm) if by_sample else self.clock.monotonic_ns()
        last = self._printed_last.get(port)
        # A time that jumps back begins a new interval: a recording may be played twice.
        if last is not None and 0 <= now - last < 1e9 / self.rate_limit:
            self._hidden += 1
            return False
        self._printed_last[port] = now
        return True
