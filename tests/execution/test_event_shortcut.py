"""The short way from a sample to the hook of an idle event context does what the long way would have done."""

from __future__ import annotations

import asyncio
import random

import pytest

from aiorts import Component, EventContext, InPort, Kernel, OutPort, SimulatedClock, WouldBlock
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases


class Source(Component):
    left = OutPort(TimedLong)
    right = OutPort(TimedLong)


class Moody(Component):
    """Takes what its next number says, forwards some of it, and fails at times."""

    left = InPort(TimedLong)
    right = InPort(TimedLong)
    out = OutPort(TimedLong)

    def __init__(self, name: str, seed: int, log: list[tuple[object, ...]]) -> None:
        super().__init__(name)
        self._random = random.Random(seed)
        self._log = log

    async def on_execute(self) -> None:
        taken = []
        for port in (self.left, self.right):
            for _ in range(self._random.randrange(3)):
                try:
                    taken.append(port.read_nowait().data)
                except WouldBlock:
                    break
        self._log.append((self.name, self.context.ticks, *taken))
        if taken and self._random.random() < 0.3:
            await self.out.write(TimedLong(0, taken[0]))
        if self._random.random() < 0.1:
            await asyncio.sleep(0.001)
        if self._random.random() < 0.05:
            raise ValueError(f"{self.name} had enough")

    async def on_error(self, error: BaseException) -> None:
        self._log.append((self.name, self.context.ticks, str(error)))


def played(seed: int, debug: bool) -> list[tuple[object, ...]]:
    """What happened in a random system; in debug mode no port has a fast path, and no context a short way."""

    async def main(clock: SimulatedClock) -> list[tuple[object, ...]]:
        chance = random.Random(seed)
        log: list[tuple[object, ...]] = []
        async with Kernel(debug=debug) as kernel:
            source = await kernel.add(Source("source"))
            first = await kernel.add(Moody("a", seed, log))
            second = await kernel.add(Moody("b", seed + 1, log))
            await kernel.connect(source.left, first.left)
            await kernel.connect(source.right, first.right, subscription="new")
            await kernel.connect(first.out, second.left)
            await kernel.connect(second.out, first.left)
            context = await kernel.start(EventContext(), first, second, activate=True)
            for number in range(60):
                chance.choice((source.left, source.right)).write_nowait(TimedLong(0, number))
                if chance.random() < 0.5:
                    await asyncio.sleep(0.01)
                if chance.random() < 0.1:
                    context.trigger()
                if chance.random() < 0.1:
                    await context.reset()
                    await context.activate()
            await asyncio.sleep(1.0)
            log.append((context.ticks, *(tuple(c.statistics.dropped.items()) for c in kernel.connectors.values())))
        return log

    return simulate(main)


@pytest.mark.slow
@pytest.mark.row(28)
def test_the_short_way_and_the_long_way_give_the_same_history() -> None:
    for seed in range(cases(2000)):
        assert played(seed, debug=False) == played(seed, debug=True), f"seed {seed}"
