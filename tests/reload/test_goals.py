"""Goals across a reload: new code knows none of them, so a provider's fail, and a client's are asked to cancel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from aiorts import Kernel
from aiorts.errors import GoalCancelled, GoalFailed
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

CODE = """
import services.goal_parts

class Car(services.goal_parts.Car):
    version = 1

class Driver(services.goal_parts.Driver):
    version = 1
"""


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("who", ["Car", "Driver"])
def test_a_reload_ends_goals_in_order(who: str, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(CODE)
        async with Kernel() as kernel:
            driver = await kernel.add(file.get("Driver")("driver"))
            car = await kernel.add(file.get("Car")("car"))
            await kernel.connect(driver.car, car.service)
            goal = await driver.car.proxy.drive(10)
            file.replace("version = 1", "version = 2")
            await kernel.reload(who, cycles=0)
            assert car.goals[0].cancel_requested
            if who == "Car":
                with pytest.raises(GoalFailed, match="car was replaced by another instance") as caught:
                    await goal.result()
                assert caught.value.reason == "reloaded"
                new = kernel.components["car"]
                assert (await driver.car.proxy.drive(1)).state == "running"
                assert len(new.goals) == 1  # type: ignore[attr-defined] # the class of this file
            else:
                assert goal.state == "running"
                assert car.goals[0].cancelled()
                with pytest.raises(GoalCancelled, match="driver was replaced by another instance"):
                    await goal.result()

    run()
