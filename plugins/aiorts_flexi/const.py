"""FlexiConst: sends constants at its own rate, every so many seconds, or as fast as the readers take them.

    [components.speed]
    type = "FlexiConst"
    params.outputs = ["TimedVelocity2D"]
    params.constants = ['{"vx": 0.3}']
    params.rate = 20.0

The rate is the component's, not its context's: samples are sent by a task of its own at t0 + n / rate of the kernel's
clock, in any context; t0 is the activation. A moment that passes while a reader holds up the last sample is skipped,
and the number of skipped moments is logged at the end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, ClassVar, Final

from aiorts import OutPort, Param
from aiorts.errors import ConfigurationError, WiringError
from aiorts.types import has_tm
from aiorts_flexi.common.base import FlexiComponent
from aiorts_flexi.common.constant import sample_of
from aiorts_flexi.common.options import TYPE_MODULES, VERBOSITY, Option
from aiorts_flexi.common.ports import parse_port, parse_type
from aiorts_flexi.common.sending import Parcel, Sender

_LONGEST_SLEEP_NS: Final = 1_000_000_000
"""A change of parameters takes effect within this time."""
_AT_ONCE: Final = 8
"""Continuous samples between two turns of the loop: the default length of a connector's buffer."""
_UNHINDERED: Final = 1024
"""Continuous samples without waiting after which a pause lets simulated time and other components go on."""
_PAUSE: Final = 0.001


class Orders:
    """The samples to send, and their period; replaced by a new object when parameters change."""

    __slots__ = ("parcels", "period")

    def __init__(self, parcels: list[Parcel], period: Fraction | None) -> None:
        self.parcels = parcels
        self.period = period
        """Nanoseconds from one sample to the next; None: each is sent as soon as there is room."""

    def equal(self, parcels: list[Parcel], period: Fraction | None) -> bool:
        """Whether these are the same samples and period; `repr` compares samples, as arrays have no truth value."""
        return self.period == period and repr(self.parcels) == repr(parcels)


class FlexiConst(FlexiComponent):
    """Sends a constant, given as a literal, from each of its out-ports, stamped by the kernel's clock.

    Constants, rate and ports may change while it runs. After `count` samples of each port it finishes.
    """

    outputs: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc="types of the out-ports: TYPE, or TYPE:LEN for a sequence of that length"
    )
    constants: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc="one literal for each out-port, JSON or Python: data only, or fields by name"
    )
    names: tuple[str, ...] = Param(
        (), type=tuple[str, ...], doc='names of the out-ports; "" or missing: output, or output0, output1, ...'
    )
    rate: float | None = Param(
        None, type=float | None, gt=0.0, le=1e6, unit="Hz", doc="samples in a second; 1 when nothing else is given"
    )
    seconds = Param(0.0, ge=0.0, le=1e9, unit="s", doc="from one sample to the next, in place of a rate; 0 is the rate")
    continuous = Param(False, doc="as fast as the readers take them; connect them with full = block")
    count = Param(0, ge=0, doc="finish after so many samples of each port; 0 is never")

    interface: ClassVar[str] = "out: `output`, with several `output0`, `output1`, ..., or `names`"
    options: ClassVar[tuple[Option, ...]] = (
        Option(("-p", "--port"), "outputs", "repeat", "type of an out-port; repeat with -c for more", required=True),
        Option(("-c", "--const"), "constants", "repeat", "its constant, a JSON or Python literal", required=True),
        Option(("-m", *TYPE_MODULES.flags), TYPE_MODULES.param, TYPE_MODULES.kind, TYPE_MODULES.help),
        Option(("-r", "--rate"), "rate", "number", "samples in a second (default 1)"),
        Option(("-s", "--seconds"), "seconds", "number", "seconds from one sample to the next, in place of a rate"),
        Option(("--continuous",), "continuous", "flag", "as fast as the reader takes them"),
        Option(("--count",), "count", "number", "end after so many samples of each port; 0 is never"),
        Option(("--port-names",), "names", "text", "names of the out-ports, separated by commas"),
        VERBOSITY,
    )

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self._task: asyncio.Task[None] | None = None
        self._active_in = 0
        self._sender = Sender()
        self._orders: Orders | None = None

    def ports_for(self, values: Mapping[str, Any]) -> Mapping[str, OutPort[Any]]:
        return {
            name: OutPort(cls, stamp="write" if has_tm(cls) else None) for name, (cls, _) in self._named(values).items()
        }

    def check_configuration(self, values: Mapping[str, Any]) -> Callable[[], None]:
        named = self._named(values)
        return self.taking(self._use, list(named), self._samples(named, values["constants"]), self._period_ns(values))

    def _use(self, names: list[str], samples: list[Any], period: Fraction | None) -> None:
        parcels: list[Parcel] = [(self.out_port(name), sample) for name, sample in zip(names, samples, strict=True)]
        if self._orders is None or not self._orders.equal(parcels, period):
            self._orders = Orders(parcels, period)

    def on_initialize(self) -> None:
        super().on_initialize()
        if self.verbosity >= 2 and self._orders is not None:
            sent = [f"{port.name} sends {sample!r}" for port, sample in self._orders.parcels]
            self.log.info("constants: %s", ", ".join(sent))

    async def on_activated(self) -> None:
        self._active_in += 1
        if self._task is None:
            self._task = asyncio.create_task(self._send_all(), name=f"{self.name} sends")

    async def on_deactivated(self) -> None:
        self._active_in -= 1
        task = self._task
        if task is None or self._active_in > 0:
            return
        self._task = None
        if task.done():
            return  # its failure is the reason of the deactivation
        task.cancel()
        await asyncio.wait([task])
        if not task.cancelled() and (error := task.exception()) is not None:
            raise error

    # -- the samples -----------------------------------------------------------------------------------------------

    def _named(self, values: Mapping[str, Any]) -> dict[str, tuple[type, int]]:
        """Type and sequence length of each port by its name."""
        outputs, given = values["outputs"], values["names"]
        if not outputs:
            raise ConfigurationError(f"{self.name}.outputs: expected the type of at least one out-port")
        if len(given) > len(outputs):
            raise ConfigurationError(
                f"{self.name}: {_many(len(given), 'name')} for {_many(len(outputs), 'out-port')}; "
                "give at most one for each"
            )
        named: dict[str, tuple[type, int]] = {}
        for number, text in enumerate(outputs):
            usual = "output" if len(outputs) == 1 else f"output{number}"
            name = (given[number] if number < len(given) else "") or usual
            if name in named:
                raise WiringError(f"{self.name}.{name}: there is a port of that name already")
            named[name] = _type(text, f"output{number}")
        return named

    def _samples(self, named: Mapping[str, tuple[type, int]], constants: Sequence[str]) -> list[Any]:
        if len(constants) != len(named):
            raise ConfigurationError(
                f"{self.name}: {_many(len(constants), 'constant')} for {_many(len(named), 'out-port')}; "
                "give one for each"
            )
        return [
            sample_of(cls, text, f"constant {number}", length)
            for number, ((cls, length), text) in enumerate(zip(named.values(), constants, strict=True))
        ]

    def _period_ns(self, values: Mapping[str, Any]) -> Fraction | None:
        """Nanoseconds from one sample to the next, exactly; None sends whenever there is room."""
        rate, seconds, continuous = values["rate"], values["seconds"], values["continuous"]
        if (rate is not None) + (seconds != 0.0) + continuous > 1:
            raise ConfigurationError(f"{self.name}: rate, seconds and continuous exclude each other; give one of them")
        if continuous:
            return None
        return Fraction(10**9) * (Fraction(seconds) if seconds else 1 / Fraction(1 if rate is None else rate))

    async def _send_all(self) -> None:
        sent, skipped = 0, 0
        while not self._is_enough(sent):
            orders = self._orders
            assert orders is not None  # noqa: S101 - the configuration is in force since it was made
            if orders.period is None:
                sent = await self._send_continuously(orders, sent)
            else:
                sent, missed = await self._send_periodically(orders, orders.period, sent)
                skipped += missed
        if skipped:
            self.log.info("%d samples were skipped: the readers had no room in time", skipped)
        self.finish()

    def _is_enough(self, sent: int) -> bool:
        return 0 < self.count <= sent

    # -- when ------------------------------------------------------------------------------------------------------

    async def _send_periodically(self, orders: Orders, period: Fraction, sent: int) -> tuple[int, int]:
        clock = self.clock
        start, number, skipped = clock.monotonic_ns(), 0, 0
        while not self._is_enough(sent):
            due = start + -(-number * period.numerator // period.denominator)
            while (left := due - clock.monotonic_ns()) > 0:
                await self.sleep(min(left, _LONGEST_SLEEP_NS) / 1e9)
                if self._orders is not orders:
                    return sent, skipped
            await self._sender.send(orders.parcels)
            sent += 1
            number += 1
            if self._is_enough(sent) or self._orders is not orders:
                break
            latest = (clock.monotonic_ns() - start) * period.denominator // period.numerator
            if latest > number:
                skipped += latest - number
                number = latest
        return sent, skipped

    async def _send_continuously(self, orders: Orders, sent: int) -> int:
        unhindered = 0
        while not self._is_enough(sent) and self._orders is orders:
            unhindered = unhindered + 1 if await self._sender.send(orders.parcels) else 0
            sent += 1
            if unhindered >= _UNHINDERED:
                unhindered = 0
                await self.sleep(_PAUSE)
            elif unhindered % _AT_ONCE == 0:
                await asyncio.sleep(0)
        return sent


def _type(text: str, name: str) -> tuple[type, int]:
    """The type of a port, and the length that its sequence must have; 0 is any length."""
    if ":" not in text:
        return parse_type(text, name), 0
    spec = parse_port(text, name)
    return spec.type, spec.length


def _many(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"
