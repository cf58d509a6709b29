"""A provider whose exceptions and answers cannot even be printed: the caller is told, and nobody is stuck."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts import Component, ExternalContext, Kernel, Provided, ThreadContext
from aiorts.errors import InterfaceMismatch, ServiceFailed
from aiorts.testing import simulated
from services.parts import Arm, Brake


class Unprintable(Exception):
    """Whoever makes text of it fails."""

    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


class Waits(Component):
    service = Provided[Brake]()
    fails = True
    ran = 0

    def on_execute(self) -> None:
        self.ran += 1

    async def stop(self, force: float = 1.0) -> float:
        if self.fails:
            raise Unprintable
        return force

    def held(self) -> bool:
        if self.fails:
            return Unprintable()  # type: ignore[return-value]
        return True


class Plain(Waits):
    def stop(self, force: float = 1.0) -> float:  # type: ignore[override]
        if self.fails:
            raise Unprintable
        return force


async def _fails_and_serves_again(kernel: Kernel, arm: Arm, provider: Waits) -> None:
    with pytest.raises(ServiceFailed, match=r"raised Unprintable: \(its text cannot be had\)"):
        await arm.brake.proxy.stop()
    provider.fails = False
    assert await arm.brake.proxy.stop(2.0) == 2.0
    counts = provider.service.statistics
    assert (counts.calls, counts.failures, counts.timeouts) == (2, 1, 0)


@pytest.mark.fault("B20")
@pytest.mark.parametrize("kind", [Waits, Plain])
@simulated
async def test_an_exception_without_a_text_reaches_the_caller_and_the_next_call_is_served(kind: type[Waits]) -> None:
    async with Kernel() as kernel:
        provider, arm = await kernel.add(kind("brake0")), await kernel.add(Arm())
        await kernel.connect(arm.brake, provider.service)
        loop = await kernel.start(ExternalContext(), provider, activate=True)
        await _fails_and_serves_again(kernel, arm, provider)
        await loop.tick()
        assert provider.ran == 1


@pytest.mark.fault("B20")
@pytest.mark.anyio
async def test_so_does_one_of_a_provider_in_a_thread() -> None:
    async with Kernel() as kernel:
        provider, arm = await kernel.add(Plain("brake0")), await kernel.add(Arm())
        await kernel.connect(arm.brake, provider.service)
        await kernel.start(ThreadContext(200.0), provider, activate=True)
        await _fails_and_serves_again(kernel, arm, provider)


@pytest.mark.fault("B20")
@simulated
async def test_an_answer_of_a_wrong_type_that_cannot_be_printed_is_a_mismatch() -> None:
    async with Kernel() as kernel:
        provider, arm = await kernel.add(Waits("brake0")), await kernel.add(Arm())
        await kernel.connect(arm.brake, provider.service)
        proxy: Any = arm.brake.proxy
        with pytest.raises(InterfaceMismatch, match="answered with Unprintable <Unprintable that cannot be shown>"):
            await proxy.held()
        provider.fails = False
        assert await proxy.held() is True
