"""Takes the rounds: every case once in each round, in an order that turns, with the garbage collector held."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence

from aiorts import run
from aiorts.bench.case import Case, Reading
from aiorts.bench.report import Row, row_of

__all__ = ("choose_loops", "measure")


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
) -> tuple[Row, ...]:
    """Run every case `rounds` times on a loop of its own and give one row for each.

    Args:
        cases: baselines of other cases among them; their order is the order of the rows.
        scale: times the messages of a case, at least one.
        progress: told the loop and the number of each round that begins.
    """
    if rounds < 1:
        raise ValueError(f"rounds = {rounds}: expected at least 1")
    readings: dict[str, list[Reading]] = {case.name: [] for case in cases}

    async def take_rounds() -> None:
        for case in cases:
            await _once(case, scale / 20)  # caches, specialised bytecode, lazy imports
        for number in range(rounds):
            if progress is not None:
                progress(loop, number)
            start = number % len(cases)
            for case in (*cases[start:], *cases[:start]):
                readings[case.name].append(await _once(case, scale))

    run(take_rounds, loop=loop)
    return tuple(row_of(loop, case, readings) for case in cases)


async def _once(case: Case, scale: float) -> Reading:
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        return await case.run(max(1, round(case.messages * scale)))
    finally:
        if enabled:
            gc.enable()
