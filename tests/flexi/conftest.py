"""What the tests of the Flexi components share: a system of one component between a feeder and a collector."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort
from aiorts_flexi.mapping.filter import FlexiFilter

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence


class Harness:
    """A FlexiFilter with an out-port of our own on each of its in-ports and an in-port on each of its out-ports."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel = kernel

    async def build(self, inputs: Sequence[str], outputs: Sequence[str], map_: str, **rules: Any) -> None:
        """Make the filter, active in a context of its own."""
        self.filter = await self.kernel.create(
            FlexiFilter, "filter", inputs=tuple(inputs), outputs=tuple(outputs), map=map_, **rules
        )
        self.feeder = await self.kernel.create(Component, "feeder")
        self.taker = await self.kernel.create(Component, "taker")
        for port in list(self.filter.ports.values()):
            if isinstance(port, InPort):
                feed: OutPort[Any] = self.feeder.add_port(f"to_{port.name}", OutPort(port.type))
                await self.kernel.connect(feed, port, full="block", timeout=None)
            else:
                take: InPort[Any] = self.taker.add_port(f"from_{port.name}", InPort(port.type))
                await self.kernel.connect(port, take, length=10_000)
        self.context = await self.kernel.start(EventContext(), self.filter, activate=True)

    async def feed(self, number: int, *samples: Any) -> None:
        """Write samples to an in-port of the filter, waiting for room."""
        port = self.feeder.ports[f"to_input{number}"]
        assert isinstance(port, OutPort)
        for sample in samples:
            await port.write(sample)

    async def take(self, number: int, count: int = 1) -> list[Any]:
        """The next samples of an out-port of the filter."""
        port = self.taker.ports[f"from_output{number}"]
        assert isinstance(port, InPort)
        return [await port.read() for _ in range(count)]

    def left(self, number: int) -> list[Any]:
        """What an out-port has sent and nobody has taken yet."""
        port = self.taker.ports[f"from_output{number}"]
        assert isinstance(port, InPort)
        return port.drain()


@pytest.fixture
async def harness() -> AsyncIterator[Harness]:
    """An empty harness in an open kernel."""
    async with Kernel() as kernel:
        yield Harness(kernel)
