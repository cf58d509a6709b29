"""No sample is lost, doubled or exchanged by reloads at any moment, good or bad, with writers that run all the time."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, PeriodicContext
from aiorts.errors import AiortsError
from aiorts.testing import simulate
from aiorts.types import Time, TimedDouble
from campaign import cases, time_limit

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

MIDDLE = """
class Middle(Component):
    data = InPort(TimedDouble)
    out = OutPort(TimedDouble)

    def __init__(self, name=""):
        super().__init__(name)
        self.runs = 0

    def on_execute(self):
        self.runs += 1
        # before
        out = self.out
        for sample in self.data.drain():
            out.write_nowait(sample)

    def on_reload(self, old):
        pass  # reload
"""
EDITS = {
    "good": ("# before", "pass"),
    "async": ("    def on_execute", "    async def on_execute"),
    "slow hand-over": (
        "    def on_reload(self, old):\n        pass  # reload",
        "    async def on_reload(self, old):\n        await self.sleep(0.013)",
    ),
    "bad at once": ("# before", "1 / 0"),
    "bad later": ("# before", "if self.runs == 3: 1 / 0"),
    "bad hand-over": ("pass  # reload", "1 / 0"),
    "bad file": ("class Middle", "class"),
    "no such port": ("    out = OutPort(TimedDouble)\n", "    aus = OutPort(TimedDouble)\n"),
}
"""The last takes a port away, and fails for it in its first cycle: the port comes back with its connector."""


class Counter(Component):
    out = OutPort(TimedDouble)
    count = 0

    def on_execute(self) -> None:
        self.out.write_nowait(TimedDouble(Time(0, 0), float(self.count)))
        self.count += 1


class Last(Component):
    data = InPort(TimedDouble)


@pytest.mark.slow(kept_by="reload/test_replacement.py::test_unread_samples_and_their_order_stay")
@pytest.mark.row(23)
@pytest.mark.timeout(time_limit(900))
@settings(max_examples=cases(1500), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    edits=st.lists(st.tuples(st.sampled_from(sorted(EDITS)), st.integers(0, 60)), min_size=1, max_size=4),
    rates=st.tuples(st.sampled_from([50.0, 100.0, 333.0]), st.sampled_from([0.0, 20.0, 100.0, 250.0])),
    together=st.booleans(),
)
def test_every_sample_arrives_once_and_in_order(
    edits: list[tuple[str, int]], rates: tuple[float, float], together: bool, source: Make
) -> None:
    async def run() -> None:
        file = source(MIDDLE)
        text = MIDDLE
        async with Kernel() as kernel:
            writer = await kernel.create(Counter, "writer")
            middle = await kernel.create(file.get("Middle"), "middle")
            sink = await kernel.create(file.get("Middle"), "sink") if together else None
            first = await kernel.connect(writer.out, middle.data, length=100_000)
            last = await kernel.create(Last, "last")
            connectors = [first]
            if sink is not None:
                connectors.append(await kernel.connect(middle.out, sink.data, length=100_000))
            tail = await kernel.connect((sink or middle).out, last.data, length=100_000)
            connectors.append(tail)
            context: Any = PeriodicContext(rate=rates[1]) if rates[1] else EventContext()
            await kernel.start(context, middle, *([sink] if sink else []), activate=True)
            await kernel.start(PeriodicContext(rate=rates[0]), writer, activate=True)
            for what, pause in edits:
                file.write(text.replace(*EDITS[what]))
                with suppress(AiortsError):
                    await kernel.reload("Middle", cycles=8, seconds=0.3)
                await kernel.sleep(pause / 1000)
            await kernel.sleep(0.2)
            await kernel.contexts["periodic0" if not rates[1] else "periodic1"].stop()
            await kernel.sleep(0.2)
            for _ in range(4):
                await asyncio.sleep(0)
            got = [sample.data for sample in last.data.drain()]
            assert got == [float(number) for number in range(writer.count)]
            for connector in connectors:
                counts = connector.statistics
                assert counts.written == writer.count
                assert (counts.delivered, counts.buffered, counts.dropped) == (writer.count, 0, {})

    simulate(run())
