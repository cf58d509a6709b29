"""FlexiLogger replays: a reader of several ports gets their samples in the order in which they were recorded."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Component, EventContext, InPort, Kernel, PeriodicContext, ThreadContext
from aiorts.errors import ComponentError
from aiorts.testing import simulated
from aiorts.types import TimedLong
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import RecordingOptions, RecordingWriter
from log_parts import BEGIN, MS


class _Both(Component):
    """Reads two ports in one go."""

    a = InPort(TimedLong)
    b = InPort(TimedLong)

    def on_initialize(self) -> None:
        self.got: list[int] = []

    def on_execute(self) -> None:
        self.got += [sample.data for port in (self.a, self.b) for sample in port.drain()]


@pytest.mark.parametrize("pattern", ["ab", "ba", "aab", "abb", "bbaab"])
@simulated
async def test_as_fast_as_it_can_it_keeps_the_order_of_two_ports(pattern: str, tmp_path: Path) -> None:
    names = "ab" + pattern * 50
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        ports = {name: writer.add_port(name, TimedLong) for name in "ab"}
        for number, name in enumerate(names):
            writer.write(ports[name], TimedLong(0, number), BEGIN + number * MS)
    async with Kernel() as kernel:
        replay = await kernel.create(FlexiLogger, mode="replay", logfile=str(tmp_path / "run.mcap"), speed=None)
        reader = await kernel.create(_Both)
        for port in (reader.a, reader.b):
            await kernel.connect(replay.ports[port.name], port, length=1000)
        await kernel.start(EventContext(), reader, activate=True)
        await kernel.start(EventContext(), replay, activate=True)
        await kernel.sleep(1.0)
    assert reader.got == list(range(len(names)))


@simulated
async def test_a_refused_activation_does_not_count_where_two_contexts_run_it(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap", RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("a", TimedLong)
        for number in range(100):
            writer.write(port, TimedLong(0, number), BEGIN + number * 100 * MS)
    async with Kernel() as kernel:
        replay = await kernel.create(FlexiLogger, mode="replay", logfile=str(tmp_path / "run.mcap"))
        reader = await kernel.create(_Both)
        await kernel.connect(replay.ports["a"], reader.a, length=1000)
        await kernel.start(EventContext(), reader, activate=True)
        thread = await kernel.start(ThreadContext(rate=10.0), replay)
        with pytest.raises(ComponentError, match="not in a thread"):
            await thread.activate(replay)
        await thread.reset(replay)
        await kernel.stop(thread)
        first = await kernel.start(EventContext(), replay, activate=True)
        await kernel.start(PeriodicContext(rate=10.0), replay, activate=True)
        await kernel.sleep(1.0)
        await first.deactivate(replay)
        await kernel.sleep(20.0)
    assert reader.got == list(range(100))
