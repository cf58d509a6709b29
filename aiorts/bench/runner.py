"""Takes the rounds: every case once in each round, in an order that turns, with the garbage collector held."""

from __future__ import annotations

import gc
import inspect
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Any, TypeAlias

from aiorts import run
from aiorts.bench.case import Case, Reading
from aiorts.bench.report import Row, row_of

__all__ = ("Beside", "choose_loops", "measure")

Beside: TypeAlias = Callable[[], AbstractAsyncContextManager[Any]]


def choose_loops(asked: str) -> tuple[str, ...]:
    """The loops to measure on: "both" is asyncio, and uvloop where it is installed; "auto" is the faster one there is.

    Raises:
        ImportError: uvloop was asked for by name and is not there.
    """
    if asked in ("asyncio", "uvloop"):
        return (asked,)
    try:
        import uvloop  # noqa: F401
    except ImportError:
        return ("asyncio",)
    return ("uvloop",) if asked == "auto" else ("asyncio", "uvloop")


def measure(
    cases: Sequence[Case],
    *,
    loop: str,
    rounds: int,
    scale: float = 1.0,
    progress: Callable[[str, int], None] | None = None,
    beside: Beside | None = None,
) -> tuple[Row, ...]:
    """Run every case `rounds` times and give one row for each.

    Args:
        cases: baselines of other cases among them; their order is the order of the rows.
        loop: "asyncio" or "uvloop", a loop of its own for all rounds; "none" for workloads that are plain functions.
        scale: times the messages of a case, at least one.
        progress: told the loop and the number of each round that begins.
        beside: opened once on the loop, before the first round, and closed after the last.
    """
    if rounds < 1:
        raise ValueError(f"rounds = {rounds}: expected at least 1")
    readings: dict[str, list[Reading]] = {case.name: [] for case in cases}
    if len(readings) != len(cases):
        raise ValueError(f"two cases with one name among {', '.join(case.name for case in cases)}")

    async def take_rounds() -> None:
        async with nullcontext() if beside is None else beside():
            for case in cases:
                if case.warm:
                    await _once(case, scale / 20)  # caches, specialised bytecode, lazy imports
            gc.collect()
            gc.freeze()  # collecting before each case then costs what the case itself left, not what stands beside it
            try:
                for number in range(rounds):
                    if progress is not None:
                        progress(loop, number)
                    start = number % len(cases)
                    for case in (*cases[start:], *cases[:start]):
                        readings[case.name].append(await _once(case, scale))
            finally:
                gc.unfreeze()

    if loop == "none":
        _step(take_rounds())
    else:
        run(take_rounds, loop=loop)
    return tuple(row_of(loop, case, readings) for case in cases)


def _step(coroutine: Any) -> None:
    """Run a coroutine that never waits, without a loop."""
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise TypeError('loop = "none": a workload waited; give it a loop, or make it a plain function')


async def _once(case: Case, scale: float) -> Reading:
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        reading = case.run(max(1, round(case.messages * scale)))
        return await reading if inspect.isawaitable(reading) else reading
    finally:
        if enabled:
            gc.enable()
