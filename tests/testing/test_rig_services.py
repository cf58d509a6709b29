"""A rig with services: a fake answers what is required, a test calls what is provided; in virtual time on any loop."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import Component, Goal, Provided, Required
from aiorts.errors import DeclarationError, GoalFailed, ServiceFailed, WiringError
from aiorts.testing import Rig
from services.goal_parts import Car, Driver
from services.parts import Brake, Quick

pytestmark = pytest.mark.anyio


class Fake:
    def __init__(self) -> None:
        self.forces: list[float] = []

    async def stop(self, force: float = 1.0) -> float:
        self.forces.append(force)
        await asyncio.sleep(0)
        return force

    def held(self) -> bool:
        return True


class Guard(Component):
    """Brakes in each cycle, and when it is asked to."""

    brake = Required[Brake]()
    service = Provided[Brake](port="both")
    counter = Provided[Quick](port="both")

    def __init__(self, name: str = "guard") -> None:
        super().__init__(name)
        self.asked = 0

    async def on_execute(self) -> None:
        await self.brake.proxy.stop(2.0)

    async def stop(self, force: float = 1.0) -> float:
        self.asked += 1
        await self.sleep(2.0)
        if force < 0:
            raise ValueError("negative")
        return await self.brake.proxy.stop(force)

    def held(self) -> bool:
        return False

    def count(self) -> int:
        return self.asked


@pytest.mark.row(7)
@pytest.mark.row(67)
async def test_a_fake_answers_and_a_test_asks(anyio_backend: Any) -> None:
    fake = Fake()
    async with Rig(Guard(), rate=10.0) as rig:
        rig.provide("brake", fake)
        await rig.tick(3)
        assert fake.forces == [2.0] * 3
        assert await rig.call("guard.both.service", "stop", 5.0) == 5.0
        assert await rig.call("guard.both.service", "stop", force=6.0) == 6.0
        assert fake.forces[3:] == [5.0, 6.0]
        with pytest.raises(ServiceFailed, match="negative"):
            await rig.call("guard.both.service", "stop", -1.0)
        assert await rig.call("guard.both.counter", "count") == 3


async def test_what_a_rig_cannot_do_says_why(anyio_backend: Any) -> None:
    async with Rig(Guard()) as rig:
        with pytest.raises(DeclarationError, match="does not provide Brake"):
            rig.provide("guard.brake", object())
        with pytest.raises(WiringError, match=r"2 provided interfaces here; there are guard\.both\.service"):
            await rig.call("guard.both", "stop")
        with pytest.raises(WiringError, match="no provided interfaces here"):
            await rig.call("guard.brake", "stop")
        rig.provide("guard.brake", Fake())
        with pytest.raises(WiringError, match="is bound to"):
            rig.provide("guard.brake", Fake())


async def test_a_fake_takes_goals_and_a_test_offers_them(anyio_backend: Any) -> None:
    class Fake:
        def __init__(self) -> None:
            self.goal: Goal[float, str] = Goal()

        def drive(self, metres: int) -> Goal[float, str]:
            return self.goal

    class Going(Driver):
        goal: Goal[float, str] | None = None
        seen = "nothing"

        async def on_execute(self) -> None:
            if self.goal is None:
                self.goal = await self.car.proxy.drive(5)
            self.seen = self.goal.state

    fake = Fake()
    going = Going()
    async with Rig(going, rate=10.0) as rig:
        rig.provide("driver.car", fake)
        await rig.tick()
        assert (fake.goal.state, going.seen) == ("running", "running")
        assert fake.goal.succeed("home")
        await rig.tick()
        assert going.seen == "succeeded"

    async with Rig(Car(), rate=10.0) as rig:
        goal = await rig.call("car.service", "drive", 5)
        assert goal.state == "running"
        await rig.deactivate()
        with pytest.raises(GoalFailed, match="car went to inactive"):
            await goal.result()
