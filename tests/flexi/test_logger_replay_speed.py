"""As fast as possible: a replay keeps up with the decoding of its samples, in constant memory."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import aiorts
from aiorts import Component, EventContext, InPort, Kernel
from aiorts.system import wait_finished
from aiorts.types import TimedDouble
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import RecordingOptions, RecordingReader, RecordingWriter
from campaign import CAMPAIGN

COUNT = 1_000_000 if CAMPAIGN else 15_000
BEGIN = 1_700_000_000_000_000_000


class Taker(Component):
    data = InPort(TimedDouble)

    def on_activated(self) -> None:
        self.count, self.total = 0, 0.0

    def on_execute(self) -> None:
        for sample in self.data.drain():
            self.count += 1
            self.total += sample.data


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


async def replayed(path: Path) -> tuple[float, Taker]:
    async with Kernel() as kernel:
        logger = await kernel.create(FlexiLogger, mode="replay", logfile=str(path), speed=None, absolute=True)
        taker = await kernel.create(Taker)
        await kernel.connect(logger.ports["data"], taker.data, length=1000, full="block", timeout=None)
        await kernel.start(EventContext(), taker, activate=True)
        began = time.perf_counter()
        await kernel.start(EventContext(), logger, activate=True)
        assert await wait_finished(kernel) == ()
        return time.perf_counter() - began, taker


def decoded(path: Path) -> float:
    began = time.perf_counter()
    with RecordingReader(path) as reader:
        assert sum(1 for _ in reader.records()) == COUNT
    return time.perf_counter() - began


@pytest.mark.slow(kept_by="flexi/test_logger_replay_order.py::test_as_fast_as_it_can_it_keeps_the_order_of_two_ports")
@pytest.mark.row(116)
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_a_replay_goes_as_fast_as_samples_can_be_decoded_and_in_constant_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    options = RecordingOptions(min_free=0, queue=2_000_000, queue_bytes=2**34)
    with RecordingWriter(path, options) as writer:
        port = writer.add_port("data", TimedDouble)
        for number in range(COUNT):
            assert writer.write(port, TimedDouble(BEGIN + number, float(number)), BEGIN + number)
    decoded(path)
    before = resident()
    times = []
    for _ in range(2):
        bare = decoded(path)
        took, taker = aiorts.run(lambda: replayed(path))
        assert (taker.count, taker.total) == (COUNT, COUNT * (COUNT - 1) / 2)
        times.append(bare / took)
    assert resident() - before < 16 * 2**20
    # A machine that does other things as well may hold up either; the best of two is what it can.
    assert max(times) > (0.5 if CAMPAIGN else 0.15), times
