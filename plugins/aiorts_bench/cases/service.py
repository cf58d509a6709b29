"""`aiorts bench service`: the cost of a call through a service port, next to a bare coroutine and a pair of queues."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from itertools import repeat
from time import perf_counter_ns
from typing import Any, Final, Protocol

from aiorts import Component, EventContext, Kernel, Provided, Required
from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, RATE, Aim, Case, Reading
from aiorts_bench.harness.report import Report


class Adder(Protocol):
    """The interface that is called."""

    async def add(self, left: float, right: float) -> float: ...


class Both(Protocol):
    """An interface like `Adder`, but with a plain method."""

    def add(self, left: float, right: float) -> float: ...


class Plain(Component):
    """A provider that answers in a plain method, one call at a time."""

    service = Provided[Adder]()
    at_once = Provided[Both]()

    def add(self, left: float, right: float) -> float:
        return left + right


class PlainConcurrent(Component):
    """A provider that answers in a plain method, without the entry lock."""

    service = Provided[Adder](concurrent=True)

    def add(self, left: float, right: float) -> float:
        return left + right


class Waiting(Component):
    """A provider that answers in a coroutine, which runs in a task of its own."""

    service = Provided[Adder]()

    async def add(self, left: float, right: float) -> float:
        return left + right


class WaitingConcurrent(Waiting):
    """A provider that answers in a coroutine, without the entry lock."""

    service = Provided[Adder](concurrent=True)


class Caller(Component):
    """A component with the required ports that the bench calls."""

    adder = Required[Adder]()
    both = Required[Both]()


async def _add(left: float, right: float) -> float:
    return left + right


async def bare_coroutine(count: int) -> Reading:
    """Await a coroutine."""
    began = perf_counter_ns()
    for _ in repeat(None, count):
        await _add(1.0, 2.0)
    return Reading.timed(count, perf_counter_ns() - began)


async def bare_task(count: int) -> Reading:
    """Make a task and await it."""
    began = perf_counter_ns()
    for _ in repeat(None, count):
        await asyncio.create_task(_add(1.0, 2.0))
    return Reading.timed(count, perf_counter_ns() - began)


async def bare_timed_task(count: int) -> Reading:
    """Make a task and await it within a time-out."""
    began = perf_counter_ns()
    for _ in repeat(None, count):
        async with asyncio.timeout(1.0):
            await asyncio.create_task(_add(1.0, 2.0))
    return Reading.timed(count, perf_counter_ns() - began)


async def queues(count: int) -> Reading:
    """Pass a request into one `asyncio.Queue` and the reply out of another, between two tasks."""
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
    """A workload: calls of a provider that is active in a context of its own."""

    async def run(count: int) -> Reading:
        async with Kernel() as kernel:
            caller, answering = await kernel.add(Caller("caller")), await kernel.add(provider("provider"))
            required = caller.both if plain else caller.adder
            await kernel.connect(required, answering.at_once if plain else answering.service)
            await kernel.start(EventContext(), answering, activate=True)
            elapsed = await loop(caller, count)
            calls = required.statistics
            wrong = () if calls.calls == count and not calls.failures else (f"{calls.calls} of {count} calls counted",)
            return replace(Reading.timed(count, elapsed), faults=wrong)

    return run


async def one_after_another(caller: Caller, count: int) -> int:
    """Make each call after the call before was answered."""
    add = caller.adder.proxy.add
    began = perf_counter_ns()
    for _ in repeat(None, count):
        await add(1.0, 2.0)
    return perf_counter_ns() - began


async def plainly(caller: Caller, count: int) -> int:
    """Call a plain method, which is not awaited."""
    add = caller.both.proxy.add
    began = perf_counter_ns()
    for _ in repeat(None, count):
        add(1.0, 2.0)
    return perf_counter_ns() - began


async def ten_at_once(caller: Caller, count: int) -> int:
    """Call from ten tasks at the same time."""
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
    *(
        _case(name, what, called(provider, loop, plain=loop is plainly), _COROUTINE, _QUEUES, messages=20_000)
        for name, what, provider, loop in (
            ("plain interface, `def`", "not awaited: runs at once or raises", Plain, plainly),
            ("serialised, `def`", "a plain method, the entry lock free", Plain, one_after_another),
            ("concurrent, `def`", "the same without the entry lock", PlainConcurrent, one_after_another),
        )
    ),
    *(
        _case(name, what, called(provider, loop), _TIMED, _QUEUES)
        for name, what, provider, loop in (
            ("serialised, `async def`", "in a task of its own, with a deadline", Waiting, one_after_another),
            ("concurrent, `async def`", "the same without the lock", WaitingConcurrent, one_after_another),
            ("serialised, `async def`, 10 callers", "they wait for the entry lock", Waiting, ten_at_once),
        )
    ),
)
"""The cases, baselines first."""


def report(options: Options) -> Report:
    """Measure every kind of call."""
    return options.simple(
        "service",
        CASES,
        how="Cost is one call, from request to answer. Every call has a deadline, is counted and checked for the type "
        "of its answer; a serialised one never runs at once with a hook of the provider.",
    )


BENCH: Final = Bench(
    "service",
    "Calls through service ports: serialised and concurrent, plain and awaited, beside bare coroutines and queues.",
    report,
)
