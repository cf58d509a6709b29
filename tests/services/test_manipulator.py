"""A manipulator as in the paper: a synchronous composite at 2 ms whose controller brakes the arm through a service."""

from __future__ import annotations

from typing import Any, Protocol

import pytest

from aiorts import Component, InPort, Kernel, OutPort, PeriodicContext, Provided, Required, SimulatedClock
from aiorts.errors import ServiceError
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble

PERIOD_NS = 2_000_000


class Brake(Protocol):
    """The brake of an arm."""

    async def engage(self, force: float) -> bool:
        """Close it; returns whether the arm had moved."""
        ...


class Arm(Component):
    """Moves as it is told, unless the brake is closed."""

    command = InPort(TimedDouble)
    position = OutPort(TimedDouble)
    brake = Provided[Brake]()

    def __init__(self) -> None:
        super().__init__("arm")
        self.at = 0.0
        self.velocity = 0.0
        self.braked_ns: int | None = None
        self.moved_ns: list[int] = []

    async def engage(self, force: float) -> bool:
        moving = self.velocity != 0.0
        self.braked_ns = self.clock.monotonic_ns()
        self.velocity = 0.0
        return moving

    def on_execute(self) -> None:
        if (order := self.command.latest) is not None and self.braked_ns is None:
            self.velocity = order.data
        if self.velocity:
            self.at += self.velocity * PERIOD_NS / 1e9
            self.moved_ns.append(self.clock.monotonic_ns())
        self.position.write_nowait(TimedDouble(self.clock.time_ns(), self.at))


class Controller(Component):
    """Drives the arm until it is too far, then brakes."""

    measured = InPort(TimedDouble)
    command = OutPort(TimedDouble)
    brake = Required[Brake](timeout=0.004)

    def __init__(self) -> None:
        super().__init__("controller")
        self.seen_ns: int | None = None
        self.answer: bool | None = None

    async def on_execute(self) -> None:
        sample = self.measured.latest
        if sample is not None and sample.data > 0.1 and self.seen_ns is None:
            self.seen_ns = self.clock.monotonic_ns()
            self.answer = await self.brake.proxy.engage(10.0)
        await self.command.write(TimedDouble(self.clock.time_ns(), 1.0))


async def built(kernel: Kernel) -> tuple[Arm, Controller]:
    arm, controller = await kernel.add(Arm()), await kernel.add(Controller())
    await kernel.connect(arm.position, controller.measured)
    await kernel.connect(controller.command, arm.command)
    await kernel.connect(controller.brake, arm.brake)
    return arm, controller


@pytest.mark.row(67)
@pytest.mark.row(71)
@pytest.mark.parametrize("together", [True, False], ids=["one context", "two contexts"])
def test_the_brake_stops_the_arm_within_two_ticks(together: bool) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            arm, controller = await built(kernel)
            members: list[tuple[Any, ...]] = [(controller, arm)] if together else [(arm,), (controller,)]
            loops = [await kernel.start(PeriodicContext(500.0), *those, activate=True) for those in members]
            await kernel.sleep(1.0)
            assert controller.answer is True
            assert controller.seen_ns is not None
            assert arm.braked_ns is not None
            assert arm.braked_ns - controller.seen_ns <= PERIOD_NS
            assert max(arm.moved_ns) - controller.seen_ns <= 2 * PERIOD_NS
            assert 0.1 < arm.at < 0.11
            assert all(loop.ticks == 500 for loop in loops)
            assert all(loop.statistics.overruns == 0 for loop in loops)

    simulate(main)


def test_a_brake_that_is_not_there_is_the_controllers_error_and_not_the_composites() -> None:
    class Hasty(Controller):
        async def on_execute(self) -> None:
            try:
                await super().on_execute()
            except ServiceError:
                self.answer = False

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            arm, hasty = await kernel.add(Arm()), await kernel.add(Hasty())
            await kernel.connect(arm.position, hasty.measured)
            await kernel.connect(hasty.command, arm.command)
            loop = await kernel.start(PeriodicContext(500.0), hasty, arm, activate=True)
            await kernel.sleep(0.5)
            assert hasty.answer is False
            assert loop.ticks == 250

    simulate(main)
