"""FlexiFilter: sends pins of in-ports to pins of out-ports, converted, scaled and shifted as its map says.

    [components.units]
    type = "FlexiFilter"
    params.inputs = ["TimedDoubleSeq:2"]
    params.outputs = ["TimedLong"]
    params.map = "0:1>1000>0"          # metres to millimetres: pin 1 of input0, times 1000, is output0

Every sample that arrives is used: n samples in one in-port make n samples out, in any context.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from collections.abc import Mapping as AnyMapping
from typing import Any, ClassVar, Final, TypeAlias

from aiorts import InPort, OutPort, Param
from aiorts.errors import ConfigurationError, ConversionError
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.common.ports import PortSpec, parse_port
from aiorts_flexi.common.sending import Sender
from aiorts_flexi.mapping.mapping import COMBINE, Mapping, Rules
from aiorts_flexi.mapping.table import map_table

Values: TypeAlias = AnyMapping[str, Any]
_RULES: Final = ("rounding", "overflow", "reset", "clamp", "nan", "combine", "time", "zero_old")


class FlexiFilter(FlexiComponent):
    """Maps pins of `input0..` to pins of `output0..`; see `aiorts_flexi.mapping.grammar` for the language of the map.

    Ports, map and rules may change while it runs: ports that stay lose no sample, and a change with an error is refused
    whole.
    """

    inputs: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc="types of input0, input1, ...: TYPE, or TYPE:LEN for a sequence"
    )
    outputs: tuple[str, ...] = Param((), type=tuple[str, ...], doc="types of output0, output1, ...")
    map = Param("0>0", doc="entries in[:pin] > [mult[off] >] out[:pin], separated by commas")
    rounding = Param(
        "nearest", choices=("nearest", "truncate", "floor"), doc="fraction to integer; nearest: halves to even"
    )
    overflow = Param("error", choices=("error", "saturate", "wrap"), doc="a number that the pin cannot hold")
    reset = Param("", doc='value of pins without new data; "" keeps their last one')
    zero_old = Param(False, doc="pins without new data become 0, False or no text")
    clamp: tuple[float, ...] = Param((), type=tuple[float, ...], doc="LO, HI: limits of every number")
    nan = Param("pass", doc='"pass", "error" or a number to put in its place')
    combine = Param("", choices=COMBINE, doc='several entries to one pin; "" is an error')
    time = Param("oldest", choices=("oldest", "newest"), doc="time of a sample: of the oldest or newest of its sources")

    interface: ClassVar[str] = "in: `input0`, `input1`, ...; out: `output0`, `output1`, ..."
    help_text: ClassVar[str] = """
        A map is a list of entries in[:pin] > [mult[off] >] out[:pin]. Pins count the items of a sequence from 0, or
        name a field of a record; number the ports from 0.

        \b
          -m "0>1000>0"      input0, times 1000, to output0: metres to millimetres
          -m "0>1.8+32>0"    input0 times 1.8 plus 32: Celsius to Fahrenheit
          -m "0:2>0,1>1:3"   item 2 of input0 to output0, input1 to item 3 of output1

        A line that cannot be converted is reported with its number, like any bad line, and the others go on; status 1.
        """
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-i", "--inputport"), "inputs", "repeat", "an in-port: TYPE, or TYPE:LEN of a sequence", required=True),
        Option(("-o", "--outputport"), "outputs", "repeat", "an out-port, likewise", required=True),
        Option(("-m", "--map"), "map", "text", "in[:pin]>[mult[off]>]out[:pin],... (default 0>0)"),
        Option(("-n", "--newesttime"), "time", "flag", "stamp with the newest source, not the oldest", "newest"),
        Option(("-z", "--zeroold"), "zero_old", "flag", "pins without new data become 0, False or no text"),
        VERBOSITY,
        Option(("--reset",), "reset", "text", "pins without new data become this value"),
        Option(("--combine",), "combine", "text", "several entries to one pin: sum, min, max or newest"),
        Option(
            ("--round",), "rounding", "text", "fraction to integer: nearest (default; halves to even), truncate, floor"
        ),
        Option(("--overflow",), "overflow", "text", "out of range: error (default), saturate or wrap"),
        Option(("--clamp",), "clamp", "text", "LO,HI: limits of every number"),
        Option(("--nan",), "nan", "text", "pass (default), error or a number in its place"),
        Option(("--check",), "", "flag", "print the map as a table and run nothing", action="table"),
        TYPE_MODULES,
    )

    @classmethod
    def table(cls, **params: object) -> str:
        """The map as a table for people; no component is made.

        Raises:
            ConfigurationError: the error that its creation would raise; a TypedTextError has the place.
        """
        draft = cls("filter")
        values = {**draft.configuration.values, **draft.params.check(params)}
        draft._specs(values)
        return map_table(values["inputs"], values["outputs"], values["map"], draft._rules(values))

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._sender = Sender()
        self._made_of: tuple[Any, ...] = ()
        self._mapping: Mapping
        self._in_ports: list[InPort[Any]] = []
        self._waiting: list[deque[Any]] = []
        self._refused: Callable[[str, int, str], None] | None = None
        self._taken: Counter[int] = Counter()

    def skip_bad(self, notify: Callable[[str, int, str], None]) -> None:
        """From now on leave out samples that cannot be converted; `notify` gets in-port, number from 1, and reason.

        For a source that feeds the in-ports one after the other, such as a filter of lines.
        """
        self._refused = notify
        self._taken.clear()

    def ports_for(self, values: Values) -> Values:
        ins, outs = self._specs(values)
        return {**{spec.name: InPort(spec.type) for spec in ins}, **{spec.name: OutPort(spec.type) for spec in outs}}

    def check_configuration(self, values: Values) -> Callable[[], None]:
        ins, outs = self._specs(values)
        made_of = tuple(values[name] for name in ("inputs", "outputs", "map", *_RULES))
        # A mapping that stays as it was keeps the last value of each pin.
        same = made_of == self._made_of
        mapping = self._mapping if same else Mapping(ins, outs, values["map"], self._rules(values))
        return self.taking(self._use, ins, outs, mapping, made_of)

    def _specs(self, values: Values) -> tuple[list[PortSpec], list[PortSpec]]:
        for what in ("inputs", "outputs"):
            if not values[what]:
                raise ConfigurationError(f"{self.name}.{what}: expected at least one port")
        ins = [parse_port(text, f"input{number}") for number, text in enumerate(values["inputs"])]
        return ins, [parse_port(text, f"output{number}") for number, text in enumerate(values["outputs"])]

    def _rules(self, values: Values) -> Rules:
        return Rules(*(values[rule] for rule in _RULES))

    def _use(self, ins: list[PortSpec], outs: list[PortSpec], mapping: Mapping, made_of: tuple[Any, ...]) -> None:
        before = dict(zip(self._in_ports, self._waiting, strict=True))
        self._mapping, self._made_of = mapping, made_of
        self._in_ports = [self.in_port(spec.name) for spec in ins]
        self._out_ports = {spec.name: self.out_port(spec.name) for spec in outs}
        # Samples that were taken from a port that stays, but not sent yet, are sent by the new map.
        self._waiting = [before.get(port, deque()) for port in self._in_ports]

    def on_initialize(self) -> None:
        super().on_initialize()
        if self.verbosity >= 1:
            rules = self._rules(self.configuration.values)
            self.log.info("map:\n%s", map_table(self.inputs, self.outputs, self.map, rules))

    def on_activated(self) -> None:
        for waiting in self._waiting:
            waiting.clear()
        self._mapping.clear()

    async def on_execute(self) -> None:
        for waiting, port in zip(self._waiting, self._in_ports, strict=True):
            waiting.extend(port.drain())
        while samples := {number: waiting.popleft() for number, waiting in enumerate(self._waiting) if waiting}:
            for number in samples if self._refused is not None else ():
                self._taken[number] += 1
            try:
                made = self._mapping.apply(samples, self.clock.time_ns())
            except ConversionError as error:
                if self._refused is None:
                    raise
                number = min(samples)
                self._refused(self._in_ports[number].name, self._taken[number], str(error))
                continue
            await self._sender.send([(self._out_ports[name], sample) for name, sample in made])
