"""What the tests of services share: an interface, providers that behave in every way, and callers."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Protocol

from aiorts import Component, Provided, Required

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable

    from aiorts import Kernel


class Brake(Protocol):
    """Stops an arm."""

    async def stop(self, force: float = 1.0) -> float:
        """Brake with so many newtons; returns what was taken."""
        ...

    async def held(self) -> bool: ...


class Quick(Protocol):
    """Answers without waiting."""

    def count(self) -> int: ...


class PlainBrake(Component):
    """Answers in plain methods."""

    service = Provided[Brake]()

    def __init__(self, name: str = "brake0") -> None:
        super().__init__(name)
        self.forces: list[float] = []

    def stop(self, force: float = 1.0) -> float:
        self.forces.append(force)
        return force / 2

    def held(self) -> bool:
        return bool(self.forces)


class Scripted(Component):
    """Answers `stop` with whatever `script` does; notes what happens inside."""

    service = Provided[Brake]()

    def __init__(self, script: Callable[[Scripted], Awaitable[Any]], name: str = "brake0") -> None:
        super().__init__(name)
        self.script = script
        self.notes: list[str] = []

    async def stop(self, force: float = 1.0) -> float:
        self.notes.append("begun")
        try:
            value: float = await self.script(self)
        except asyncio.CancelledError:
            self.notes.append("cancelled")
            raise
        self.notes.append("done")
        return value

    async def held(self) -> bool:
        return False


class Arm(Component):
    """Asks for a brake."""

    brake = Required[Brake]()

    def __init__(self, name: str = "arm") -> None:
        super().__init__(name)


async def wired(kernel: Kernel, provider: Any) -> Arm:
    """An arm whose brake is `provider`."""
    arm = await kernel.add(Arm())
    await kernel.add(provider)
    await kernel.connect(arm.brake, provider.service)
    return arm


async def forever(_: Any) -> float:
    await asyncio.Event().wait()
    return 0.0


def ignoring_cancellation() -> tuple[asyncio.Event, Callable[[Any], Awaitable[float]]]:
    """A script that goes on whatever happens, and the event that ends it."""
    free = asyncio.Event()

    async def stubborn(_: Any) -> float:
        while not free.is_set():
            try:
                await free.wait()
            except asyncio.CancelledError:
                continue
        return 0.0

    return free, stubborn


async def drain(items: AsyncIterator[Any]) -> list[Any]:
    return [item async for item in items]
