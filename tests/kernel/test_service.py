"""A service hears what comes and goes, from the kernel it is attached to, in order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts import Component, InPort, Kernel, KernelService, OutPort
from aiorts.testing import simulated

if TYPE_CHECKING:
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector


class Source(Component):
    """Gives numbers."""

    out = OutPort(float)


class Sink(Component):
    """Takes numbers."""

    inp = InPort(float)


class Listening(KernelService):
    """Keeps what it was told."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.heard: list[str] = []

    def component_added(self, component: Component) -> None:
        self.heard.append(f"added {component.name}")

    def component_removed(self, component: Component) -> None:
        self.heard.append(f"removed {component.name}")

    def connector_made(self, connector: Connector) -> None:
        self.heard.append("connected")

    async def closing(self, budget: StopBudget) -> None:
        self.heard.append("closing")

    def stopped(self) -> None:
        self.heard.append("stopped")

    async def leaving(self, budget: StopBudget) -> None:
        await self.kernel.sleep(0.2)
        self.heard.append("left")

    def closed(self) -> None:
        self.heard.append("closed")


@simulated
async def test_a_service_hears_what_comes_and_goes() -> None:
    async with Kernel() as kernel:
        before = await kernel.add(Source("before"))
        service = kernel.service(Listening)
        assert kernel.service(Listening) is service
        source, sink = await kernel.add(Source("source")), await kernel.add(Sink("sink"))
        await kernel.connect(source.out, sink.inp)
        await kernel.remove(before)
        assert service.heard == ["added source", "added sink", "connected", "removed before"]
    assert service.heard[4] == "closing"
    assert sorted(service.heard[5:-3]) == ["removed sink", "removed source"]
    assert service.heard[-3:] == ["stopped", "left", "closed"]
