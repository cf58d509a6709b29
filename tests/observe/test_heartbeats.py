"""Heart-beats tell who is there and whether it moves; without a subscriber nobody hears of them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from aiorts import Component, EventContext, Kernel, PeriodicContext, SimulatedClock
from aiorts.errors import ConfigurationError
from aiorts.events import ComponentBeat, ContextBeat, Event
from aiorts.testing import simulate

pytestmark = pytest.mark.row(105)


class Worker(Component):
    stuck = False

    async def on_execute(self) -> None:
        if self.stuck:
            await asyncio.Event().wait()


def test_each_context_and_component_beats_and_a_stuck_one_says_so() -> None:
    async def main(clock: SimulatedClock) -> None:
        beats: list[Any] = []
        others: list[Event] = []
        async with Kernel() as kernel:
            kernel.bus.subscribe(ContextBeat, beats.append)
            kernel.bus.subscribe(ComponentBeat, beats.append)
            good, bad, idle = [await kernel.add(Worker(name)) for name in ("good", "bad", "idle")]
            await kernel.start(PeriodicContext(10.0, name="one"), good, activate=True)
            await kernel.start(PeriodicContext(10.0, name="two"), bad, activate=True)
            await kernel.start(EventContext(name="three"), idle, activate=True)
            kernel.bus.subscribe(Event, others.append)
            stop = kernel.heartbeat(1.0)
            await clock.advance(1.05)
            assert [(b.context, b.progressed) for b in beats if isinstance(b, ContextBeat)] == [
                ("one", True),
                ("two", True),
                ("three", True),
            ]
            assert beats[0].cycles >= 10
            bad.stuck = True
            await clock.advance(2.0)
            beats.clear()
            await clock.advance(1.0)
            told = {getattr(b, "context", "") or b.component: b.progressed for b in beats}
            assert told == {"one": True, "two": False, "three": True, "good": True, "bad": False, "idle": True}
            assert beats[-1].states == {"three": "active"}
            stop()
            beats.clear()
            await clock.advance(5.0)
            assert beats == []
            assert others == []
            kernel.heartbeat(1.0)
            with pytest.raises(ConfigurationError):
                kernel.heartbeat(0.0)
            bad.stuck = False

    simulate(main)
