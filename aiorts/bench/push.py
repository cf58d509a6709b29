"""The cases of `aiorts bench push`: a table, baselines first. Each aim is a ratio to a baseline of the same run."""

from __future__ import annotations

from typing import Final

from aiorts.bench import bare, flow
from aiorts.bench.case import Aim, Case, Metric, Sense

__all__ = ("CASES",)

_COST, _P50 = Metric.COST, Metric.P50
_AT_LEAST = Sense.AT_LEAST

CASES: Final[tuple[Case, ...]] = (
    Case("bare deque", "two Python calls and a deque", _COST, bare.calls, 100_000),
    Case("asyncio.Queue pair", "put_nowait + get_nowait, one task", _COST, bare.queue_pair, 50_000),
    Case("asyncio.Queue(1000)", "producer and consumer task", _COST, bare.queue_tasks, 30_000),
    Case("anyio stream(1000)", "producer and consumer task", _COST, bare.anyio_stream, 3_000),
    Case("bare future", "wake-up of a task, 200 Hz", _P50, bare.future_wake, 40),
    Case(
        "flush",
        "write_nowait + read_nowait, one task",
        _COST,
        flow.flush_pair,
        60_000,
        (Aim("bare deque", factor=3.0), Aim("asyncio.Queue pair", _AT_LEAST, 1.8)),
        lossless=True,
    ),
    Case(
        "flush, 1 MB array",
        "the same, record built once",
        _COST,
        flow.flush_array,
        60_000,
        (Aim("flush", factor=1.1),),
        lossless=True,
    ),
    Case(
        "flush, event context",
        "awaited writes, reader drains",
        _COST,
        flow.event_drain,
        30_000,
        (Aim("asyncio.Queue(1000)", _AT_LEAST, 1.5),),
        lossless=True,
    ),
    Case(
        "flush, one a cycle",
        "awaited writes, reader takes one a cycle, buffer full",
        _COST,
        flow.event_single,
        3_000,
        (Aim("asyncio.Queue(1000)"),),
        lossless=True,
    ),
    Case(
        "new/all",
        "producer and consumer task, lossless, length 1000",
        _COST,
        flow.new_tasks,
        30_000,
        (Aim("asyncio.Queue(1000)", _AT_LEAST, 1.5), Aim("anyio stream(1000)", _AT_LEAST, 8.0)),
        lossless=True,
    ),
    Case(
        "periodic/all",
        f"bursts of {flow.BURST} at {flow.PUSH_RATE:.0f} Hz, cost is processor time",
        _COST,
        flow.periodic_all,
        20_000,
        (Aim("asyncio.Queue(1000)"),),
        lossless=True,
    ),
    Case(
        "flush, idle to run",
        "write to on_execute of an event context, 200 Hz",
        _P50,
        flow.flush_wake,
        40,
        (Aim("bare future", factor=1.5),),
        lossless=True,
    ),
    Case(
        "new, idle to run",
        "write to on_execute of an event context, 200 Hz",
        _P50,
        flow.new_wake,
        40,
        (Aim("bare future", factor=1.5),),
        lossless=True,
    ),
    Case(
        "periodic/new, age",
        f"producer 1 kHz, push_rate {flow.PUSH_RATE:.0f} Hz: age when read",
        _P50,
        flow.periodic_age,
        40,
        (Aim("bare future", factor=1.0, times=1.5, extra_ns=flow.PRODUCER_PERIOD_NS),),
    ),
)
