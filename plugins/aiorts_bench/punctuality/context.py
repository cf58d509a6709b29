"""`aiorts bench context`: how punctual each kind of execution context is, next to bare loops of the same run."""

from __future__ import annotations

import tempfile
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Final

import click

import aiorts
from aiorts import PeriodicContext, ThreadContext
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, CPU, Aim, Case, Measure, Reading, Sense, tails
from aiorts_bench.harness.report import Report
from aiorts_bench.punctuality import bare_clock, paper, ticking
from aiorts_bench.punctuality.bare_c import CLoop, build
from aiorts_bench.punctuality.ticking import (
    COMPONENTS,
    DEVIATION_BEST,
    EXECUTED,
    INTERVAL,
    LATENESS,
    PERIOD_NS,
    RATE_ERROR,
    MakeContext,
    bare,
)

PRIORITY: Final = 50
"""SCHED_FIFO priority of the bare loops and of the real-time context, where it is granted."""
TICKS: Final = 60
"""The ticks of one round at scale 1."""
_CROWDED_NS: Final = 20_000_000
"""Period of a context with 1,000 components: they would need most of 2 ms."""

_SKIPPED: Final = Measure("skipped", "")
_OVERRUNS: Final = Measure("overruns", "")
_DEVIATION: Final = Measure("deviation", "us", digits=1)
_COLUMNS: Final = (
    *tails("lateness", 99, 100),
    DEVIATION_BEST,
    _DEVIATION,
    EXECUTED,
    INTERVAL,
    RATE_ERROR,
    _SKIPPED,
    _OVERRUNS,
    CPU,
)
_P99: Final = _COLUMNS[0]
_RATE_AIM: Final = Aim("", factor=100.0, measure=RATE_ERROR)
_LONG: Final = 5.0
"""From this scale on a round is long enough (0.6 s) to separate an error of the rate from the lateness of one tick."""

_HOW: Final = (
    "2 ms; lateness is from when a tick was due to the first line of the first hook (of the loop, for a bare one). "
    "Deviation is the standard deviation of the period, of all and of the 99 % nearest to 2 ms. Executed is how often "
    "it ran in a second, interval the time from one run to the next, skipped ticks included. Every tick that was due "
    "ran or was counted as skipped, else there is a fault; rate error is the slope of the moments at which tick n ran "
    "beside the nominal period. No maximum is claimed on a shared or virtual machine: what the "
    "host takes away it takes from the loop in C as well."
)


def realtime() -> MakeContext | None:
    """A function that makes a real-time context of a rate; None where this aiorts has none."""
    kind: Any = getattr(aiorts, "RealtimeContext", None)
    return None if kind is None else lambda rate: kind(rate=rate, priority=PRIORITY)


async def busy(run: Callable[[int], Awaitable[Reading]], count: int) -> Reading:
    """Run a workload while the event loop is hardly ever free."""
    async with ticking.beside_busy():
        return await run(count)


def _case(name: str, what: str, run: Callable[[int], Awaitable[Reading]], *aims: Aim, messages: int = TICKS) -> Case:
    return Case(name, what, LATENESS, run, messages, aims, columns=_COLUMNS)


def loop_cases(*, long: bool = True) -> tuple[Case, ...]:
    """The cases that run on the event loop, whose figures depend on it; the rate is judged where rounds are `long`."""
    rate = (_RATE_AIM,) if long else ()
    steady = (Aim("asyncio.sleep", factor=0.25, measure=DEVIATION_BEST), *rate)
    not_judged = (Aim("asyncio.sleep", measure=DEVIATION_BEST), *rate)
    in_periodic = partial(ticking.in_context, PeriodicContext)
    return (
        _case("asyncio.sleep", "bare: asyncio.sleep to absolute deadlines", partial(bare, bare_clock.asyncio_sleep)),
        _case("periodic, 1", "PeriodicContext, one component", partial(in_periodic, 0), *steady),
        _case("periodic, 10", "the same with 10 components", partial(in_periodic, 9), *steady),
        _case(
            "periodic, 1000",
            f"the same with 1,000 components, {_CROWDED_NS / 1e6:.0f} ms",
            partial(in_periodic, 999, period_ns=_CROWDED_NS),
            *rate,
            messages=TICKS * PERIOD_NS // _CROWDED_NS,
        ),
        _case("event", "EventContext paced by a component of a PeriodicContext", ticking.event_paced, *not_judged),
        _case("external", "ExternalContext ticked after kernel.sleep", ticking.external, *not_judged),
        Case("bare awaits", f"{COMPONENTS} bare coroutines awaited, cost of each", COST, ticking.bare_awaits, 20),
        Case(
            "cycle",
            f"one context with {COMPONENTS} empty components, failures contained and hooks timed, cost of each",
            COST,
            ticking.cycles,
            20,
            (Aim("bare awaits", Sense.AT_MOST, 4.0),),
        ),
    )


def thread_cases(c_loop: CLoop | None, *, long: bool = True) -> tuple[Case, ...]:
    """The cases that run in a thread or process of their own, while the event loop is idle or busy."""
    rate = (_RATE_AIM,) if long else ()
    nanosleep = partial(bare, partial(bare_clock.clock_nanosleep, priority=PRIORITY))
    cases = [_case("time.sleep", "bare: time.sleep in a thread", partial(bare, bare_clock.time_sleep))]
    if bare_clock.has_clock_nanosleep():
        # Not measured with a busy loop, too: the interpreter's switch interval of 5 ms makes a few ticks take seconds.
        what = "bare: the system call by ctypes in a thread, SCHED_FIFO if granted"
        cases.append(_case("clock_nanosleep", what, nanosleep))
    if c_loop is not None:
        in_c = partial(bare, partial(c_loop.run, priority=PRIORITY))
        cases.append(_case("C", "bare: the system call in C, a process of its own, SCHED_FIFO if granted", in_c))
    in_thread = partial(ticking.in_context, ThreadContext)
    cases.append(_case("thread, 1", "ThreadContext, one component", partial(in_thread, 0), Aim("time.sleep"), *rate))
    make = realtime()
    if make is not None:
        cases += _realtime_cases(make, rate)
    return tuple(cases)


def _realtime_cases(make: MakeContext, rate: tuple[Aim, ...]) -> list[Case]:
    alone, ten = (partial(ticking.in_context, make, others, plain=True) for others in (0, 9))
    four = partial(ticking.manipulator, make)
    base = "clock_nanosleep" if bare_clock.has_clock_nanosleep() else "time.sleep"
    aims = (Aim(base, factor=2.0), Aim(base, factor=2.0, measure=DEVIATION_BEST), *rate)
    soon = Aim("", factor=1000.0, measure=_P99)
    return [
        _case("realtime, 1", "RealtimeContext, one component", alone, *aims),
        _case("realtime, 10", "the same with 10 components", ten, *aims),
        _case("realtime, four", "the same with the paper's four components", four, *aims),
        _case("realtime, busy", "one component, beside a loop held for 5 ms at a time", partial(busy, alone), soon),
        _case("realtime, four, busy", "the paper's four, beside the same", partial(busy, four), soon),
    ]


def report(options: Options) -> Report:
    """Measure the kinds of context, or with `--paper` the paper's table."""
    with tempfile.TemporaryDirectory(prefix="aiorts-bench-") as folder:
        built = build(folder)
        c_loop = None if isinstance(built, str) else built
        notes = [built] if isinstance(built, str) else []
        if realtime() is None:
            notes.append("this aiorts has no RealtimeContext: its rows are left out")
        if options.extra.get("paper"):
            return paper.report(options, c_loop, realtime(), tuple(notes), PRIORITY)
        threads = options.loops[0]
        notes.append(f"rows in threads and processes were taken once, beside an idle {threads} loop")
        long = options.scale >= _LONG
        if not long:
            notes.append(f"the rate is not judged: that takes longer rounds, --scale {_LONG:g} or more")
        rows = options.rows(loop_cases(long=long)) + options.rows(thread_cases(c_loop, long=long), loop=threads)
    return options.report("context", rows, notes=tuple(notes), how=_HOW)


BENCH: Final = Bench(
    "context",
    "How punctual each kind of execution context is, beside bare loops of the same run.\n\nLateness, error of the "
    "period and of the rate, overruns and processor time of periodic, event-paced, external, thread and real-time "
    "contexts; the cost of a cycle of 1,000 components.",
    report,
    options=(
        click.Option(
            ["--paper"],
            is_flag=True,
            help="The force controlled manipulator of the RT-Middleware paper: its table 1 beside ours.",
        ),
    ),
    quick_rounds=5,
    rounds=7,
    full_scale=10.0,
)
