"""`aiorts bench push`: the table of its cases, baselines first. Each aim is a ratio to a baseline of the same run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, CPU, LATENCY, RATE, Aim, Case, Measure, Sense, tails
from aiorts_bench.harness.report import Report, Row
from aiorts_bench.push import ageing, answer, bare, flow, grid, load, peers
from aiorts_bench.push.ageing import GROWTH, PRODUCER_RATE, READER_RATE

CROWD: Final = 10_000
WAKES: Final = 20
"""Messages of one round: at 200 Hz a tenth of a second."""
_AGE: Final = Measure("age p50", "us", digits=1, pool="age")
_PERIOD_US: Final = 1e6 / PRODUCER_RATE
_COSTS: Final = (RATE,)
_TAILS: Final = (*tails("latency", label=""), CPU)
_AGES: Final = (*tails("age", label=""), CPU, GROWTH)
_FLAT: Final = Aim("", factor=64, measure=GROWTH)
_ARRAYS: Final = {"1 kB": 1_000, "1 MB": 1_000_000, "100 MB": 100_000_000}


def _queue(factor: float | None = None) -> Aim:
    return Aim("asyncio.Queue(1000)", Sense.AT_MOST if factor is None else Sense.AT_LEAST, factor)


def _wake(name: str, what: str, subscription: str, base: str) -> Case:
    run = flow.idle_to_run(subscription)
    return Case(name, what, LATENCY, run, WAKES, (Aim(base, factor=1.5),), lossless=True, columns=_TAILS)


def _cost(name: str, what: str, run: Callable[[int], Any], messages: int, *aims: Aim) -> Case:
    return Case(name, what, COST, run, messages, aims, lossless=True, columns=_COSTS)


def _age(name: str, what: str, aim: Aim, subscription: str, *, event: bool, busy: bool = False) -> Case:
    return Case(name, what, _AGE, ageing.age(subscription, event=event, busy=busy), 12, (aim, _FLAT), columns=_AGES)


def _arrays(base: str, messages: int) -> tuple[Case, ...]:
    """The cases of one policy with arrays of each size, compared with its float and its smallest array."""
    make: Callable[[flow.Payload], Callable[[int], Any]] = {
        "flush": flow.pair,
        "new/all": flow.tasks,
        "new/new": lambda payload: flow.pair(payload, subscription="new", push="new"),
        "periodic/all": flow.bursts,
    }[base]
    cases: list[Case] = []
    for size, count in _ARRAYS.items():
        aims = [Aim(name, factor=1.1) for name in (base, *(one.name for one in cases[:1]))]
        what = f"the same with an array of {size}, record built once"
        cases.append(_cost(f"{base}, {size}", what, make(count), messages, *aims))
    return tuple(cases)


_BARE: Final = (
    Case("bare deque", "two Python calls and a deque", COST, bare.calls, 100_000, columns=_COSTS),
    Case("asyncio.Queue pair", "put_nowait + get_nowait, one task", COST, bare.queue_pair, 50_000, columns=_COSTS),
    Case("asyncio.Queue(1000)", "producer and consumer task", COST, bare.queue_tasks, 30_000, columns=_COSTS),
    Case("anyio stream(1000)", "producer and consumer task", COST, bare.anyio_stream, 3_000, columns=_COSTS),
    Case("bare future", "wake-up of a task, 200 Hz", LATENCY, bare.future_wake, WAKES, columns=_TAILS),
)

CASES: Final[tuple[Case, ...]] = (
    *_BARE,
    _cost(
        "flush",
        "write_nowait + read_nowait, one task",
        flow.pair(),
        60_000,
        Aim("bare deque", factor=3.0),
        Aim("asyncio.Queue pair", Sense.AT_LEAST, 1.8),
    ),
    *_arrays("flush", 30_000),
    _cost(
        "flush, dataclass",
        "the same with a user's frozen dataclass of five fields, checked at each write",
        flow.pair(flow.Pose()),
        15_000,
        Aim("flush"),
        Aim("asyncio.Queue pair"),
    ),
    _cost(
        "100 single deliveries",
        f"flush, {flow.FAN_OUT} writers with one reader each, in turn: cost of one delivery",
        flow.pairs,
        30_000,
        Aim("flush"),
    ),
    _cost(
        "flush, 1 -> 100",
        f"one writer, {flow.FAN_OUT} readers: cost of one delivery",
        flow.fan_out,
        30_000,
        Aim("100 single deliveries", factor=1.1),
        Aim("flush"),
    ),
    _cost("flush, event context", "awaited writes, reader drains", flow.event_drain, 30_000, _queue(1.5)),
    _cost(
        *("flush, one a cycle", "awaited writes, reader takes one a cycle, buffer full", flow.event_single, 3_000),
        _queue(),
    ),
    _cost(
        "new/all",
        "producer and consumer task, lossless, length 1000",
        flow.tasks(),
        30_000,
        _queue(1.5),
        Aim("anyio stream(1000)", Sense.AT_LEAST, 8.0),
    ),
    *_arrays("new/all", 15_000),
    _cost(
        "new/new",
        "write_nowait + read_nowait, one task, length 1",
        flow.pair(1.0, subscription="new", push="new"),
        30_000,
        Aim("asyncio.Queue pair"),
    ),
    *_arrays("new/new", 30_000),
    Case(
        "periodic/all",
        f"bursts of {flow.BURST} at {flow.PUSH_RATE:.0f} Hz, cost is processor time",
        COST,
        flow.bursts(),
        20_000,
        (_queue(),),
        lossless=True,
        columns=(RATE, CPU),
    ),
    *_arrays("periodic/all", 10_000),
    _wake("flush, idle to run", "write to on_execute of an event context, 200 Hz", "flush", "bare future"),
    _wake("new, idle to run", "write to on_execute of an event context, 200 Hz", "new", "bare future"),
    _age(
        "new/new, age",
        f"producer {PRODUCER_RATE:.0f} Hz, event context that takes {READER_RATE:.0f} a second: age when read",
        Aim("bare future", factor=1.0, times=1.5, floor=_PERIOD_US, base_measure=LATENCY),
        "new",
        event=True,
        busy=True,
    ),
    _age(
        "new/new, periodic reader, age",
        f"producer {PRODUCER_RATE:.0f} Hz, reader {READER_RATE:.0f} Hz: age when read",
        Aim("bare future", factor=1.0, times=1.5, extra=_PERIOD_US, base_measure=LATENCY),
        "new",
        event=False,
    ),
    _age(
        "periodic/new, age",
        f"producer {PRODUCER_RATE:.0f} Hz, push_rate {READER_RATE:.0f} Hz, event context: age when read",
        Aim("bare future", factor=1.0, times=1.5, extra=_PERIOD_US, base_measure=LATENCY),
        "periodic",
        event=True,
    ),
)

_BESIDE: Final = f"beside {CROWD:,} idle"
CROWD_CASES: Final[tuple[Case, ...]] = (
    Case(f"bare future, {_BESIDE}", "wake-up of a task, 200 Hz", LATENCY, bare.future_wake, WAKES, columns=_TAILS),
    *(
        _wake(
            f"{subscription}, idle to run, {_BESIDE}",
            f"the same beside {CROWD:,} idle components, an event context each",
            subscription,
            f"bare future, {_BESIDE}",
        )
        for subscription in ("flush", "new")
    ),
)


def report(options: Options) -> Report:
    """Measure the headline table or, if lists are given, their combinations; `--plot` adds load curves."""
    axes = grid.chosen(options)
    if axes:
        return grid.report(options, axes)
    cases = CASES
    notes: tuple[str, ...] = (answer.POINTER,)
    if options.peers:
        found, left_out = peers.cases()
        cases, notes = (*CASES, *found), (*left_out, *notes)
    rows: tuple[Row, ...] = ()
    for loop in options.loops:
        rows += options.rows(cases, loop=loop)
        rows += options.rows(CROWD_CASES, loop=loop, beside=flow.crowd(CROWD))
    figures = load.figures(options) if options.plot else ()
    return options.report("push", rows, notes=notes, figures=figures)


BENCH: Final = Bench(
    "push",
    "Throughput and latency of the push policies: flush, new and periodic.\n\n"
    "Alone it gives the headline table. With any option that takes a list it measures every combination "
    "of those lists (one not given has its default) and checks the ledger of each.",
    report,
    options=grid.OPTIONS,
)
