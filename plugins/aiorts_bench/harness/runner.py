"""Takes the rounds: each runs every case once, each begins with another case; the garbage collector is off."""

from __future__ import annotations

import gc
import inspect
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, nullcontext
from typing import Any, TypeAlias

from aiorts import run
from aiorts.progress import Step
from aiorts_bench.harness.case import Case, Reading
from aiorts_bench.harness.report import Row, row_of

Beside: TypeAlias = Callable[[], AbstractAsyncContextManager[Any]]
Progress: TypeAlias = Callable[[str, int], AbstractContextManager[Step]]


def choose_loops(wanted: str) -> tuple[str, ...]:
    """The loops to measure on: "both" is asyncio, and uvloop where it is installed; "auto" is the faster of these."""
    if wanted in ("asyncio", "uvloop"):
        return (wanted,)
    try:
        import uvloop  # noqa: F401
    except ImportError:
        return ("asyncio",)
    return ("uvloop",) if wanted == "auto" else ("asyncio", "uvloop")


def measure(
    cases: Sequence[Case],
    *,
    loop: str,
    rounds: int,
    scale: float = 1.0,
    progress: Progress | None = None,
    beside: Beside | None = None,
) -> tuple[Row, ...]:
    """Run every case `rounds` times and return one row for each.

    Args:
        cases: in the order of the rows, the baselines of each among them.
        loop: "asyncio" or "uvloop", a loop of its own for all rounds; "none" for workloads that are plain functions.
        scale: times the messages of a case, at least one.
        progress: opens a display with a label and the number of runs; it advances with each run.
        beside: opened once on the loop, before the first round, and closed after the last.
    """
    if rounds < 1:
        raise ValueError(f"rounds = {rounds}: expected at least 1")
    readings: dict[str, list[Reading]] = {case.name: [] for case in cases}
    if len(readings) != len(cases):
        raise ValueError(f"two cases with one name among {', '.join(case.name for case in cases)}")

    async def take_rounds(step: Step) -> None:
        async with nullcontext() if beside is None else beside():
            for case in cases:
                if case.warm:
                    await _once(case, scale / 20)  # caches, specialised bytecode, lazy imports
            gc.collect()
            gc.freeze()  # so that the collection before each case looks at that case's garbage alone
            try:
                for number in range(rounds):
                    start = number % len(cases)
                    for case in (*cases[start:], *cases[:start]):
                        readings[case.name].append(await _once(case, scale))
                        step(1)
            finally:
                gc.unfreeze()

    label = "measuring" if loop == "none" else f"measuring on {loop}"
    with (progress or _unseen)(label, rounds * len(cases)) as step:
        if loop == "none":
            _without_loop(take_rounds(step))
        else:
            run(lambda: take_rounds(step), loop=loop)
    return tuple(row_of(loop, case, readings) for case in cases)


def _unseen(_label: str, _total: int) -> AbstractContextManager[Step]:
    return nullcontext(lambda _done: None)


def _without_loop(coroutine: Any) -> None:
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
