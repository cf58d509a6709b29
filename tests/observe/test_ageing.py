"""Connections that come and go leave nothing behind, observed or not."""

from __future__ import annotations

import gc
import os
import tracemalloc

import pytest

from aiorts import Component, InPort, Kernel, OutPort, SimulatedClock
from aiorts.events import ConnectorEvent
from aiorts.testing import simulate
from aiorts.types import TimedDouble
from campaign import CAMPAIGN

pytestmark = pytest.mark.slow

PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


class Node(Component):
    into = InPort(TimedDouble)
    out = OutPort(TimedDouble)


def resident() -> int:
    gc.collect()
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * PAGE


async def connect_often(kernel: Kernel, times: int) -> None:
    one, other = kernel.components["one"], kernel.components["other"]
    for _ in range(times):
        wire = await kernel.connect(one.ports["out"], other.ports["into"])
        one.ports["out"].write_nowait(TimedDouble(0, 1.0))  # type: ignore[attr-defined]
        await kernel.disconnect(wire)
        assert wire.statistics.balanced


@pytest.mark.fault("B16")
@pytest.mark.parametrize(("observed", "connections"), [(True, 100), (False, 1000), (True, 1000)])
def test_a_thousand_connections_leave_no_memory_behind(observed: bool, connections: int) -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            for name in ("one", "other"):
                await kernel.add(Node(name))
            if observed:
                kernel.bus.subscribe(ConnectorEvent, lambda event: None)
                kernel.changes(length=8)
            await connect_often(kernel, connections // 5)
            gc.collect()
            tracemalloc.start()
            before = tracemalloc.get_traced_memory()[0]
            await connect_often(kernel, connections)
            kernel.listening.report()
            gc.collect()
            grown = tracemalloc.get_traced_memory()[0] - before
            tracemalloc.stop()
            assert grown < max(20_000, 100 * connections)
            assert dict(kernel.connectors) == {}
            assert kernel.components["one"].ports["out"].connectors == ()

    simulate(main)


@pytest.mark.campaign
@pytest.mark.fault("B16")
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs /proc")
def test_tens_of_thousands_of_connections_leave_no_memory_behind() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            for name in ("one", "other"):
                await kernel.add(Node(name))
            await connect_often(kernel, 5_000)
            before = resident()
            await connect_often(kernel, 100_000 if CAMPAIGN else 25_000)
            assert resident() - before <= 2 * 1024 * 1024

    simulate(main)
