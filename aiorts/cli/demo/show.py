"""Run the demo: motor, controller, a FlexiFilter and a gauge, live and again in virtual time.

Every printed figure is counted or measured in this run.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from shutil import get_terminal_size

from aiorts import Component, Context, InPort, Kernel, PeriodicContext, exits, run
from aiorts.cli.demo.chart import Strip
from aiorts.cli.demo.motor import RATE, Control, Motor, Steps
from aiorts.testing import simulate
from aiorts.types import TimedLong

_TARGETS = (150.0, 250.0)
"""Target speeds in rad/s, each for a second; then follows a second with a load."""
_SECONDS = 3.0
_LOAD = 3.0
_LINE_EVERY = 0.1
_RPM = 9.5493
_MOST = 3000.0

_NEXT = """\
Three commands to go on with:

  aiorts demo --save motor              the same as files: components, system file, tests
  aiorts run motor/system.toml          run it, with Ctrl-C or --set control.gain=0.5 as you like
  aiorts inspect motor/motor.py:Control what a component is, without running it"""


class Gauge(Component):
    """Keeps every speed it gets."""

    rpm = InPort(TimedLong)

    def on_activated(self) -> None:
        self.speeds: list[int] = []
        self.stamps: list[int] = []

    async def on_execute(self) -> None:
        for sample in self.rpm.drain():
            self.speeds.append(sample.data)
            self.stamps.append(sample.tm)


@dataclass
class _Result:
    """The measurements of one run; times in seconds."""

    speeds: list[int] = field(default_factory=list)
    ledger: tuple[int, int, int, int] = (0, 0, 0, 0)
    """The counts written, delivered, dropped, buffered."""
    cycles: int = 0
    overruns: int = 0
    lateness_mean: float = 0.0
    lateness_max: float = 0.0
    balanced: bool = True


def show(say: Callable[[str], None]) -> int:
    """Run the demo and print it line by line; returns 0 when its promises were kept, else 1."""
    width = get_terminal_size((80, 24)).columns
    say(f"A motor and its controller, {RATE:g} cycles a second, live ({_SECONDS:g} s):")
    say(f"{'s':>4} {'rpm':>5}  0{'rpm':>{max(8, min(width, 80) - 20)}} {_MOST:g}")
    live = run(lambda: _session(say, Strip(_MOST, min(width, 80) - 14)))
    written, delivered, dropped, buffered = live.ledger
    say("")
    say(
        f"{written} samples were written: {delivered} delivered + {dropped} dropped + {buffered} waiting"
        f"{' = all of them.' if live.balanced else ': the ledger does NOT balance.'}"
    )
    say(
        f"{live.cycles} cycles began {live.lateness_mean * 1e6:.0f} us late on average, "
        f"{live.lateness_max * 1e3:.2f} ms at worst on this machine; {live.overruns} took too long."
    )
    began = time.perf_counter()
    first = simulate(_session(None, None))
    took = time.perf_counter() - began
    same = simulate(_session(None, None)).speeds == first.speeds
    say(
        f"The same {_SECONDS:g} s in virtual time took {took:.2f} s, and a second time gave "
        f"{'the same' if same else 'OTHER'} {len(first.speeds)} values."
    )
    say("")
    say(_NEXT)
    return exits.DONE if live.balanced and same and first.balanced else exits.FAILED


async def _session(say: Callable[[str], None] | None, strip: Strip | None) -> _Result:
    result = _Result()
    async with Kernel() as kernel:
        motor, control = await kernel.create(Motor), await kernel.create(Control)
        steps = await kernel.create(Steps, targets=_TARGETS)
        gauge = await kernel.create(Gauge)
        convert = await kernel.create("FlexiFilter", inputs=["TimedDouble"], outputs=["TimedLong"], map=f"0>{_RPM}>0")
        await kernel.connect(steps.target, control.target)
        await kernel.connect(motor.speed, control.speed, convert.ports["input0"])
        await kernel.connect(control.voltage, motor.voltage)
        await kernel.connect(convert.ports["output0"], gauge.rpm)
        loop = await kernel.start(PeriodicContext(rate=RATE), steps, motor, control, convert, gauge, activate=True)
        await _observe(kernel, motor, control, gauge, say, strip)
        await loop.deactivate()
        _count(result, kernel, loop)
        result.speeds = list(gauge.speeds)
    return result


async def _observe(
    kernel: Kernel,
    motor: Motor,
    control: Control,
    gauge: Gauge,
    say: Callable[[str], None] | None,
    strip: Strip | None,
) -> None:
    loaded = False
    for number in range(1, round(_SECONDS / _LINE_EVERY) + 1):
        await kernel.sleep(_LINE_EVERY)
        at = number * _LINE_EVERY
        if say is not None and strip is not None and gauge.speeds:
            say(f"{at:4.1f} {gauge.speeds[-1]:5d}  {strip.line(gauge.speeds[-1], control.wanted * _RPM)}")
        if at >= len(_TARGETS) and not loaded:
            loaded = True
            await motor.configure(load=_LOAD)
            if say is not None:
                say(f"     await motor.configure(load={_LOAD:g}), while it runs: the controller holds the speed")
    await asyncio.sleep(0)


def _count(result: _Result, kernel: Kernel, loop: Context) -> None:
    ledgers = [connector.statistics for connector in kernel.connectors.values()]
    result.ledger = (
        sum(one.written for one in ledgers),
        sum(one.arrived for one in ledgers),
        sum(sum(one.dropped.values()) for one in ledgers),
        sum(one.buffered for one in ledgers),
    )
    result.balanced = all(one.balanced for one in ledgers)
    statistics = loop.statistics
    result.cycles, result.overruns = statistics.cycles, statistics.overruns
    result.lateness_mean = statistics.lateness_total_ns / max(1, statistics.cycles) / 1e9
    result.lateness_max = statistics.lateness_max_ns / 1e9
