"""A caller of `apply` that is cancelled at any turn of the loop leaves the wanted system, or the one that there was."""

from __future__ import annotations

import asyncio
from random import Random

import pytest

from aiorts import Kernel, SimulatedClock
from aiorts.errors import ApplyError
from aiorts.model.wanted.entries import Wanted
from aiorts.planning import wanted_of
from aiorts.planning.applying import Application
from aiorts.testing import simulate
from planning.generated import random_system
from planning.test_apply import Broken, check_ledgers, check_order, texts


@pytest.mark.slow
@pytest.mark.fault("G05")
@pytest.mark.parametrize("fails", [False, True], ids=["to its end", "taken back"])
def test_cancelled_at_any_turn_it_is_done_or_taken_back(fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = Random(7)
    before, after = random_system(random), random_system(random)
    if fails:
        forth = Application.forth

        async def failing(self: Application) -> None:
            await forth(self)
            if self.plan.steps[0].text != first[0]:
                raise Broken

        monkeypatch.setattr(Application, "forth", failing)
    first: list[str] = []
    turns = 0
    while simulate(lambda clock, turns=turns: cancelled_after(clock, turns, before, after, fails, first)):  # type: ignore[misc]
        turns += 1
        assert turns < 400
    assert turns > 5


async def cancelled_after(
    clock: SimulatedClock, turns: int, before: Wanted, after: Wanted, fails: bool, first: list[str]
) -> bool:
    tasks = asyncio.all_tasks()
    async with Kernel() as kernel:
        first[:] = [(await kernel.apply(before, dry_run=True)).plan.steps[0].text]
        await kernel.apply(before)
        await kernel.sleep(0.3)
        task = asyncio.ensure_future(kernel.apply(after))
        for turn in range(turns):
            await (clock.advance(0.001) if turn % 8 == 7 else asyncio.sleep(0))
        under_way = not task.done()
        task.cancel()
        await asyncio.wait([task], timeout=10.0)
        if not under_way and fails:
            assert isinstance(task.exception(), ApplyError)
        await kernel.sleep(6.0)
        assert not kernel.registry.renewing
        begun = turns > 0 or not under_way
        assert texts(wanted_of(kernel), after if begun and not fails else before) == []
        assert not kernel.registry.parked
        check_ledgers(kernel)
        check_order(kernel)
        if not fails:
            await kernel.apply(before)
            assert texts(wanted_of(kernel), before) == []
    assert asyncio.all_tasks() == tasks
    return under_way
