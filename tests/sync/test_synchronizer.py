"""Synchronisers of components: reading, waiting, activation, and what is refused."""

from __future__ import annotations

import asyncio
import math
import random
from typing import Any

import pytest

from aiorts import (
    Component,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    SimulatedClock,
    Synchronizer,
    ThreadContext,
    WouldBlock,
    wait_any,
)
from aiorts.errors import BusyError, ClosedError, ConfigurationError, ReadTimeout
from aiorts.testing import simulated
from aiorts.testing.simulation import simulate
from aiorts.types import TimedDouble, TimedLong
from campaign import cases
from sync.model import MODELS


class Fusion(Component):
    a = InPort(TimedLong)
    b = InPort(TimedLong)
    c = InPort(TimedDouble)
    plain = InPort(float)

    def __init__(self, name: str | None = None, **options: Any) -> None:
        super().__init__(name)
        self.sync = Synchronizer(self.a, self.b, self.c, **options)
        self.matches: list[tuple[int, ...]] = []

    def on_execute(self) -> None:
        self.matches += [stamps(match) for match in self.sync.drain()]


class Sensors(Component):
    a = OutPort(TimedLong)
    b = OutPort(TimedLong)
    c = OutPort(TimedDouble)

    def send(self, port: str, *stamps: int) -> None:
        for tm in stamps:
            if port == "c":
                self.c.write_nowait(TimedDouble(tm, 0.0))
            else:
                (self.a if port == "a" else self.b).write_nowait(TimedLong(tm, 0))


def stamps(match: tuple[Any, ...]) -> tuple[int, ...]:
    return tuple(sample.tm for sample in match)


async def system(kernel: Kernel, **options: Any) -> tuple[Sensors, Fusion]:
    sensors, fusion = await kernel.add(Sensors()), await kernel.add(Fusion(**options))
    for port in ("a", "b", "c"):
        await kernel.connect(sensors.ports[port], fusion.ports[port], length=64)
    return sensors, fusion


@simulated
async def test_a_match_is_one_sample_of_each_port_in_their_order() -> None:
    async with Kernel() as kernel:
        sensors, fusion = await system(kernel, policy="exact")
        sync = fusion.sync
        with pytest.raises(WouldBlock, match=r"fusion0\.a, fusion0\.b, fusion0\.c\): no match"):
            sync.match_nowait()
        sensors.send("c", 1, 3)
        sensors.send("a", 1, 2, 3)
        sensors.send("b", 3, 1, 4)
        a, b, c = sync.match_nowait()
        assert (type(a), type(b), type(c)) == (TimedLong, TimedLong, TimedDouble)
        assert stamps((a, b, c)) == (3, 3, 3)
        assert sync.drain() == []
        counts = sync.statistics
        assert list(counts) == ["a", "b", "c"]
        assert all(one.balanced for one in counts.values())
        assert (counts["a"].dropped, counts["b"].dropped) == ({"unmatched": 2}, {"late": 1})
        assert (counts["b"].taken, counts["b"].matched, counts["b"].held) == (3, 1, 1)


@simulated
async def test_what_lies_unread_at_one_port_is_no_overflow_of_another() -> None:
    async with Kernel() as kernel:
        sensors, fusion = await system(kernel, policy="exact", length=1)
        for port in ("a", "b", "c"):
            sensors.send(port, *range(50))
        assert [match[0].tm for match in fusion.sync.drain()] == list(range(50))


@simulated
async def test_a_match_is_waited_for_and_a_cancelled_wait_loses_nothing() -> None:
    async with Kernel() as kernel:
        sensors, fusion = await system(kernel)
        sync = fusion.sync
        waiting = asyncio.create_task(sync.match())
        await asyncio.sleep(1.0)
        sensors.send("a", 10)
        await asyncio.sleep(1.0)
        with pytest.raises(BusyError):
            await wait_any(fusion.b)
        waiting.cancel()
        await asyncio.wait([waiting])
        waiting = asyncio.create_task(sync.match(timeout=5.0))
        await asyncio.sleep(1.0)
        sensors.send("c", 10)
        await asyncio.sleep(1.0)
        assert not waiting.done()
        sensors.send("b", 10)
        assert stamps(await waiting) == (10, 10, 10)
        began = kernel.clock.time()
        with pytest.raises(ReadTimeout, match=r"fusion0\.a, fusion0\.b, fusion0\.c: no match within 2\.5 s"):
            await sync.match(timeout=2.5)
        assert kernel.clock.time() == began + 2.5
        with pytest.raises(ConfigurationError, match="timeout = -1"):
            await sync.match(timeout=-1)
        waiting = asyncio.create_task(sync.match())
        await asyncio.sleep(1.0)
        fusion.remove_port("b")
        with pytest.raises(ClosedError, match=r"fusion0\.b"):
            await waiting
        with pytest.raises(ClosedError, match=r"fusion0\.b"):
            sync.match_nowait()


@simulated
async def test_what_is_held_when_the_component_is_deactivated_is_dropped_as_inactive() -> None:
    async with Kernel() as kernel:
        sensors, fusion = await system(kernel, policy="exact")
        context = await kernel.start(EventContext(), fusion, activate=True)
        sensors.send("a", 100, 200)
        sensors.send("b", 100)
        await asyncio.sleep(1.0)
        assert fusion.sync.statistics["a"].held == 2
        await context.deactivate()
        for _ in range(2):
            counts = fusion.sync.statistics
            assert (counts["a"].held, counts["a"].dropped) == (0, {"inactive": 2})
            assert (counts["b"].held, counts["b"].dropped) == (0, {"inactive": 1})
            await context.activate()
        sensors.send("c", 100)
        for port in ("a", "b", "c"):
            sensors.send(port, 50 if port != "c" else 150)
        await asyncio.sleep(1.0)
        assert fusion.matches == []
        sensors.send("a", 160)
        sensors.send("b", 160)
        sensors.send("c", 160)
        await asyncio.sleep(1.0)
        assert fusion.matches == [(160, 160, 160)]
        assert all(one.balanced for one in fusion.sync.statistics.values())


def test_a_hook_in_a_thread_matches_too() -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            sensors, fusion = await system(kernel, policy="exact")
            await kernel.start(ThreadContext(), fusion, activate=True)
            for port in ("a", "b", "c"):
                sensors.send(port, *range(20))
            async with asyncio.timeout(20.0):
                while len(fusion.matches) < 20:
                    await asyncio.sleep(0.005)
            assert fusion.matches == [(tm,) * 3 for tm in range(20)]

    asyncio.run(main())


@pytest.mark.slow(kept_by="test_a_match_is_one_sample_of_each_port_in_their_order")
@pytest.mark.parametrize("policy", ["exact", "nearest", "latest"])
def test_the_same_samples_give_the_same_matches_in_any_context_and_order(policy: str) -> None:
    """The writers take turns as it comes, and what is ready at one instant runs in another order for each seed."""
    within = None if policy == "exact" else 3

    async def matches(seed: int, streams: list[list[int]]) -> list[tuple[int, ...]]:
        draw = random.Random(seed)
        async with Kernel() as kernel:
            tolerance = None if within is None else within * 1e-9
            sensors, fusion = await system(kernel, policy=policy, tolerance=tolerance, length=64)
            context = draw.choice([EventContext(), EventContext(every=0.003), PeriodicContext(rate=100.0)])
            await kernel.start(context, fusion, activate=True)

            async def send(port: str, stream: list[int]) -> None:
                for tm in stream:
                    sensors.send(port, tm)
                    await asyncio.sleep(draw.choice([0.0, 0.001, 0.02]))

            await asyncio.gather(*(send(port, stream) for port, stream in zip("abc", streams, strict=True)))
            await asyncio.sleep(1.0)
            assert all(one.balanced for one in fusion.sync.statistics.values())
            return fusion.matches

    for case in range(cases(500)):
        draw = random.Random(case)
        streams = [sorted(draw.sample(range(60), draw.randrange(30))) for _ in range(3)]
        if policy == "nearest":  # which is known of all of them once each port is past them
            streams = [[*stream, 1000] for stream in streams]
        for seed in (2 * case, 2 * case + 1):

            async def main(clock: SimulatedClock, seed: int = seed, streams: list[list[int]] = streams) -> Any:
                return await matches(seed, streams)

            assert simulate(main, seed=seed) == MODELS[policy](streams, within)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"policy": "newest"}, r"policy = 'newest': expected exact, nearest, latest"),
        ({"policy": "exact", "tolerance": 0.1}, r"tolerance = 0\.1: policy \"exact\" takes none; leave it out"),
        ({"tolerance": -0.1}, r"tolerance = -0\.1: expected seconds, 0 or more"),
        ({"tolerance": math.nan}, r"tolerance = nan: expected seconds"),
        ({"tolerance": math.inf}, r"tolerance = inf: expected seconds"),
        ({"tolerance": "1"}, r"tolerance = '1': expected seconds"),
        ({"length": 0}, r"length = 0: expected a whole number, 1 or more"),
        ({"length": 2.0}, r"length = 2\.0: expected a whole number"),
    ],
)
def test_a_wrong_option_is_refused_with_its_key(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Fusion("fusion", **options)


def test_wrong_ports_are_refused_with_what_to_do() -> None:
    one, two = Fusion("one"), Fusion("two")
    wrong: Any = Sensors("sensors").a
    for ports, message in (
        ((), "expected two in-ports or more"),
        ((one.a,), r"Synchronizer\(one\.a\): expected two in-ports or more"),
        ((one.a, one.a), "expected each in-port once"),
        ((one.a, two.b), "expected in-ports of one component"),
        ((one.a, one.plain), r"one\.plain: float has no time stamp; use a record with a field tm"),
        ((one.a, wrong), "expected in-ports of a component, such as self.image"),
        ((Fusion.a, Fusion.b), r"make the Synchronizer in its __init__"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            Synchronizer(*ports)  # type: ignore[arg-type]
