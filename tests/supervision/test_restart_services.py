"""A component that is made anew has its service connections again, at both ends; who was in a call is told."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import Any, Protocol

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    Provided,
    Required,
    SimulatedClock,
    Supervision,
)
from aiorts.errors import ServiceFailed, ServiceUnavailable
from aiorts.events import ComponentRecovered
from aiorts.testing import simulated
from aiorts.types import TimedLong

RESTART = Supervision("restart", backoff=0.5)


class Brake(Protocol):
    async def stop(self, force: float) -> float: ...


class Lamp(Protocol):
    async def light(self) -> str: ...


class Disc(Component):
    """Provides a brake and asks for a lamp; breaks when told so."""

    service = Provided[Brake](concurrent=True)
    weak = Provided[Brake](failure="error", concurrent=True)
    lamp = Required[Lamp](timeout=1.0)
    orders = InPort(TimedLong)

    def on_activated(self) -> None:
        self.lit = ""

    async def on_execute(self) -> None:
        if self.orders.is_new and self.orders.read_nowait().data == 13:
            raise RuntimeError("broke")
        with contextlib.suppress(ServiceUnavailable):
            self.lit = await self.lamp.proxy.light()

    async def stop(self, force: float) -> float:
        if force < 0.0:
            raise ValueError("cannot push")
        await self.sleep(force)
        return force


class Arm(Component):
    brake = Required[Brake](timeout=30.0)
    other = Required[Brake](timeout=30.0)
    every = Required[Brake](timeout=30.0, many=True)
    lamp = Provided[Lamp]()
    orders = OutPort(TimedLong)

    async def light(self) -> str:
        return f"green {self.name}"


async def system(kernel: Kernel) -> tuple[Arm, Disc]:
    arm, disc = await kernel.add(Arm("arm")), await kernel.add(Disc("disc"))
    await kernel.connect(arm.orders, disc.orders)
    await kernel.connect(arm.brake, disc.service, name="brake")
    await kernel.connect(arm.other, disc.weak, name="weak")
    await kernel.connect(arm.every, disc.service, disc.weak)
    await kernel.connect(disc.lamp, arm.lamp, name="lamp")
    await kernel.start(EventContext(name="arms"), arm, activate=True)
    await kernel.start(PeriodicContext(10.0, name="discs"), disc, activate=True)
    return arm, disc


def bound(kernel: Kernel) -> dict[str, tuple[tuple[str, str], ...]]:
    return {name: connector.profile.mapping for name, connector in kernel.service_connectors.items()}


@pytest.mark.fault("A18", "B20")
@pytest.mark.row(17)
@simulated
async def test_a_provider_made_anew_is_called_and_calls_as_before(simulated_clock: SimulatedClock) -> None:
    async with Kernel() as kernel:
        arm, disc = await system(kernel)
        before, proxy = bound(kernel), arm.brake.proxy
        kernel.supervise(disc, RESTART)
        arm.orders.write_nowait(TimedLong(0, 13))
        # It is in the middle of this call when it breaks, and when it goes.
        call = asyncio.create_task(proxy.stop(20.0))
        begun = simulated_clock.monotonic_ns()
        with pytest.raises(ServiceUnavailable, match=r"arm\.brake -> disc\.service\.stop: .*being removed"):
            await call
        assert simulated_clock.monotonic_ns() - begun < 1_000_000_000
        await arm.brake.wait_bound()
        await kernel.wait_ready("disc")
        new: Any = kernel.components["disc"]
        assert new is not disc
        assert bound(kernel) == before
        assert await proxy.stop(0.5) == 0.5
        assert len(arm.every.proxies) == 2
        assert [await one.stop(0.1) for one in arm.every.proxies] == [0.1, 0.1]
        await kernel.sleep(0.3)
        assert new.lit == "green arm"
        assert disc.service.connectors == disc.lamp.connectors == ()


@pytest.mark.fault("B20")
@simulated
async def test_between_its_end_and_its_return_a_call_says_so_at_once(simulated_clock: SimulatedClock) -> None:
    class Slow(Disc):
        async def on_initialize(self) -> None:
            await self.sleep(1.0)

    async with Kernel() as kernel:
        arm, disc = await system(kernel)
        kernel.supervise(disc, RESTART, factory=Slow)
        with pytest.raises(ServiceFailed, match="cannot push"):
            await arm.other.proxy.stop(-1.0)
        await kernel.sleep(1.0)
        assert not arm.brake.is_bound
        begun = simulated_clock.monotonic_ns()
        with pytest.raises(ServiceUnavailable, match="is not connected"):
            await arm.brake.proxy.stop(0.1)
        assert simulated_clock.monotonic_ns() == begun
        await arm.brake.wait_bound()
        await kernel.wait_ready("disc")
        assert await arm.brake.proxy.stop(0.1) == 0.1


@pytest.mark.fault("A18")
@simulated
async def test_a_caller_made_anew_calls_and_answers_as_before(simulated_clock: SimulatedClock) -> None:
    class Failing(Arm):
        async def on_execute(self) -> None:
            await self.brake.proxy.stop(0.1)
            raise RuntimeError("tired")

    async with Kernel() as kernel:
        helped: list[ComponentRecovered] = []
        kernel.bus.subscribe(ComponentRecovered, helped.append)
        arm, disc = await kernel.add(Failing("arm")), await kernel.add(Disc("disc"))
        await kernel.connect(arm.brake, disc.service)
        await kernel.connect(disc.lamp, arm.lamp)
        before = bound(kernel)
        await kernel.start(PeriodicContext(10.0), disc, activate=True)
        context = await kernel.start(PeriodicContext(10.0), arm, activate=True)
        kernel.supervise(arm, RESTART, factory=Arm)
        await kernel.sleep(3.0)
        new: Any = kernel.components["arm"]
        assert len(helped) == 1
        assert new is not arm
        assert new.states == {context.name: LifecycleState.ACTIVE}
        assert bound(kernel) == before
        assert await new.brake.proxy.stop(0.1) == 0.1
        assert disc.lit == "green arm"


@simulated
async def test_what_cannot_be_bound_again_is_said_and_the_rest_is(
    simulated_clock: SimulatedClock, caplog: pytest.LogCaptureFixture
) -> None:
    class Other(Component):
        service = Provided[Brake](concurrent=True)
        orders = InPort(TimedLong)

        async def stop(self, force: float) -> float:
            return force

    caplog.set_level(logging.WARNING)
    async with Kernel() as kernel:
        arm, disc = await system(kernel)
        kernel.supervise(disc, RESTART, factory=Other)
        arm.orders.write_nowait(TimedLong(0, 13))
        await kernel.sleep(2.0)
        assert kernel.components["disc"].state is LifecycleState.ACTIVE
        assert await arm.brake.proxy.stop(0.1) == 0.1
        assert not arm.other.is_bound
        lines = [record.getMessage() for record in caplog.records if "not connected again" in record.getMessage()]
        assert sorted(line.partition(":")[0] for line in lines) == ["arm.every-disc.weak", "lamp", "weak"]
