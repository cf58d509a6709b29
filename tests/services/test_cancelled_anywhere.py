"""Every public coroutine of service ports, cancelled at every turn of the loop: nothing stuck, nothing abandoned."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, ExternalContext, Kernel, Provided, Required, SimulatedClock, ThreadContext
from aiorts.errors import ServiceError
from aiorts.kernel.execution.cell import cell
from aiorts.testing.simulation import simulate
from services.parts import Arm, Brake, wired
from services_api import waits

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

TURNS = 25
pytestmark = pytest.mark.fault("G05")


class Busy(Component):
    """Its hook takes three turns of the loop, its method four; it waits for time in one of them."""

    service = Provided[Brake]()

    def __init__(self) -> None:
        super().__init__("brake0")
        self.inside = self.most = 0

    async def _take(self, turns: int) -> None:
        self.inside += 1
        self.most = max(self.most, self.inside)
        try:
            for _ in range(turns):
                await asyncio.sleep(0)
            await self.sleep(0.001)
        finally:
            self.inside -= 1

    async def on_execute(self) -> None:
        await self._take(3)

    async def stop(self, force: float = 1.0) -> float:
        await self._take(4)
        return force

    def held(self) -> bool:
        assert self.inside == 0
        return True


class Plain(Component):
    service = Provided[Brake]()

    def stop(self, force: float = 1.0) -> float:
        return force

    def held(self) -> bool:
        return True


async def cancelled_after(turns: int, what: Callable[[], Awaitable[Any]]) -> bool:
    async def run() -> None:
        await what()

    task = asyncio.create_task(run())
    for _ in range(turns):
        await asyncio.sleep(0)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return task.cancelled()


def whole(kernel: Kernel, component: Component) -> None:
    """Nothing of a call is left."""
    assert cell(component).entry_lock.open
    assert not waits(kernel)
    for connector in kernel.service_connectors.values():
        assert all(not link.calls for link in connector.links)
    assert not kernel.registry.tasks


@pytest.mark.parametrize("method", ["stop", "held"])
@pytest.mark.parametrize("hook", [False, True], ids=["alone", "while a hook runs"])
def test_a_call(method: str, hook: bool) -> None:
    async def main() -> int:
        cancelled = 0
        for turns in range(TURNS):
            async with Kernel() as kernel:
                brake = Busy()
                arm = await wired(kernel, brake)
                loop = await kernel.start(ExternalContext(), brake, activate=True)
                ticking = asyncio.ensure_future(loop.tick()) if hook else None
                await asyncio.sleep(0)
                queued = asyncio.ensure_future(arm.brake.proxy.stop(7.0))
                was = await cancelled_after(turns, getattr(arm.brake.proxy, method))
                cancelled += was
                assert await queued == 7.0
                if ticking is not None:
                    await ticking
                assert await arm.brake.proxy.stop(2.0) == 2.0
                await loop.tick()
                whole(kernel, brake)
                assert brake.most == 1
                counts = brake.service.statistics
                assert counts.calls == 3 - (turns == 0)
                assert counts.cancelled == was - (turns == 0)
        return cancelled

    assert simulate(main()) >= 5


def test_a_call_that_goes_through_another_component() -> None:
    class Through(Component):
        service = Provided[Brake]()
        brake = Required[Brake]()

        async def stop(self, force: float = 1.0) -> float:
            return await self.brake.proxy.stop(force)

        def held(self) -> bool:
            return True

    async def main() -> None:
        for turns in range(TURNS):
            async with Kernel() as kernel:
                brake, through = Busy(), await kernel.add(Through("through"))
                await kernel.add(brake)
                await kernel.connect(through.brake, brake.service)
                arm = await kernel.add(Arm())
                await kernel.connect(arm.brake, through.service)
                await cancelled_after(turns, arm.brake.proxy.stop)
                await kernel.sleep(0.01)
                assert brake.inside == 0
                for one in (brake, through):
                    whole(kernel, one)
                assert await arm.brake.proxy.stop(3.0) == 3.0

    simulate(main())


def test_a_call_that_a_thread_serves() -> None:
    async def main() -> None:
        for turns in range(0, TURNS, 3):
            async with Kernel() as kernel:
                brake = await kernel.add(Plain("brake0"))
                arm = await kernel.add(Arm())
                await kernel.connect(arm.brake, brake.service)
                await kernel.start(ThreadContext(100.0), brake, activate=True)
                await cancelled_after(turns, arm.brake.proxy.stop)
                assert await arm.brake.proxy.stop(3.0) == 3.0
                whole(kernel, brake)

    simulate(main())


def test_waiting_until_somebody_is_there() -> None:
    async def main() -> None:
        for turns in range(5):
            async with Kernel() as kernel:
                arm, brake = await kernel.add(Arm()), await kernel.add(Plain("brake0"))
                assert await cancelled_after(turns, arm.brake.wait_bound)
                assert await cancelled_after(turns, arm.brake.port.wait_bound)
                assert not arm.brake.port._waiting
                await kernel.connect(arm.brake, brake.service)
                await arm.brake.wait_bound()

    simulate(main())


@pytest.mark.parametrize("what", ["remove", "close", "disconnect", "stop"])
def test_the_provider_goes_at_any_moment_of_a_call(what: str) -> None:
    async def main(clock: SimulatedClock) -> None:
        for turns in range(TURNS):
            async with Kernel() as kernel:
                brake = Busy()
                arm = await wired(kernel, brake)
                loop = await kernel.start(ExternalContext(), brake, activate=True)
                ticking = asyncio.ensure_future(loop.tick())
                calls = [asyncio.ensure_future(arm.brake.within(50.0).stop()) for _ in range(3)]
                for _ in range(turns):
                    await asyncio.sleep(0)
                if what == "remove":
                    await kernel.remove(brake)
                elif what == "close":
                    await kernel.aclose()
                elif what == "stop":
                    await loop.stop()
                else:
                    await kernel.disconnect(arm.brake.connectors[0])
                begun = clock.monotonic_ns()
                for outcome in await asyncio.gather(*calls, return_exceptions=True):
                    assert outcome == 1.0 or isinstance(outcome, ServiceError)
                assert clock.monotonic_ns() - begun < 100_000_000
                await asyncio.gather(ticking, return_exceptions=True)
                await asyncio.sleep(0.01)
                assert cell(brake).entry_lock.open
                assert not waits(kernel)
                assert not kernel.registry.tasks

    simulate(main)
