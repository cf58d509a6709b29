"""Goals of providers and clients whose hooks run in a thread: the same as on the loop, in the same order."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Goal, Kernel, RealtimeContext, ThreadContext
from aiorts.errors import GoalCancelled, ServiceTimeout, ThreadError
from services.goal_parts import Car, Driver, pair

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.anyio


class Stepping(Car):
    """Drives a metre in each cycle, until it is there or is to stop."""

    metres = 5

    def on_execute(self) -> None:
        for goal in self.goals:
            if goal.state == "running" and goal.cancel_requested:
                goal.cancelled()
            elif goal.state == "running":
                self.executed += 1
                goal.feedback(float(self.executed))
                if self.executed == self.metres:
                    goal.succeed("home")


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("context", [ThreadContext, RealtimeContext])
async def test_a_provider_in_a_thread_advances_its_goal(context: Callable[[float], Any]) -> None:
    async with Kernel() as kernel:
        driver, car = await pair(kernel, Stepping())
        await kernel.start(context(200.0), car, activate=True)
        goal = await driver.car.proxy.drive(10)
        assert [feedback async for feedback in goal] == [1.0, 2.0, 3.0, 4.0, 5.0]
        assert await goal.result(timeout=5.0) == "home"
        goals = driver.car.statistics.goals
        assert goals is not None
        assert goals.balanced
        assert (goals.succeeded, goals.feedback, goals.dropped) == (1, 5, 0)


async def test_a_provider_in_a_thread_sees_that_it_is_to_cancel() -> None:
    class Far(Stepping):
        metres = 10**9

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Far())
        await kernel.start(ThreadContext(200.0), car, activate=True)
        goal = await driver.car.proxy.drive(10)
        with pytest.raises(ServiceTimeout):
            await goal.result(timeout=0.05)
        with pytest.raises(GoalCancelled):
            await goal.result(timeout=5.0)


async def test_a_client_in_a_thread_blocks_for_a_goal_and_for_its_result() -> None:
    class Blocking(Driver):
        def __init__(self) -> None:
            super().__init__()
            self.said: list[object] = []

        def on_execute(self) -> None:
            if self.said:
                return

            async def whole(car: Any) -> str:
                result: str = await (await car.drive(10)).result()
                return result

            goal: Goal[float, str] = self.car.call_blocking(lambda car: car.drive(10))
            waiting = goal.result()
            try:
                waiting.send(None)
            except ThreadError as error:
                self.said.append(str(error))
            goal.cancel()
            self.said.append(self.car.call_blocking(whole, timeout=5.0))
            self.said.append(goal.state)

    async with Kernel() as kernel:
        driver, car = Blocking(), Stepping()
        await kernel.add(driver)
        await kernel.add(car)
        await kernel.connect(driver.car, car.service)
        await kernel.start(ThreadContext(200.0, name="cars"), car, activate=True)
        await kernel.start(ThreadContext(200.0, name="drivers"), driver, activate=True)
        async with asyncio.timeout(5.0):
            while len(driver.said) < 3:
                await asyncio.sleep(0.005)
        assert "look at `state`, or use call_blocking" in str(driver.said[0])
        assert driver.said[1:] == ["home", "cancelled"]


async def test_many_goals_of_a_thread_are_all_counted() -> None:
    class Hasty(Car):
        """Ends each goal in the cycle after it was made, with feedback, in a race with the loop that accepts it."""

        def on_execute(self) -> None:
            for goal in self.goals:
                for metres in range(3):
                    goal.feedback(float(metres))
                goal.succeed("home")
            self.goals.clear()

    async with Kernel() as kernel:
        driver, car = await pair(kernel, Hasty())
        await kernel.start(ThreadContext(2000.0), car, activate=True)

        async def one() -> None:
            goal = await driver.car.within(10.0).drive(1)
            assert [feedback async for feedback in goal] == [0.0, 1.0, 2.0]
            assert await goal.result() == "home"

        async with asyncio.timeout(20.0):
            await asyncio.gather(*(one() for _ in range(100)))
        goals = driver.car.statistics.goals
        assert goals is not None
        assert (goals.offered, goals.succeeded, goals.feedback, goals.dropped) == (100, 100, 300, 0)
