"""Whatever holds either end up, at whatever step: a link is up 2 s after both ends can talk."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from random import Random
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import AiortsError
from aiorts.links import Links
from aiorts.testing import MemoryNetwork, simulate
from campaign import cases, time_limit
from links.memory_kernels import Sink, Source, long
from links.shaky_transport import ShakyTransport, delays

WITHIN = 2.0
STEPS = (
    *("present", "gone", "ask offer", "hear offer", "answer offer", "channel"),
    *("ask request", "hear request", "answer request", "hear come"),
)


class Side:
    """One kernel, each time it is started, with its component and with its part of the connection."""

    def __init__(self, name: str, network: MemoryNetwork, random: Random, faults: Faults, *, connects: bool) -> None:
        self.name, self._network, self._random, self._faults = name, network, random, faults
        self._connects = connects
        self._tasks: list[asyncio.Future[Any]] = []
        self.kernel: Kernel
        self.transport: ShakyTransport
        self.component: Any
        self._delay, self._lost = delays(random), random.choice((0.0, 0.0, 0.3))

    async def start(self) -> None:
        self.transport = ShakyTransport(
            self._network.transport(self.name),
            self._delay,
            lambda: self._random.random() < self._lost,
            lambda step: self._faults.step(self.name, step),
        )
        self.kernel = await Kernel(self.name).open()
        self.kernel.service(Links).use(self.transport)
        writes = self.name == "one"
        self.component = await self.kernel.add(Source("source") if writes else Sink("sink"))
        ports = (self.component.out, "two/sink.inp") if writes else ("one/source.out", self.component.inp)
        begun = self.kernel.connect(*ports) if self._connects else self.kernel.service(Links).opened()
        self._tasks.append(asyncio.ensure_future(_refusable(begun)))

    async def kill(self) -> None:
        await self.transport.kill()
        self.transport.go()
        await self.kernel.aclose()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()

    def is_up(self) -> bool:
        """Whether this end of the link, the only one here, has a channel and is answered on it."""
        return list(self.kernel.service(Links).report().values()) == ["up"]


async def _refusable(begun: Awaitable[Any]) -> None:
    try:
        await begun
    except AiortsError as error:
        raise AssertionError(str(error)) from error


class Faults:
    """What holds the kernels up in one schedule: some of it at chosen steps, some at any time."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self.sides: dict[str, Side] = {}
        self._at = {
            (random.choice(("one", "two")), random.choice(STEPS)): random.randrange(3)
            for _ in range(random.randrange(4))
        }
        self._running: set[asyncio.Future[None]] = set()
        self._busy = asyncio.Lock()
        self._over = False

    def step(self, name: str, step: str) -> None:
        """A kernel is at this step."""
        left = self._at.get((name, step))
        if left is None or self._over:
            return
        self._at[name, step] = left - 1
        if left == 0:
            other = "two" if name == "one" else "one"
            self._begin(self._random.choice((self._hold(name), self._restart(other), self._held_and_restarted(name))))

    def _begin(self, fault: Callable[[], Awaitable[None]]) -> None:
        task = asyncio.ensure_future(fault())
        self._running.add(task)

    def _length(self) -> float:
        return self._random.choice((0.05, 0.5, 1.9, 2.5, 5.0)) * self._random.random()

    def _hold(self, name: str) -> Callable[[], Awaitable[None]]:
        async def hold() -> None:
            transport = self.sides[name].transport
            transport.hold()
            await asyncio.sleep(self._length())
            transport.go()

        return hold

    def _restart(self, name: str) -> Callable[[], Awaitable[None]]:
        async def restart() -> None:
            async with self._busy:
                await self.sides[name].kill()
                await asyncio.sleep(self._random.choice((0.0, 0.0, 0.3, 2.5)))
                await self.sides[name].start()

        return restart

    def _held_and_restarted(self, name: str) -> Callable[[], Awaitable[None]]:
        """The other kernel is restarted while this one stands still."""
        other = "two" if name == "one" else "one"

        async def both() -> None:
            await asyncio.gather(self._hold(name)(), self._restart(other)())

        return both

    async def run(self, network: MemoryNetwork) -> None:
        """All of it; it ends with both kernels there, neither held up, and nothing under way."""
        random = self._random
        for _ in range(random.randrange(5)):
            await asyncio.sleep(random.choice((0.0, 0.001, 0.2, 1.0, 3.0)) * random.random())
            name = random.choice(("one", "two"))
            self._begin(random.choice((self._hold(name), self._restart(name), self._held_and_restarted(name))))
            if random.random() < 0.2:
                network.cut("one", "two")
                await asyncio.sleep(self._length())
                network.restore("one", "two")
        while self._running or any(side.transport.losing for side in self.sides.values()):
            done, self._running = self._running, set()
            await asyncio.gather(*done)
            await asyncio.sleep(0.01)
        self._over = True
        for side in self.sides.values():
            side.transport.be_calm()
            side.transport.go()


async def schedule(seed: int) -> float:
    """How many seconds after both ends can talk the link is up, and has carried a sample."""
    random = Random(seed)
    network = MemoryNetwork(seed=seed, delay=random.choice((0.0, 0.001, 0.02)))
    faults = Faults(random)
    who = random.choice(("one", "two"))
    for name in random.sample(("one", "two"), 2):
        faults.sides[name] = Side(name, network, random, faults, connects=name == who)
        await faults.sides[name].start()
        await asyncio.sleep(random.choice((0.0, 0.0, 0.5)))
    await faults.run(network)
    loop = asyncio.get_running_loop()
    since, sides = loop.time(), faults.sides.values()
    one, two = faults.sides["one"], faults.sides["two"]
    two.component.inp.drain()
    while not all(side.is_up() for side in sides) or two.component.inp.peek() is None:
        reports = [side.kernel.service(Links).report() for side in sides]
        assert loop.time() - since <= WITHIN, (seed, reports)
        one.component.out.write_nowait(long(1))
        await asyncio.sleep(0.01)
    took = loop.time() - since
    for _ in range(30):
        two.component.inp.drain()
        await asyncio.sleep(0.1)
    assert all(side.is_up() for side in sides), seed  # nothing that was late takes it down again
    assert [len(side.kernel.connectors) for side in sides] == [1, 1], seed
    for side in sides:
        await side.kill()
    return took


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E06")
@pytest.mark.timeout(time_limit(600))
@pytest.mark.parametrize("part", range(5))
def test_a_link_is_up_two_seconds_after_both_ends_can_talk_whatever_held_them_up(part: int) -> None:
    many = cases(5_000) // 5
    for seed in range(part * many, (part + 1) * many):
        simulate(schedule(seed), seed=seed)
