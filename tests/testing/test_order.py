"""A loop with a seed: another order of what is ready at one instant, each time the same, as asyncio allows it."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from aiorts import Kernel
from aiorts.testing import simulate
from aiorts.testing.order import Shuffle
from aiorts.testing.simulation import SimulatedLoop
from campaign import cases

SEEDS = st.integers(0, 2**32)


async def race() -> list[int]:
    """Who went when, of five tasks that are made, woken and woken by time at the same instants."""
    went: list[int] = []
    event = asyncio.Event()

    async def run(number: int) -> None:
        went.append(number)
        await event.wait()
        went.append(number)
        await asyncio.sleep(1.0)
        went.append(number)

    tasks = [asyncio.create_task(run(number)) for number in range(5)]
    await asyncio.sleep(0)
    event.set()
    await asyncio.gather(*tasks)
    return went


def test_without_a_seed_first_come_first_served() -> None:
    assert simulate(race()) == [*range(5)] * 3


@pytest.mark.slow(kept_by="test_callbacks_keep_their_order_and_no_task_passes_one")
def test_a_seed_gives_an_order_of_its_own_each_time() -> None:
    orders = {seed: simulate(race(), seed=seed) for seed in range(200)}
    assert {seed: simulate(race(), seed=seed) for seed in range(200)} == orders
    for began in (0, 5, 10):  # of 120 orders 200 seeds show most, whatever it was that made the tasks ready
        assert len({tuple(order[began : began + 5]) for order in orders.values()}) > 80
        assert all(sorted(order[began : began + 5]) == [*range(5)] for order in orders.values())
    with asyncio.Runner(loop_factory=lambda: SimulatedLoop(seed=17)) as runner:
        assert runner.run(race()) == orders[17]


@hypothesis_settings(max_examples=cases(5000))
@given(SEEDS, st.lists(st.sampled_from(["callback", "task", "turn"]), max_size=12))
def test_callbacks_keep_their_order_and_no_task_passes_one(seed: int, steps: list[str]) -> None:
    async def main() -> list[tuple[str, int]]:
        loop, went = asyncio.get_running_loop(), list[tuple[str, int]]()

        async def run(number: int) -> None:
            went.append(("task", number))

        tasks = []
        for number, step in enumerate(steps):
            if step == "callback":
                loop.call_soon(went.append, ("callback", number))
            elif step == "task":
                tasks.append(asyncio.create_task(run(number)))
            else:
                await asyncio.sleep(0)
                # Whoever gives up its turn goes on after everything that was ready.
                assert len(went) == number - steps[:number].count("turn")
        await asyncio.gather(*tasks)
        await asyncio.sleep(0)
        return went

    went = simulate(main(), seed=seed)
    assert sorted(number for _, number in went) == [n for n, step in enumerate(steps) if step != "turn"]
    for place, (kind, number) in enumerate(went):
        if kind == "callback":
            assert all(earlier < number for _, earlier in went[:place])
            assert all(later > number for _, later in went[place:][1:])


@hypothesis_settings(max_examples=cases(5000))
@given(SEEDS)
def test_a_done_callback_runs_before_who_awaited_later(seed: int) -> None:
    async def main() -> list[str]:
        told: list[str] = []
        future = asyncio.get_running_loop().create_future()

        async def wait() -> None:
            await future
            told.append("awaited")

        future.add_done_callback(lambda _: told.append("callback"))
        tasks = [asyncio.create_task(wait()) for _ in range(3)]
        await asyncio.sleep(0)
        future.set_result(None)
        await asyncio.gather(*tasks)
        return told

    assert simulate(main(), seed=seed) == ["callback", "awaited", "awaited", "awaited"]


def test_what_fails_says_its_seed() -> None:
    async def main() -> None:
        async with Kernel():
            raise ValueError("in this order")

    with pytest.raises(ValueError, match="in this order") as caught:
        simulate(main(), seed=4711)
    assert caught.value.__notes__ == ["simulate(..., seed=4711) runs what is ready at one instant in this order again"]
    with pytest.raises(ValueError, match="in this order") as caught:
        simulate(main())
    assert not hasattr(caught.value, "__notes__")


def test_what_a_thread_asks_for_meanwhile_is_not_lost() -> None:
    """It comes after what was ready before."""
    ready: deque[Any] = deque()

    class Handle:
        @property
        def _callback(self) -> None:  # asked for while the order is made
            if len(ready) < 5:
                ready.append(self)

    ready.extend(handles := [Handle(), Handle()])
    Shuffle(1)(ready)
    assert list(ready)[:2] == handles
    assert len(ready) > 2
