"""FlexiFilter: pins of in-ports to pins of out-ports, converted, scaled and shifted as its map says.

    [components.units]
    type = "FlexiFilter"
    params.inputs = ["TimedDoubleSeq:2"]
    params.outputs = ["TimedLong"]
    params.map = "0:1>1000>0"          # metres to millimetres: pin 1 of input0, times 1000, is output0

Every sample that arrives is used: n samples in one in-port make n samples out, whatever context runs it.
"""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar

from aiorts import InPort, OutPort, Param
from aiorts.errors import ConfigurationError
from aiorts_flexi.base import FlexiComponent
from aiorts_flexi.mapping import COMBINE, Mapping, Rules
from aiorts_flexi.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.ports import parse_port
from aiorts_flexi.sending import Sender
from aiorts_flexi.table import map_table

__all__ = ("FlexiFilter",)


class FlexiFilter(FlexiComponent):
    """Maps pins of `input0..` to pins of `output0..`; see `aiorts_flexi.grammar` for the language of the map.

    Its ports are made when it is created and stay; the rules may change while it runs.
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

        A sample that cannot be converted ends it with status 1: the lines after it are not processed.
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
        """The map as a table that people can read; no component is made.

        Raises:
            ConfigurationError: what creating it would raise; a TypedTextError has the place.
        """
        draft = cls("filter")
        for name, value in draft.params.check(params).items():
            setattr(draft, name, value)
        draft._check_given()
        text, *rules = draft._settings()
        return map_table(draft.inputs, draft.outputs, text, Rules(*rules))

    def on_initialize(self) -> None:
        self._sender = Sender()
        self.make_ports()
        self.tell_ports()
        if self.verbosity >= 1:
            text, *rules = self._settings()
            self.log.info("map:\n%s", map_table(self.inputs, self.outputs, text, Rules(*rules)))

    def make_ports(self) -> None:
        self._check_given()
        self._in_specs = [parse_port(text, f"input{number}") for number, text in enumerate(self.inputs)]
        self._out_specs = [parse_port(text, f"output{number}") for number, text in enumerate(self.outputs)]
        self._remake()
        self._in_ports: list[InPort[Any]] = [self.add_port(s.name, InPort(s.type)) for s in self._in_specs]
        self._out_ports: dict[str, OutPort[Any]] = {
            s.name: self.add_port(s.name, OutPort(s.type)) for s in self._out_specs
        }

    def on_activated(self) -> None:
        self._waiting: list[deque[Any]] = [deque() for _ in self._in_ports]
        self._remake()

    async def on_execute(self) -> None:
        if self._settings() != self._made_of:
            self._remake()
        for waiting, port in zip(self._waiting, self._in_ports, strict=True):
            waiting.extend(port.drain())
        while samples := {number: waiting.popleft() for number, waiting in enumerate(self._waiting) if waiting}:
            made = self._mapping.apply(samples, self.clock.time_ns())
            await self._sender.send([(self._out_ports[name], sample) for name, sample in made])

    def _check_given(self) -> None:
        for what, given in (("inputs", self.inputs), ("outputs", self.outputs)):
            if not given:
                raise ConfigurationError(f"{self.name}.{what}: expected at least one port")

    def _settings(self) -> tuple[Any, ...]:
        rules = (self.rounding, self.overflow, self.reset, self.clamp, self.nan, self.combine, self.time, self.zero_old)
        return self.map, *rules

    def _remake(self) -> None:
        text, *rules = self._made_of = self._settings()
        self._mapping = Mapping(self._in_specs, self._out_specs, text, Rules(*rules))
