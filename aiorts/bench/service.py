"""`aiorts bench service`: what a call through a service port costs, beside a bare coroutine and a pair of queues."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final, Protocol

from aiorts import Component, EventContext, Kernel, Provided, Required
from aiorts.bench.case import COST, RATE, Aim, Case, Reading
from aiorts.bench.registry import Bench, Options
from aiorts.bench.report import Report

__all__ = ("BENCH", "CASES")


class Adder(Protocol):
    """What is called."""

    async def add(self, left: float, right: float) -> float: ...


class Both(Protocol):
    """The same without waiting."""

    def add(self, left: float, right: float) -> float: ...


class Plain(Component):
    """Answers in a plain method, one call at a time."""

    service = Provided[Adder]()
    at_once = Provided[Both]()

    def add(self, left: float, right: float) -> float:
        return left + right


class PlainConcurrent(Component):
    """Answers in a plain method, at any time."""

    service = Provided[Adder](concurrent=True)

    def add(self, left: float, right: float) -> float:
        return left + right


class Waiting(Component):
    """Answers in a coroutine, which has a task of its own."""

    service = Provided[Adder]()

    async def add(self, left: float, right: float) -> float:
        return left + right


class WaitingConcurrent(Waiting):
    """The same at any time."""

    service = Provided[Adder](concurrent=True)


class Caller(Component):
    """Who calls."""

    adder = Required[Adder]()
    both = Required[Both]()


async def bare_coroutine(count: int) -> Reading:
    """One coroutine awaited."""

    async def add(left: float, right: float) -> float:
        return left + right

    began = perf_counter_ns()
    for _ in repeat(None, count):
        await add(1.0, 2.0)
    return Reading.timed(count, perf_counter_ns() - began)


async def bare_task(count: int) -> Reading:
    """One task made and awaited."""

    async def add(left: float, right: float) -> float:
        return left + right

    began = perf_counter_ns()
    for _ in repeat(None, count):
        await asyncio.create_task(add(1.0, 2.0))
    return Reading.timed(count, perf_counter_ns() - began)


async def bare_timed_task(count: int) -> Reading:
    """One task made and awaited within a time-out."""

    async def add(left: float, right: float) -> float:
        return left + right

    began = perf_counter_ns()
    for _ in repeat(None, count):
        async with asyncio.timeout(1.0):
            await asyncio.create_task(add(1.0, 2.0))
    return Reading.timed(count, perf_counter_ns() - began)


async def queues(count: int) -> Reading:
    """A request into one `asyncio.Queue`, the reply out of another, between two tasks."""
    requests: asyncio.Queue[tuple[float, float]] = asyncio.Queue()
    replies: asyncio.Queue[float] = asyncio.Queue()

    async def serve() -> None:
        while True:
            left, right = await requests.get()
            replies.put_nowait(left + right)

    server = asyncio.create_task(serve())
    began = perf_counter_ns()
    for _ in repeat(None, count):
        requests.put_nowait((1.0, 2.0))
        await replies.get()
    elapsed = perf_counter_ns() - began
    server.cancel()
    await asyncio.gather(server, return_exceptions=True)
    return Reading.timed(count, elapsed)


def called(
    provider: type[Any], loop: Callable[[Caller, int], Awaitable[int]], *, plain: bool = False
) -> Callable[[int], Awaitable[Reading]]:
    """So many calls of a provider that is active in a context of its own."""

    async def run(count: int) -> Reading:
        async with Kernel() as kernel:
            caller, answering = await kernel.add(Caller("caller")), await kernel.add(provider("provider"))
            required = caller.both if plain else caller.adder
            await kernel.connect(required, answering.at_once if plain else answering.service)
            await kernel.start(EventContext(), answering, activate=True)
            elapsed = await loop(caller, count)
            calls = required.statistics
            wrong = () if calls.calls == count and not calls.failures else (f"{calls.calls} of {count} calls counted",)
            return Reading(Reading.timed(count, elapsed).values, count, faults=wrong)

    return run


async def one_after_another(caller: Caller, count: int) -> int:
    """Each call when the one before was answered."""
    add = caller.adder.proxy.add
    began = perf_counter_ns()
    for _ in repeat(None, count):
        await add(1.0, 2.0)
    return perf_counter_ns() - began


async def plainly(caller: Caller, count: int) -> int:
    """A plain method of the interface, which is not awaited."""
    add = caller.both.proxy.add
    began = perf_counter_ns()
    for _ in repeat(None, count):
        add(1.0, 2.0)
    return perf_counter_ns() - began


async def ten_at_once(caller: Caller, count: int) -> int:
    """Ten callers at the same time."""
    left = iter(range(count))

    async def some() -> None:
        add = caller.adder.proxy.add
        for _ in left:
            await add(1.0, 2.0)

    began = perf_counter_ns()
    await asyncio.gather(*(some() for _ in range(10)))
    return perf_counter_ns() - began


_COROUTINE: Final = "bare coroutine"
_TASK: Final = "bare task"
_TIMED: Final = "bare task, time-out"
_QUEUES: Final = "asyncio.Queue, request and reply"


def _case(name: str, what: str, run: Callable[[int], Awaitable[Reading]], *bases: str, messages: int = 5_000) -> Case:
    return Case(name, what, COST, run, messages, tuple(Aim(base) for base in bases), columns=(RATE,))


CASES: Final = (
    _case(_COROUTINE, "one coroutine awaited", bare_coroutine, messages=50_000),
    _case(_TASK, "create_task and await", bare_task),
    _case(_TIMED, "the same within asyncio.timeout", bare_timed_task),
    _case(_QUEUES, "two queues between two tasks", queues),
    _case(
        "plain interface, `def`",
        "not awaited: runs at once or says that it cannot",
        called(Plain, plainly, plain=True),
        _COROUTINE,
        _QUEUES,
        messages=20_000,
    ),
    _case(
        "serialised, `def`",
        "the provider's method is plain and nobody is in the way",
        called(Plain, one_after_another),
        _COROUTINE,
        _QUEUES,
        messages=20_000,
    ),
    _case(
        "concurrent, `def`",
        "the same without the gate",
        called(PlainConcurrent, one_after_another),
        _COROUTINE,
        _QUEUES,
        messages=20_000,
    ),
    _case(
        "serialised, `async def`",
        "in a task of its own, with a deadline",
        called(Waiting, one_after_another),
        _TIMED,
        _QUEUES,
    ),
    _case(
        "concurrent, `async def`",
        "the same without the gate",
        called(WaitingConcurrent, one_after_another),
        _TIMED,
        _QUEUES,
    ),
    _case(
        "serialised, `async def`, 10 callers",
        "they wait for one another at the gate",
        called(Waiting, ten_at_once),
        _TIMED,
        _QUEUES,
    ),
)
"""Baselines first."""


def report(options: Options) -> Report:
    """The bench."""
    return options.simple(
        "service",
        CASES,
        how="Cost is one call, from asking to the answer. Every call has a deadline, is counted and checked for the "
        "type of its answer; a serialised one never runs at once with a hook of the provider.",
    )


BENCH: Final = Bench(
    "service",
    "Calls through service ports: serialised and concurrent, plain and awaited, beside bare coroutines and queues.",
    report,
    quick_rounds=7,
    rounds=15,
)
