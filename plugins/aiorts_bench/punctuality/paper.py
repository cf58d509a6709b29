"""`aiorts bench context --paper`: table 1 of the RT-Middleware paper next to the same four components in aiorts.

N. Ando, T. Suehiro, T. Kotoku: "A Software Platform for Component Based RT-System Development: OpenRTM-aist", 2008,
section 4.2: a force sensor, a manipulator, a joystick and a damper controller in one synchronous composite at 2 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

from aiorts import PeriodicContext, ThreadContext
from aiorts_bench.harness.bench import Options
from aiorts_bench.harness.case import Aim, Case, Measure, Reading, tails
from aiorts_bench.harness.report import Report
from aiorts_bench.punctuality import bare_clock, ticking
from aiorts_bench.punctuality.bare_c import CLoop
from aiorts_bench.punctuality.ticking import DEVIATION_BEST, EXECUTED, INTERVAL, LATENESS, RATE_ERROR, MakeContext, bare

TICKS: Final = 300
"""Ticks of one round at scale 1: enough for the arm to meet the wall and to rest there."""
TABLE_1: Final = {"mean": 2.00, "min": 1.99, "max": 2.01, "deviation": 4.41}
"""The figures printed in the paper: milliseconds, and microseconds for the standard deviation."""

_MEAN: Final = Measure("period mean", "ms", digits=3)
_MIN: Final = Measure("period min", "ms", "more", 3, "period", 0)
_MAX: Final = Measure("period max", "ms", "less", 3, "period", 100)
_DEVIATION: Final = Measure("deviation", "us", digits=2)
_COLUMNS: Final = (
    *(_MIN, _MEAN, _MAX, DEVIATION_BEST, LATENESS, *tails("lateness", 99, 100)),
    *(EXECUTED, INTERVAL, RATE_ERROR),
)

_HOW: Final = (
    "The paper's four components, really computing, in one context of 2 ms; every round ends with the arm at rest "
    "against the wall, which is checked. Minimum and maximum are of all rounds, mean and deviation medians over the "
    "rounds; deviation 99 % is of the 99 % of the periods nearest to 2 ms. The paper's figures are from another "
    "machine and year. On a virtual or shared machine the maximum says what the host took away: it takes it from the "
    "loop in C as well."
)


def _paper(count: int) -> Reading:
    """The figures printed in the paper; nothing is measured."""
    values = {"deviation": TABLE_1["deviation"], "period mean": TABLE_1["mean"]}
    return Reading(values, 1, {"period": [TABLE_1["min"] * 1e6, TABLE_1["max"] * 1e6]})


def cases(c_loop: CLoop | None, make: MakeContext | None, priority: int) -> tuple[Case, ...]:
    """The cases: the paper's figures, bare loops, and the four components in each kind of context that has a rate."""
    found = [
        _case("paper, table 1", "as printed in the paper (OpenRTM-aist, its machine); not measured here", _paper),
        _case("asyncio.sleep", "bare loop to absolute deadlines", partial(bare, bare_clock.asyncio_sleep)),
    ]
    nanosleep = bare_clock.has_clock_nanosleep()
    if nanosleep:
        python = partial(bare_clock.clock_nanosleep, priority=priority)
        found.append(_case("clock_nanosleep", "bare loop by ctypes, SCHED_FIFO if granted", partial(bare, python)))
    if c_loop is not None:
        in_c = partial(c_loop.run, priority=priority)
        found.append(_case("C", "bare loop on clock_nanosleep, SCHED_FIFO if granted", partial(bare, in_c)))
    steady = Aim("asyncio.sleep", factor=0.25, measure=DEVIATION_BEST)
    rate = Aim("", factor=100.0, measure=RATE_ERROR)
    found += [
        _case("periodic", "PeriodicContext on the loop", partial(ticking.manipulator, PeriodicContext), steady, rate),
        _case("thread", "ThreadContext", partial(ticking.manipulator, ThreadContext), rate),
    ]
    if make is not None:
        base = "clock_nanosleep" if nanosleep else "asyncio.sleep"
        aims = [Aim(base, factor=2.0, measure=LATENESS), Aim(base, factor=2.0, measure=DEVIATION_BEST), rate]
        if c_loop is not None:
            aims.append(Aim("C", factor=1.0, times=2.0, floor=TABLE_1["deviation"]))
        found.append(_case("realtime", "RealtimeContext", partial(ticking.manipulator, make), *aims))
    return tuple(found)


def _case(name: str, what: str, run: Callable[[int], Any], *aims: Aim) -> Case:
    return Case(name, what, _DEVIATION, run, TICKS, aims, columns=_COLUMNS)


def report(
    options: Options,
    c_loop: CLoop | None,
    make: MakeContext | None,
    notes: tuple[str, ...],
    priority: int,
) -> Report:
    """Measure the paper's table. `make` makes a real-time context of a rate, None where there is none."""
    loop = options.loops[-1]
    rows = options.rows(cases(c_loop, make, priority), loop=loop)
    idle = "figures are beside an idle loop; the arm met the wall and came to rest in every round"
    return options.report("context", rows, notes=(*notes, idle), how=_HOW)
