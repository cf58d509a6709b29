"""What the tests of goals share: an interface, a provider that is advanced by hand or by its hook, and a client."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from aiorts import Component, Goal, Provided, Required

if TYPE_CHECKING:
    from aiorts import Kernel


class Driving(Protocol):
    """Drives somewhere."""

    async def drive(self, metres: int) -> Goal[float, str]:
        """Feedback: metres driven so far."""
        ...


class Car(Component):
    """Keeps its goals; tests advance them."""

    service = Provided[Driving](cancel_timeout=2.0)

    def __init__(self, name: str = "car") -> None:
        super().__init__(name)
        self.goals: list[Goal[float, str]] = []
        self.executed = 0

    def on_execute(self) -> None:
        self.executed += 1

    def drive(self, metres: int) -> Goal[float, str]:
        if metres > 100:
            raise ValueError("too far")
        self.goals.append(Goal())
        return self.goals[-1]


class Driver(Component):
    """The client."""

    car = Required[Driving]()

    def __init__(self, name: str = "driver") -> None:
        super().__init__(name)


async def pair(kernel: Kernel, car: Any = None) -> tuple[Driver, Car]:
    """A driver whose car is `car`."""
    driver = await kernel.add(Driver())
    car = await kernel.add(Car() if car is None else car)
    await kernel.connect(driver.car, car.service)
    return driver, car
